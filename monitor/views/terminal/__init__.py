"""Tables, progress bars and lines on a terminal. I/O."""
