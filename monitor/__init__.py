"""joint-monitor: friction health of a robot arm."""

__version__ = "0.1.0"
