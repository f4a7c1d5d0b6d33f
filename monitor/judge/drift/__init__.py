"""One replay through the Kalman filter: observation, state, update, change detection. Pure."""
