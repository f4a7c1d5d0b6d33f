"""What must hold before and while an arm moves: conditions, guard, gate, limits, first pass, torque band."""
