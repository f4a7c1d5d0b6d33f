"""Evidence: what the figures of the documentation are made of. Each module is a command; none is in the wheel."""
