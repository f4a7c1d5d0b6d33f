"""Physics of a simulated arm: bodies, friction, heat, wear, sensors, and how its servos follow a reference."""
