"""Recording → Motion: rows and units checked, one clock, one zero-phase filter, the joint torque."""
