"""Identification → Health. Pure."""
