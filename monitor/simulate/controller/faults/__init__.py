"""What goes wrong on a simulated controller: faults of its own, interference by people, programs of others."""
