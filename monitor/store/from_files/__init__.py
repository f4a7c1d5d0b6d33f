"""What commands compute from recordings in files: a series of verdicts, and what production tells. I/O."""
