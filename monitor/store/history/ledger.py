"""The ledger: one row a window, with what was attempted in it, how it ended, and which program lent the arm for it. I/O."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from monitor.reason import Reason, Sentence, reason_from
from monitor.store.history.database import Database, reason_column, stored_reason
from monitor.store.history.motions import insert_stop

_KEYS = ("id", "window_unix_s", "kind", "state", "started_at_unix_s", "ended_at_unix_s", "reason", "recording", "removed_at_unix_s")
_COLUMNS = ", ".join(_KEYS)

ENDED_DURING = Sentence("monitor_ended", "the monitor ended during this replay")
FOUND = Sentence("found_on_disk", "found on disk after the history was restored")


class RecordingFolder:
    """The files of one history's recordings. Each name holds the id of its window in the ledger."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def path(self, ledger_id: int) -> Path:
        """Where the recording of a window belongs."""
        return self.directory / f"replay-{ledger_id:06d}.parquet"

    def first_pass_path(self, ledger_id: int) -> Path:
        """Where the recording of a window's first pass belongs."""
        return self.directory / f"replay-{ledger_id:06d}-first-pass.parquet"

    def numbered(self) -> list[tuple[int, Path]]:
        """All recordings on disk with the ids of their windows, ascending; first passes are left out."""
        found = self.directory.glob("replay-" + "[0-9]" * 6 + ".parquet")
        return sorted((int(path.stem.removeprefix("replay-")), path) for path in found)

    def remove_temporary(self) -> None:
        """Remove what a crash left of recordings that were being written."""
        for leftover in self.directory.glob(".*.tmp*"):
            leftover.unlink()  # it was never renamed, so nothing relies on it


Kind = Literal["scheduled", "requested", "imported"]  # of a window


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerRow:
    """One window: what was attempted in it, and how it ended."""

    id: int
    window_unix_s: float
    kind: str
    state: str
    started_at_unix_s: float
    ended_at_unix_s: float | None
    reason: Reason | None
    recording: str | None
    removed_at_unix_s: float | None = None  # when the recording was pruned

    @property
    def reason_text(self) -> str | None:
        """The reason in English; None where there is none."""
        return None if self.reason is None else self.reason.text


@dataclass(frozen=True, slots=True, kw_only=True)
class Try:
    """A replay that ended early and was tried again in the same window."""

    number: int  # within its window, from 1
    ended_at_unix_s: float
    cause: str
    reason: Reason


@dataclass(frozen=True, slots=True, kw_only=True)
class Borrow:
    """One arm that a program lent."""

    ledger_id: int
    due_since_unix_s: float
    taken_at_unix_s: float
    program: str | None  # as the controller calls it; None: it tells no names
    waited_s: float | None  # from the taking of the arm until the program went on; None: it did not
    given_back: bool


