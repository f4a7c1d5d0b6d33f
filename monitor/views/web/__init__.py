"""The status page: what the bus says, for a person with a browser. I/O."""
