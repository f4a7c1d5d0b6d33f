"""The daemon: the replay cycle, the bus handlers, the scheduler, maintenance, systemd. I/O."""
