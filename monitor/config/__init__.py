"""The configuration: one TOML file a robot becomes the settings of every room, and each mistake is named with its line. I/O."""
