"""The wire of the simulated controller: RTDE, dashboard and ports 30001–30003, with their sockets and the timer."""
