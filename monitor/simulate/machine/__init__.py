"""The parts of a simulated controller that its programs read and move: state, moves, registers, journal, identity."""
