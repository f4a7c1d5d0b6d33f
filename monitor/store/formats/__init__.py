"""Recordings as files: our own Parquet, CSV in the names of RTDE, and text in the formats of others. I/O."""
