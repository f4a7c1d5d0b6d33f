"""The simulated controller: program, motions, registers, modes, and the life of its arm."""
