"""What the noise between replays is: its size, its tails, its correlation, and what chance does at every age of a change."""
