"""The commands: each module reads arguments, calls one room and prints. I/O."""
