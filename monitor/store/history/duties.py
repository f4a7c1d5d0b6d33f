"""Operating hours, stops by the arm's safety system, and recorded inspections. I/O."""

from dataclasses import dataclass
from typing import NamedTuple

from monitor.store.history.database import Database

MOST_STOPS = 10_000  # newest stops that are kept one by one; the days count all of them
_STOP = ("id", "at_unix_s", "kind", "ended_at_unix_s", "joint", "code", "during_replay")
_DONE = ("id", "item", "done_at_unix_s", "declared_at_unix_s", "hours", "done_by", "why", "undone_at_unix_s", "undone_by", "undone_why")


class DutyDay(NamedTuple):
    """One UTC day of an arm."""

    day: int  # counted from 1970-01-01
    heard_s: float
    on_s: float
    moving_s: float
    stops: int


class DutyTotal(NamedTuple):
    """All days of an arm."""

    first_day: int | None  # None: no day was counted
    heard_s: float
    on_s: float
    moving_s: float
    stops: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyStop:
    """A stop that the arm's safety system made by itself."""

    id: int
    at_unix_s: float
    kind: str  # protective_stop, violation or fault
    ended_at_unix_s: float | None  # None: it stands, or nobody heard its end
    joint: int | None  # from 1, where the controller reported it
    code: str | None  # of the controller, e.g. C153A2
    during_replay: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class InspectionRow:
    """A check that somebody says was made."""

    id: int
    item: str
    done_at_unix_s: float
    declared_at_unix_s: float
    hours: float | None  # operating hours of then
    done_by: str
    why: str
    undone_at_unix_s: float | None
    undone_by: str | None
    undone_why: str | None

    @property
    def in_force(self) -> bool:
        """Whether nobody has taken it back."""
        return self.undone_at_unix_s is None


class Duties:
    """What an arm did and bore, and who inspected it."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def add(self, day: int, heard_s: float, on_s: float, moving_s: float) -> None:
        """Add seconds to a day. Raises StoreError."""
        with self._db.transaction() as db:
            db.execute(
                "INSERT INTO duty VALUES (?, ?, ?, ?, 0) ON CONFLICT (day) DO UPDATE SET heard_s = heard_s + excluded.heard_s, "
                "on_s = on_s + excluded.on_s, moving_s = moving_s + excluded.moving_s",
                (day, float(heard_s), float(on_s), float(moving_s)),
            )

    def days(self, from_day: int = 0) -> list[DutyDay]:
        """The days from one on, oldest first."""
        rows = self._db.rows("SELECT day, heard_s, on_s, moving_s, stops FROM duty WHERE day >= ? ORDER BY day", (from_day,))
        return [DutyDay(*row) for row in rows]

    def total(self) -> DutyTotal:
        """The sums over all days."""
        ((first, heard, on, moving, stops),) = self._db.rows(
            "SELECT min(day), coalesce(sum(heard_s), 0.0), coalesce(sum(on_s), 0.0), coalesce(sum(moving_s), 0.0), "
            "coalesce(sum(stops), 0) FROM duty"
        )
        return DutyTotal(first, heard, on, moving, stops)

    def stop_began(self, at_unix_s: float, day: int, kind: str, *, during_replay: bool, ended_at_unix_s: float | None = None) -> int:
        """Store that a stop has begun; returns its number. ended_at_unix_s : where it is over already. Raises StoreError."""
        with self._db.transaction() as db:
            cursor = db.execute(
                "INSERT INTO safety_stop (at_unix_s, kind, during_replay, ended_at_unix_s) VALUES (?, ?, ?, ?)",
                (float(at_unix_s), kind, int(during_replay), ended_at_unix_s),
            )
            db.execute("INSERT INTO duty VALUES (?, 0.0, 0.0, 0.0, 1) ON CONFLICT (day) DO UPDATE SET stops = stops + 1", (day,))
            db.execute("DELETE FROM safety_stop WHERE id <= (SELECT max(id) FROM safety_stop) - ?", (MOST_STOPS,))
        return int(cursor.lastrowid or 0)

    def stop_ended(self, at_unix_s: float) -> None:
        """Store that the stop that stands has ended. Raises StoreError."""
        with self._db.transaction() as db:
            db.execute("UPDATE safety_stop SET ended_at_unix_s = ? WHERE ended_at_unix_s IS NULL", (float(at_unix_s),))

    def stop_explained(self, number: int, joint: int | None, code: str) -> None:
        """Store what the controller reported of a stop. Raises StoreError."""
        with self._db.transaction() as db:
            db.execute("UPDATE safety_stop SET joint = coalesce(joint, ?), code = coalesce(code, ?) WHERE id = ?", (joint, code, number))

    def stops(self, *, from_unix_s: float = 0.0, to_unix_s: float = 1e18, limit: int | None = None) -> list[SafetyStop]:
        """The newest `limit` stops of a time, oldest first."""
        rows = self._db.rows(
            f"SELECT {', '.join(_STOP)} FROM safety_stop WHERE at_unix_s >= ? AND at_unix_s < ? ORDER BY id DESC LIMIT ?",  # noqa: S608
            (from_unix_s, to_unix_s, -1 if limit is None else limit),
        )
        return [SafetyStop(**dict(zip(_STOP, row, strict=True)) | {"during_replay": bool(row[-1])}) for row in reversed(rows)]

    def standing(self) -> str | None:
        """The kind of the stop whose end nobody has heard; None where there is none."""
        rows = self._db.rows("SELECT kind FROM safety_stop WHERE ended_at_unix_s IS NULL ORDER BY id DESC LIMIT 1")
        return rows[0][0] if rows else None

    def stops_since(self, unix_s: float) -> int:
        """How many of the kept stops began since a time."""
        ((count,),) = self._db.rows("SELECT count(*) FROM safety_stop WHERE at_unix_s >= ?", (unix_s,))
        return int(count)

    def stops_by_joint(self) -> dict[int, int]:
        """How many of the kept stops the controller attributed to each joint (from 1)."""
        return dict(self._db.rows("SELECT joint, count(*) FROM safety_stop WHERE joint IS NOT NULL GROUP BY joint ORDER BY joint"))

    def inspected(self, item: str, done_at_unix_s: float, declared_at_unix_s: float, hours: float | None, by: str, why: str) -> None:
        """Store that a check was made. Raises StoreError."""
        with self._db.transaction() as db:
            db.execute(
                "INSERT INTO inspection (item, done_at_unix_s, declared_at_unix_s, hours, done_by, why) VALUES (?, ?, ?, ?, ?, ?)",
                (item, float(done_at_unix_s), float(declared_at_unix_s), hours, by, why),
            )

    def undo(self, number: int, at_unix_s: float, by: str, why: str) -> None:
        """Take a recorded check back. Raises StoreError."""
        with self._db.transaction() as db:
            db.execute(
                "UPDATE inspection SET undone_at_unix_s = ?, undone_by = ?, undone_why = ? WHERE id = ?",
                (float(at_unix_s), by, why, number),
            )

    def inspections(self) -> list[InspectionRow]:
        """All recorded checks, in the order in which they were declared; those that were taken back included."""
        rows = self._db.rows(f"SELECT {', '.join(_DONE)} FROM inspection ORDER BY id")  # noqa: S608 - fixed names
        return [InspectionRow(**dict(zip(_DONE, row, strict=True))) for row in rows]
