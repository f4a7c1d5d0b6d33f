"""The parts of the streaming process: the arm as one cycle sees it, its control connection, and what ends the process when in doubt."""
