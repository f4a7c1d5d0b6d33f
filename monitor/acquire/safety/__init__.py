"""Conditions that must hold before an arm moves; the supervision during motion is in `ur/` and `watch`."""
