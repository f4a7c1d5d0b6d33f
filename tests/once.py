"""What several modules of tests need and none changes: the first worker that asks prepares it, and the others of the run read it."""

import fcntl
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")


def once(factory: pytest.TempPathFactory, name: str, prepare: Callable[[Path], T]) -> T:
    """What `prepare` returned in this run, for a folder that all workers see; a value of its own for each caller."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / f"once-{name}"
    folder.mkdir(exist_ok=True)
    value = folder / "value.pickle"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not value.is_file():
            (folder / "made").mkdir(exist_ok=True)
            made = pickle.dumps(prepare(folder / "made"))
            (folder / "value.tmp").write_bytes(made)
            (folder / "value.tmp").rename(value)
    return pickle.loads(value.read_bytes())
