"""What is published: documents on Zenoh, metrics for Prometheus, the answers to queries, and the typed client. I/O."""
