"""joint-monitor: friction health of a robot arm, told over Zenoh.

The flow, each arrow a frozen value:

    acquire → Recording → identify → Identification → judge → Belief, Health → assess: Assessment → publish, store

Shapes: N samples, J joints (counted from 1 where people read them), P = 13·J standard parameters, B base parameters.
Units are in the names: `_nm`, `_rad_s`, `_c`, `_unix_s`. Frames are standard Denavit–Hartenberg.

Who imports whom, top down, checked by `make lint`:

    cli → studies → daemon → motion → config → acquire, client, simulate, store → offline, series
        → files, publish, terminal, timestamps → assess → judge → design, identify → model → recording → errors

`design` makes the trajectory that is replayed: Robot, mounting, cell → Excitation with its proof.

`assess`, `design`, `judge`, `identify`, `model`, `recording` are pure: no I/O, no clock, no unseeded number. `simulate` knows nothing of
what the monitor estimates with: it has its own friction law.
"""

__version__ = "0.1.0"
