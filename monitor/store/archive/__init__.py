"""The archive of recordings: a bucket or a folder, what it has, and what waits for it. I/O."""
