"""Takes a replay into the filter: innovation, gate, sudden changes and whom to blame for them, the lowest level held."""
