"""Published parameters, one TOML a model."""
