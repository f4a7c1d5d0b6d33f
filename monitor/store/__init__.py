"""One robot's history on disk: SQLite, recordings, backups, retention, provenance. I/O."""
