"""Friction over joint temperature: laws, curves, stuck sensors. Pure."""
