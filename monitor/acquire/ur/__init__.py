"""Universal Robots over ur-rtde: connections, rows, states and the child processes that hold them."""
