"""Drift of friction: one replay's observation, the filter that follows it, and the changes that it detects. Pure."""
