"""What a worker does once, before its first task."""

import importlib

# loaded where they are used, because most commands never need them: a second of the processor
USED = ("filterpy.kalman", "pandas", "pyarrow.fs", "pyarrow.parquet", "scipy.optimize", "scipy.signal")


def warm_up() -> None:
    """Load what the first task would load, in all workers at once."""
    for name in USED:
        importlib.import_module(name)
