"""A controller's other ports over plain sockets: dashboard, primary port, Robot API, and rows of RTDE before a session."""
