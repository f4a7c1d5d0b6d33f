"""One motion of the arm by the daemon: who asked for it, with what torque band, how it goes, and where it left the arm."""
