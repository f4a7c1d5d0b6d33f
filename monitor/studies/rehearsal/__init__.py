"""Would these thresholds detect wear, and how many false alerts would they raise? Simulated fleets through the monitor's own step."""
