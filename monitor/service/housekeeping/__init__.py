"""What the daemon does for itself: backups, retention, uploads, checks at the start and later, duties."""
