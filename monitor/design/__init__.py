"""Robot, mounting and cell → a trajectory that is safe, feasible and informative. Pure: clock and Ctrl-C come in as functions."""
