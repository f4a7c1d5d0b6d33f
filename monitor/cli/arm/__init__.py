"""The commands around one arm: its daemon, its motions, its alerts, and what a person declares."""
