"""The daemon of one robot. I/O.

run: the process. daemon: its parts put together. scheduler, housekeeping, uploads, production, main_loop: its threads.
replay: one window from claim to verdict. motion: one guarded motion. publisher, handlers: the bus, out and in.
history/: what is made of a stored history, with and without a daemon.
"""
