"""When a replay is due: settings, cron, windows, and what opens a window beside the clock. Values only: no clock, no thread, no I/O."""
