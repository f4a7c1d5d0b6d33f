"""What the tests of the plant share: a PostgreSQL, and databases in it and in SQLite."""

import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from empty_plant import empty_plant
from postgres_server import Postgres, binaries

from monitor.plant.database import Database


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    place = binaries()
    if place is None:
        pytest.skip("PostgreSQL is not installed: apt-get install postgresql")
    folder = Path(tempfile.mkdtemp(prefix="joint-monitor-postgres-"))
    server = Postgres(place, folder)
    yield server
    server.process.send_signal(signal.SIGQUIT)  # at once: nobody wants its data any more
    server.process.wait(timeout=20.0)
    shutil.rmtree(folder)


@pytest.fixture(params=["sqlite", "postgresql"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Of an empty database."""
    return f"sqlite:///{tmp_path / 'plant.sqlite'}" if request.param == "sqlite" else request.getfixturevalue("postgres").address()


@pytest.fixture
def database(address: str) -> Iterator[Database]:
    """An empty database with its tables."""
    made = Database(address)
    if made.file is None:
        made.migrate()
    else:
        made.file.write_bytes(empty_plant())
    yield made
    made.close()
