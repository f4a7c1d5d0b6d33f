"""Motions of the arm: each is entered before the arm may move, and ended once it is known how it ended. I/O.

A motion that a crash, a power cut or a full disk left without an end becomes a stop, which waits for a person.
"""

import fcntl
import json
import os
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from monitor.errors import MotionRefused
from monitor.reason import Reason, Sentence, reason_from
from monitor.store.disk import refused_by
from monitor.store.history.database import Database, Document, json_text, reason_column, set_note, stored_reason

LOCK = "motion.lock"  # held by the process that moves the arm; the kernel lets go of it when that process ends, however it ends
LOCK_PATIENCE_S = 1.0  # somebody who only looks whether the arm is moved holds the lock for less than a millisecond
UNKNOWN_END = "unknown_end"  # the cause of the stop that a motion without a known end becomes
SERIAL = "arm_serial"  # name of the note with the serial number of the arm that this history belongs to
LEFT = "arm_left"  # name of the note that says how the last motion left the arm; there is none where it brought the arm back
ANOTHER_ARM = "another_arm"  # the cause of the stop that another serial number than the expected one is
# causes that no replay ended by: their reason is the whole sentence
WAY_BACK = "way_back"  # of the entry that a person made of a way back
HISTORY_RESTORED = "history_restored"  # of the stop that a restored history is
STANDING_BY_THEMSELVES = frozenset({ANOTHER_ARM, WAY_BACK, UNKNOWN_END, HISTORY_RESTORED})

