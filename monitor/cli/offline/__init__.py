"""The commands that need no robot and no daemon: recordings, models, trajectories, and the stored past."""
