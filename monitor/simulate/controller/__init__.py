"""The simulated controller: modes, registers, programs, safety and the scenario of its arm. It opens no socket."""
