"""A UR controller made of software. I/O."""
