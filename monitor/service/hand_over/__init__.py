"""Windows in which a program lends the arm: when one is due, the program's node, and the text that the node asks for."""