class Ledger:
    """The rows of the ledger, and the recordings that belong to them."""

    def __init__(self, database: Database, recordings: RecordingFolder) -> None:
        self._db = database
        self._recordings = recordings

    def claim(self, window_unix_s: float, kind: Kind, at_unix_s: float) -> int | None:
        """Enter a window as started, before anything moves; None where it is in the ledger already."""
        with self._db.transaction() as db:
            cursor = db.execute(
                "INSERT OR IGNORE INTO ledger (window_unix_s, kind, state, started_at_unix_s) VALUES (?, ?, 'started', ?)",
                (float(window_unix_s), kind, float(at_unix_s)),
            )
            return int(cursor.lastrowid or 0) if cursor.rowcount else None

    def claim_import(self, recorded_at_unix_s: float, at_unix_s: float) -> int | None:
        """Enter a recording made elsewhere as started, under its own time; None where the ledger has that time already.

        An import that was interrupted is resumed.
        """
        with self._db.transaction() as db:
            again = db.execute(
                "UPDATE ledger SET state = 'started', reason = NULL, ended_at_unix_s = NULL "
                "WHERE window_unix_s = ? AND kind = 'imported' AND state = 'aborted' RETURNING id",
                (float(recorded_at_unix_s),),
            ).fetchone()
            if again is not None:
                return int(again[0])
        return self.claim(recorded_at_unix_s, "imported", at_unix_s)

    def mark_recorded(self, ledger_id: int) -> None:
        """Note that the window's recording is safely on disk."""
        name = self._recordings.path(ledger_id).name
        with self._db.transaction() as db:
            db.execute("UPDATE ledger SET state = 'recorded', recording = ? WHERE id = ? AND state = 'started'", (name, ledger_id))

    def end(self, ledger_id: int, state: str, reason: str | Reason, at_unix_s: float, *, stop: str | None = None) -> None:
        """End a window without an assessment: rejected, aborted or skipped. `stop`: the cause after which a person must check the arm."""
        with self._db.transaction() as db:
            db.execute(
                "UPDATE ledger SET state = ?, reason = ?, ended_at_unix_s = ? WHERE id = ? AND state IN ('started', 'recorded')",
                (state, reason_column(reason), float(at_unix_s), ledger_id),
            )
            if stop is not None:
                insert_stop(db, ledger_id, at_unix_s, stop, reason)

    def add_try(self, ledger_id: int, cause: str, reason: str | Reason, at_unix_s: float) -> None:
        """Enter a replay that ended early; the window stays started, because it is tried again."""
        with self._db.transaction() as db:
            db.execute(
                "INSERT INTO try (ledger_id, number, ended_at_unix_s, cause, reason) "
                "SELECT ?, count(*) + 1, ?, ?, ? FROM try WHERE ledger_id = ?",
                (ledger_id, float(at_unix_s), cause, reason_column(reason), ledger_id),
            )

    def tries(self, rows: Sequence[LedgerRow]) -> dict[int, list[Try]]:
        """The replays of these windows that ended early and were tried again, by the number of the window."""
        found: dict[int, list[Try]] = {row.id: [] for row in rows}
        places = ", ".join("?" * len(found))
        for ledger_id, number, at, cause, reason in self._db.rows(
            f"SELECT ledger_id, number, ended_at_unix_s, cause, reason FROM try WHERE ledger_id IN ({places}) ORDER BY number",  # noqa: S608
            tuple(found),
        ):
            found[ledger_id].append(Try(number=number, ended_at_unix_s=at, cause=cause, reason=reason_from(json.loads(reason))))
        return found

    def learnt_at_unix_s(self) -> float | None:
        """The start of the newest window that taught something; None where none did."""
        ((at,),) = self._db.rows("SELECT max(started_at_unix_s) FROM ledger WHERE state = 'assessed'")
        return None if at is None else float(at)

    def refused_in_a_row(self, but: Sequence[str] = ()) -> tuple[int, float, Reason | None] | None:
        """The newest scheduled windows without an exception that the arm or its cell refused: how many, since when, and the last reason.

        but : codes of the reasons that are no refusal, such as of a full disk: those windows neither count nor interrupt.
        None: no such window.
        """
        marks = ", ".join("?" * len(but))
        ((count, since, newest),) = self._db.rows(
            "SELECT count(*), min(window_unix_s), max(id) FROM ledger WHERE state = 'skipped' AND kind = 'scheduled' "  # noqa: S608 - marks
            f"AND json_extract(reason, '$.code') NOT IN ({marks}) "
            "AND id > (SELECT coalesce(max(id), 0) FROM ledger WHERE state <> 'skipped')",
            tuple(but),
        )
        return (int(count), float(since), self.row(newest).reason) if count else None

    def rows(self, *, limit: int | None = None, states: Sequence[str] = ()) -> list[LedgerRow]:
        """Windows, oldest first: the last `limit` of them, and only those in `states`, where given."""
        where = f"WHERE state IN ({', '.join('?' * len(states))})" if states else ""
        rows = self._db.rows(
            f"SELECT {_COLUMNS} FROM ledger {where} ORDER BY id DESC LIMIT ?",  # noqa: S608 - fixed names
            (*states, -1 if limit is None else limit),
        )
        return [_row(row) for row in reversed(rows)]

    def row(self, ledger_id: int) -> LedgerRow:
        """One window."""
        (found,) = self._db.rows(f"SELECT {_COLUMNS} FROM ledger WHERE id = ?", (ledger_id,))  # noqa: S608 - fixed names
        return _row(found)

    def repair(self, at_unix_s: float, but: int | None = None) -> list[LedgerRow]:
        """Settle the windows that a crash left half-way: `started` becomes `recorded` where its recording is on disk, otherwise `aborted`.

        `but`: the window that is under way. Returns the rows that wait for their assessment, oldest first.
        """
        self._recordings.remove_temporary()
        for row in self.rows(states=("started",)):
            if row.id == but:
                continue
            if self._recordings.path(row.id).is_file():
                self.mark_recorded(row.id)
            else:
                self.end(row.id, "aborted", ENDED_DURING(), at_unix_s)
        return self.rows(states=("recorded",))

    def windows(self, from_unix_s: float, to_unix_s: float) -> set[float]:
        """The windows in [from, to] that the ledger has, however they ended."""
        return {
            row[0]
            for row in self._db.rows("SELECT window_unix_s FROM ledger WHERE window_unix_s BETWEEN ? AND ?", (from_unix_s, to_unix_s))
        }

    def newest_unix_s(self) -> float | None:
        """The start of the newest window that was assessed or may still be; None where there is none."""
        ((at,),) = self._db.rows("SELECT max(started_at_unix_s) FROM ledger WHERE state IN ('started', 'recorded', 'assessed')")
        return None if at is None else float(at)

    def began_unix_s(self) -> float | None:
        """The start of the history's first window, imports left out; None before it."""
        ((at,),) = self._db.rows("SELECT min(started_at_unix_s) FROM ledger WHERE kind <> 'imported'")
        return None if at is None else float(at)

    def unfinished(self) -> bool:
        """Whether any window is neither assessed nor ended."""
        return bool(self._db.rows("SELECT 1 FROM ledger WHERE state IN ('started', 'recorded') LIMIT 1"))

    def orphans(self) -> list[tuple[int, Path]]:
        """Recordings on disk whose window the ledger does not have, as after a restored backup; oldest first."""
        known = {row[0] for row in self._db.rows("SELECT id FROM ledger")}
        return [(number, path) for number, path in self._recordings.numbered() if number not in known]

    def adopt(self, ledger_id: int, window_unix_s: float, at_unix_s: float) -> None:
        """Enter an orphan under the id in its file name; it waits for its assessment."""
        with self._db.transaction() as db:
            db.execute(
                "INSERT INTO ledger (id, window_unix_s, kind, state, started_at_unix_s, reason, recording) "
                "VALUES (?, ?, 'scheduled', 'recorded', ?, ?, ?)",
                (ledger_id, float(window_unix_s), float(at_unix_s), reason_column(FOUND()), self._recordings.path(ledger_id).name),
            )

    def mark_removed(self, ledger_id: int, at_unix_s: float) -> None:
        """Note that the recording of this window is no longer on disk."""
        with self._db.transaction() as db:
            db.execute("UPDATE ledger SET removed_at_unix_s = ? WHERE id = ?", (float(at_unix_s), ledger_id))


