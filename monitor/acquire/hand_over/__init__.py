"""Borrowing the arm from a production program: the text of the program's node, and the server that a controller asks for it."""
