"""Friction over joint temperature: straight lines, curves, and temperature sensors that are stuck. Pure."""
