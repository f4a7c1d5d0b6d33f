"""The status page: the bus's documents and the history for a person with a browser. I/O."""
