"""The whole, played on simulated arms. I/O."""
