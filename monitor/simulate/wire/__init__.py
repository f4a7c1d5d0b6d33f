"""The wire of the simulated controller: RTDE, dashboard, ports 30001 to 30003, sockets and clock."""
