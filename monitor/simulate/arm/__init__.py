"""The physics of a simulated arm: rigid bodies, friction, heat, wear, sensors, servos and their reference."""
