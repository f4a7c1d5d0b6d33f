"""The commands of `joint-monitor`, one module for each topic, in rooms. A command reads arguments, calls another room and prints. I/O."""