LET_BACK = Sentence(WAY_BACK, "a person lets the arm be brought back: {back}")
ARM_BUSY = Sentence("arm_moved_by_another", "{directory}: another joint-monitor moves this arm now")
STOP_CAME = Sentence("stop_came", "a stop waits for a person; it came while this motion was prepared")
STOPPED = Sentence("replay_stopped", "replay {replay} was ended by {cause}: {reason}")
STOPPED_BY_HAND = Sentence("replay_by_hand_stopped", "a replay by hand was ended by {cause}: {reason}")
MOTION_OF_REPLAY = Sentence("motion_of_replay", "a motion of replay {replay}")
MOTION_BY_HAND = Sentence("motion_by_hand", "a motion by hand")
MOTION_AT = Sentence("motion_at", "{motion} at {host}")
END_UNKNOWN = Sentence(
    UNKNOWN_END,
    "{motion} was under way when the monitor or its host ended; whether the arm came to rest, and whether its safety system stopped it, "
    "is not known",
)
_KEYS = ("id", "ledger_id", "began_at_unix_s", "host", "serial", "first_pass", "ended_at_unix_s", "ending", "reason")


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """One motion: a replay or a first pass, also one that ended early."""

    id: int
    ledger_id: int | None
    began_at_unix_s: float
    host: str
    serial: str | None
    first_pass: bool
    ended_at_unix_s: float | None
    ending: str | None
    reason: Reason | None

    @property
    def end_unknown(self) -> Reason:
        """What is not known after this motion, which has no end."""
        motion = MOTION_BY_HAND() if self.ledger_id is None else MOTION_OF_REPLAY(replay=self.ledger_id)
        return END_UNKNOWN(motion=MOTION_AT(motion=motion, host=self.host) if self.host else motion)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A replay that ended in a stop: a person must check the arm before it moves again."""

    id: int
    ledger_id: int | None
    at_unix_s: float
    cause: str
    reason: Reason
    allowed_at_unix_s: float | None = None  # None: nobody has allowed it yet
    allowed_by: str | None = None
    allowed_why: str | None = None
    serial: str | None = None  # of another arm than expected; a person who allows motion accepts that arm

    @property
    def said(self) -> Reason:
        """The stop as a whole sentence: what ended, and why."""
        if self.cause in STANDING_BY_THEMSELVES:
            return self.reason
        if self.ledger_id is None:
            return STOPPED_BY_HAND(cause=self.cause, reason=self.reason)
        return STOPPED(replay=self.ledger_id, cause=self.cause, reason=self.reason)

    @property
    def text(self) -> str:
        """As an English sentence."""
        return self.said.text


class Motions:
    """The motions of one arm. Only one process at a time may move it."""

    def __init__(self, database: Database) -> None:
        self._db = database
        self._lock = database.directory / LOCK

    @contextmanager
    def turn(self, at_unix_s: float) -> Iterator[None]:
        """Hold the right to move the arm. A motion of an earlier process that has no end becomes a stop first.

        Raises MotionRefused where another process moves the arm, StoreError where the lock cannot be made.
        """
        try:
            handle = os.open(self._lock, os.O_CREAT | os.O_RDONLY | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise refused_by(error, self._lock) from None
        try:
            until = time.monotonic() + LOCK_PATIENCE_S
            while not _locked(handle, fcntl.LOCK_EX):
                if time.monotonic() > until:
                    raise MotionRefused(ARM_BUSY(directory=str(self._lock.parent)))
                time.sleep(0.005)
            self._give_up_unended(at_unix_s)
            yield
        finally:
            os.close(handle)

    def begin(self, *, ledger_id: int | None, host: str, serial: str | None, configured: bool, first_pass: bool, at_unix_s: float) -> int:
        """Enter a motion as under way; it is on the disk when this returns. The serial number that is met first is expected from now on.

        configured : the configuration names this serial number; it then replaces another one. Raises MotionRefused where a stop waits for
        a person, StoreError where the disk does not take it: the arm must not move then.
        """
        with self._db.transaction() as db:
            if db.execute("SELECT 1 FROM stop WHERE allowed_at_unix_s IS NULL LIMIT 1").fetchone():
                raise MotionRefused(STOP_CAME())
            if serial is not None:
                keep = "UPDATE SET value = excluded.value" if configured else "NOTHING"
                db.execute(f"INSERT INTO note VALUES (?, ?) ON CONFLICT (key) DO {keep}", (SERIAL, serial))  # noqa: S608 - fixed words
            cursor = db.execute(
                "INSERT INTO motion (ledger_id, began_at_unix_s, host, serial, first_pass) VALUES (?, ?, ?, ?, ?)",
                (ledger_id, float(at_unix_s), host, serial, int(first_pass)),
            )
            return int(cursor.lastrowid or 0)

    def end(
        self,
        motion_id: int,
        ending: str,
        reason: str | Reason | None,
        at_unix_s: float,
        *,
        left: Mapping[str, Any] | None = None,
        moved: bool = True,
    ) -> None:
        """Note how a motion ended: well, or by a cause that needs no person; and how it left the arm, None: it brought it back.

        A motion that has not `moved` left the arm as it was. Raises StoreError; the motion then stays without an end.
        """
        with self._db.transaction() as db:
            if moved:
                _note_left(db, left)
            db.execute(
                "UPDATE motion SET ended_at_unix_s = ?, ending = ?, reason = ? WHERE id = ? AND ended_at_unix_s IS NULL",
                (float(at_unix_s), ending, reason_column(reason), motion_id),
            )

    def end_in_stop(
        self,
        motion_id: int,
        cause: str,
        reason: str | Reason,
        at_unix_s: float,
        *,
        left: Mapping[str, Any] | None = None,
        moved: bool = True,
    ) -> None:
        """Note that a person must look after a motion, as `end` does: its end and the stop are stored together. Raises StoreError."""
        with self._db.transaction() as db:
            if moved:
                _note_left(db, left)
            ((ledger_id,),) = db.execute("SELECT ledger_id FROM motion WHERE id = ?", (motion_id,)).fetchall()
            insert_stop(db, ledger_id, at_unix_s, cause, reason)

    def left_over(self) -> list[Motion]:
        """Motions without an end that no process carries out now, oldest first."""
        before = {motion.id for motion in self._unended()}
        if not before or self._under_way():
            return []
        return [motion for motion in self._unended() if motion.id in before]  # one may have ended meanwhile, and another begun

    def give_up_left_over(self, at_unix_s: float) -> list[Motion]:
        """Make a stop of each motion that is left over; returns these motions. Raises StoreError."""
        found = self.left_over()
        try:
            if found:
                with self.turn(at_unix_s):
                    pass
        except MotionRefused:  # somebody begins to move the arm now, and has made stops of them
            return []
        return found

    def rows(self, *, limit: int | None = None, ledger_id: int | None = None) -> list[Motion]:
        """Motions, oldest first: the last `limit` of them, or those of one window."""
        where, values = ("", ()) if ledger_id is None else ("WHERE ledger_id = ?", (ledger_id,))
        rows = self._db.rows(
            f"SELECT {', '.join(_KEYS)} FROM motion {where} ORDER BY id DESC LIMIT ?",  # noqa: S608 - fixed names
            (*values, -1 if limit is None else limit),
        )
        return [_motion(row) for row in reversed(rows)]

    def left(self) -> Document | None:
        """How the last motion left the arm; None where it brought it back."""
        rows = self._db.rows("SELECT value FROM note WHERE key = ?", (LEFT,))
        return json.loads(rows[0][0]) if rows else None

    def set_left(self, left: Mapping[str, Any]) -> None:
        """Replace how the arm was left: a person has looked at it. Raises StoreError."""
        with self._db.transaction() as db:
            _note_left(db, left)

    def expected_serial(self) -> str | None:
        """The serial number of the arm that this history belongs to; None before the first motion, and of an arm that says none."""
        rows = self._db.rows("SELECT value FROM note WHERE key = ?", (SERIAL,))
        return str(rows[0][0]) if rows else None

    def _unended(self) -> list[Motion]:
        return [_motion(row) for row in self._db.rows(f"SELECT {', '.join(_KEYS)} FROM motion WHERE ended_at_unix_s IS NULL ORDER BY id")]  # noqa: S608

    def _under_way(self) -> bool:
        """Whether a process holds the right to move the arm now."""
        try:
            handle = os.open(self._lock, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:  # nobody has made it, or this user may not read it: an end that is not known is not a motion under way
            return False
        try:
            return not _locked(handle, fcntl.LOCK_SH)
        finally:
            os.close(handle)

    def _give_up_unended(self, at_unix_s: float) -> None:
        """The caller holds the right to move the arm, so nobody carries these motions out."""
        for motion in self._unended():
            self.end_in_stop(motion.id, UNKNOWN_END, motion.end_unknown, at_unix_s)


class Stops:
    """The stored stops, and the persons who allowed motion again."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def add(self, cause: str, reason: str | Reason, at_unix_s: float) -> None:
        """Store the stop of a replay by hand, which the ledger does not have, or what a person allows beyond a stop."""
        with self._db.transaction() as db:
            insert_stop(db, None, at_unix_s, cause, reason)

    def add_another_arm(self, serial: str, reason: str | Reason, at_unix_s: float) -> None:
        """Store that another arm than expected answers, once until a person allows it."""
        with self._db.transaction() as db:
            known = db.execute("SELECT 1 FROM stop WHERE serial = ? AND allowed_at_unix_s IS NULL", (serial,)).fetchone()
            if known is None:
                db.execute(
                    "INSERT INTO stop (at_unix_s, cause, reason, serial) VALUES (?, ?, ?, ?)",
                    (float(at_unix_s), ANOTHER_ARM, reason_column(reason), serial),
                )

    def waiting(self) -> list[Stop]:
        """Stops that nobody has acknowledged, oldest first."""
        return [stop for stop in self.rows() if stop.allowed_at_unix_s is None]

    def rows(self) -> list[Stop]:
        """All stops, oldest first, each with the person who allowed motion again."""
        keys = ("id", "ledger_id", "at_unix_s", "cause", "reason", "allowed_at_unix_s", "allowed_by", "allowed_why", "serial")
        rows = self._db.rows(f"SELECT {', '.join(keys)} FROM stop ORDER BY id")  # noqa: S608 - fixed names
        found = [dict(zip(keys, row, strict=True)) for row in rows]
        return [Stop(**stop | {"reason": reason_from(json.loads(stop["reason"]))}) for stop in found]

    def allow(self, by: str, why: str, at_unix_s: float) -> list[Stop]:
        """Allow motion again: stores the person and the reason with every waiting stop. Returns these stops.

        Where one of them is another arm than expected, that arm is expected from now on, and it must make its first pass slowly.
        """
        with self._db.transaction() as db:
            waiting = self.waiting()
            db.execute(
                "UPDATE stop SET allowed_at_unix_s = ?, allowed_by = ?, allowed_why = ? WHERE allowed_at_unix_s IS NULL",
                (float(at_unix_s), by, why),
            )
            others = [stop.serial for stop in waiting if stop.serial is not None]
            if others:
                db.execute("DELETE FROM note WHERE key = ?", (LEFT,))  # that was another arm
                set_note(db, SERIAL, others[-1])
                # a first pass of no provenance: the latest one is not of this arm, nor is the torque model of that time
                note = json_text({"another_arm": others[-1]})
                db.execute("INSERT INTO first_pass (at_unix_s, digest, document) VALUES (?, '', ?)", (float(at_unix_s), note))
        return waiting


