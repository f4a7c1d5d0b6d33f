"""Histories of a plant's arms, from its database: as `prior` and `reassess` read them from an arm's own folder. I/O."""

import hashlib
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import orjson
import sqlalchemy as sa

from monitor.errors import StoreError
from monitor.plant.database import Database
from monitor.plant.tables import arm, history, stored
from monitor.store.stored import unpacked_row, write_history


class PlantArm(NamedTuple):
    """One arm of the plant, with its present history."""

    site: str
    robot: str
    number: int
    history: int
    replays: int  # that were judged, of its copied rows
    says_rows: bool  # False: it has judged replays, and none of its rows are here

    @property
    def name(self) -> str:
        """SITE/ROBOT."""
        return f"{self.site}/{self.robot}"


def arms_of_plant(database: Database) -> list[PlantArm]:
    """Every arm, by site and name. Raises StoreError."""
    of_arm = (stored.c.arm == arm.c.id) & (stored.c.history == arm.c.history) & (stored.c.of_table == "assessment")
    replays = sa.select(sa.func.count()).where(of_arm).correlate(arm).scalar_subquery()
    says = (history.c.stored_cursor > 0) | (history.c.newest_replay == 0)
    columns = (arm.c.site, arm.c.robot, arm.c.id, arm.c.history, replays, says)
    joined = sa.select(*columns).join(history, (history.c.arm == arm.c.id) & (history.c.number == arm.c.history))
    with database.read() as connection:
        found = [PlantArm._make(row) for row in connection.execute(joined)]
    return sorted(found, key=lambda each: (each.site, each.robot))  # not by the database's own order of letters


def rows_of(database: Database, of: PlantArm, *tables: str) -> list[tuple[str, bytes]]:
    """The copied rows of an arm's history, table and content; of some tables, or of all. Raises StoreError."""
    asked = sa.select(stored.c.of_table, stored.c.row, stored.c.content).where(stored.c.arm == of.number, stored.c.history == of.history)
    if tables:
        asked = asked.where(stored.c.of_table.in_(tables))
    with database.read() as connection:
        found = connection.execute(asked).all()
    return [(table, bytes(content)) for table, _, content in sorted(found, key=lambda each: (each[0], each[1]))]


def belief_of(database: Database, of: PlantArm) -> dict[str, Any] | None:
    """The document of what is believed of an arm; None before its first verdict. Raises StoreError."""
    _refuse_without_rows(of)
    rows = rows_of(database, of, "state")
    found: dict[str, Any] | None = orjson.loads(unpacked_row(rows[0][1])["belief"]) if rows else None
    return found


def _refuse_without_rows(of: PlantArm) -> None:
    if not of.says_rows:
        why = "its monitor is of an earlier release or of simulate-plant, or the plant has not asked it yet"
        raise StoreError(f"the rows of its history are not copied: {why}")


class Copy(NamedTuple):
    """An arm's history made anew, and the digest of the rows that it was made of."""

    folder: Path
    digest: str


@contextmanager
def history_of(database: Database, of: PlantArm) -> Iterator[Copy]:
    """The history of an arm in a folder of its own, as long as the context lasts. Raises StoreError."""
    _refuse_without_rows(of)
    rows, digest = rows_of(database, of), hashlib.sha256()
    for table, content in rows:
        digest.update(f"{table} {len(content)} ".encode() + content)
    with tempfile.TemporaryDirectory(prefix="joint-monitor-history-") as folder:
        write_history(Path(folder), rows)
        yield Copy(Path(folder), digest.hexdigest())
