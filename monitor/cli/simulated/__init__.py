"""The commands with a simulated arm: `demo`, `try`, `simulate`, `simulate-production`."""
