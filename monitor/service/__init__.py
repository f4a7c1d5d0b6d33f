"""The daemon of one robot. I/O.

run: the process. daemon: its parts put together. monitor: the replay cycle. scheduler, maintenance, main_loop: its three threads.
motion: one guarded motion. bus/: what is published and answered. history/: what is made of a stored history.
"""
