"""Recording → Identification. Pure."""
