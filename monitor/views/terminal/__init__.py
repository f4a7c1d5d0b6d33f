"""Tables, progress and messages on a terminal."""
