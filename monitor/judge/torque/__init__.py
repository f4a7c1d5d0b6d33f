"""The temperature-compensated torque model, its predictor and its prediction error. Pure."""
