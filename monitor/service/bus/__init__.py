"""What the daemon publishes on the bus, and how it answers queries. I/O."""
