"""The tables of one robot's history, a module each, and the database below them. I/O."""
