"""The driver of Universal Robots: ur-rtde in child processes, and the dashboard server or, on a PolyScope X, the Robot API."""
