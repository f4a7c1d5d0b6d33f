"""One TOML file a robot → the settings of every room, each mistake named with its line."""
