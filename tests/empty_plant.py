"""An embedded plant's database with its tables and nothing in them. Its steps take 20 ms, which a suite need not do for every test."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from monitor.plant.database import Database


@cache
def empty_plant() -> bytes:
    """Its file, as `migrate` leaves it."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "plant.sqlite"
        made = Database(file)
        made.migrate()
        made.close()
        return file.read_bytes()
