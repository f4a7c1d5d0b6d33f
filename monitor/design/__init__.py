"""Robot → Excitation, offline. Pure."""
