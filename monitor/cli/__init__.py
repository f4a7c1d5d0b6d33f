"""The commands of `joint-monitor`, one module for each topic. A command reads its arguments, calls another room and prints. I/O."""