class Borrows:
    """The borrowings of one history."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def add(self, borrow: Borrow) -> None:
        """Enter one, once it is known how it ended."""
        with self._db.transaction() as db:
            db.execute(
                "INSERT OR REPLACE INTO borrow (ledger_id, due_since_unix_s, taken_at_unix_s, program, waited_s, given_back) "
                "VALUES (?, ?, ?, ?, ?, ?)",
                (
                    borrow.ledger_id,
                    float(borrow.due_since_unix_s),
                    float(borrow.taken_at_unix_s),
                    borrow.program,
                    None if borrow.waited_s is None else float(borrow.waited_s),
                    int(borrow.given_back),
                ),
            )

    def of(self, rows: Sequence[LedgerRow]) -> dict[int, Borrow]:
        """The borrowings of these windows, by the number of the window."""
        places = ", ".join("?" * len(rows))
        found = self._db.rows(
            "SELECT ledger_id, due_since_unix_s, taken_at_unix_s, program, waited_s, given_back "  # noqa: S608 - only places are put in
            f"FROM borrow WHERE ledger_id IN ({places})",
            tuple(row.id for row in rows),
        )
        keys = ("ledger_id", "due_since_unix_s", "taken_at_unix_s", "program", "waited_s")
        return {row[0]: Borrow(**dict(zip(keys, row[:-1], strict=True)), given_back=bool(row[-1])) for row in found}


def _row(row: tuple[Any, ...]) -> LedgerRow:
    known = dict(zip(_KEYS, row, strict=True))
    return LedgerRow(**known | {"reason": stored_reason(known["reason"])})
