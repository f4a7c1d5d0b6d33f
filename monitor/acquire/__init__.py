"""Robot → Recording: replays under guard, and listening; each connection in a process of its own that may be killed."""
