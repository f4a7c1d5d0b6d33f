"""Assessment → outside. I/O."""
