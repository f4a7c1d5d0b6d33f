"""Programs that the simulated controller runs: scripts, the register machine of ur-rtde, lists of steps."""
