"""Metrics for Prometheus, collected when somebody scrapes. I/O."""