class FirstPasses:
    """Slow first passes along a trajectory, each with the digest of its provenance."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def is_latest(self, digest: str) -> bool:
        """Whether the latest first pass has the provenance of this digest."""
        rows = self._db.rows("SELECT digest FROM first_pass ORDER BY id DESC LIMIT 1")
        return bool(rows) and rows[0][0] == digest

    def latest(self) -> Document | None:
        """The document of the latest first pass; None before the first."""
        rows = self._db.rows("SELECT document FROM first_pass ORDER BY id DESC LIMIT 1")
        return json.loads(rows[0][0]) if rows else None

    def add(self, digest: str, document: Mapping[str, Any], at_unix_s: float) -> None:
        """Store a first pass: the arm has moved slowly along its trajectory.

        digest : of its provenance.
        """
        with self._db.transaction() as db:
            db.execute(
                "INSERT INTO first_pass (at_unix_s, digest, document) VALUES (?, ?, ?)",
                (float(at_unix_s), digest, json_text(document)),
            )


def insert_stop(db: sqlite3.Connection, ledger_id: int | None, at_unix_s: float, cause: str, reason: str | Reason) -> None:
    """Insert a stop inside a transaction, once for a window and a cause. The window's motions without an end thereby have one."""
    known = "SELECT 1 FROM stop WHERE ledger_id = ? AND cause = ? AND allowed_at_unix_s IS NULL"
    if db.execute(known, (ledger_id, cause)).fetchone() is None:
        values = (ledger_id, float(at_unix_s), cause, reason_column(reason))
        db.execute("INSERT INTO stop (ledger_id, at_unix_s, cause, reason) VALUES (?, ?, ?, ?)", values)
    db.execute(
        "UPDATE motion SET ended_at_unix_s = ?, ending = ?, reason = ? WHERE ended_at_unix_s IS NULL AND ledger_id IS ?",
        (float(at_unix_s), cause, reason_column(reason), ledger_id),
    )


def _note_left(db: sqlite3.Connection, left: Mapping[str, Any] | None) -> None:
    if left is None:
        db.execute("DELETE FROM note WHERE key = ?", (LEFT,))
    else:
        set_note(db, LEFT, json_text(left))


def _motion(row: tuple[Any, ...]) -> Motion:
    known = dict(zip(_KEYS, row, strict=True))
    return Motion(**known | {"first_pass": bool(known["first_pass"]), "reason": stored_reason(known["reason"])})


def _locked(handle: int, kind: int) -> bool:
    """Whether the lock was got at once."""
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
