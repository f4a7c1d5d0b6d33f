"""The torque band: what the measured torque may be at each moment of a motion, from the model or the manufacturer, and earlier replays."""
