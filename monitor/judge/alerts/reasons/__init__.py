"""Reasons: what a change of friction is attributed to, and why a joint does not alert."""
