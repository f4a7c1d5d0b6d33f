"""Keeping a history for years: its schema, its backups, what is let go of, and what made each verdict."""
