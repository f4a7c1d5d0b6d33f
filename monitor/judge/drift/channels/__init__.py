"""Wear that F(v*) does not show: contrast, two more speeds, the residual."""
