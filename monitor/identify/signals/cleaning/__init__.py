"""Which rows of a recording are sound: clock, order, speeds, drives, readings; the others are left out and counted."""
