"""The log of changes of the history: which replay's rows were written or taken back, numbered. I/O.

Replays are not judged in the order of their numbers: a recording may wait, and a wrong clock's verdicts are taken back. Whoever copies the
history asks for the changes after a number, and misses nothing. Triggers of the database write the log, so no writer can forget it.
"""

from monitor.store.history.database import Database, set_note

HISTORY_ID = "history_id"  # name of the note that tells this history from every other one


class Changes:
    """The log of changes, and the identity of the history that it belongs to."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def history_id(self) -> str | None:
        """What tells this history from a restored or another one; None in a copy of an older program's file without it."""
        rows = self._db.rows("SELECT value FROM note WHERE key = ?", (HISTORY_ID,))
        return str(rows[0][0]) if rows else None

    def last(self) -> int:
        """The number of the newest change; 0 where there is none."""
        ((newest,),) = self._db.rows("SELECT max(seq) FROM change")
        return int(newest or 0)

    def after(self, seq: int, limit: int) -> tuple[list[tuple[int, int, float]], int | None]:
        """At most `limit` changes with numbers above `seq`, oldest first: (number, replay, when).

        The second value is the number that the next page follows; None at the end.
        """
        rows = self._db.rows("SELECT seq, ledger_id, at_unix_s FROM change WHERE seq > ? ORDER BY seq LIMIT ?", (seq, limit + 1))
        page = [(int(number), int(replay), float(at)) for number, replay, at in rows[:limit]]
        return page, page[-1][0] if len(rows) > limit else None

    def begin_another_history(self) -> None:
        """Give the history another identity: its newest entries may be lost, and their numbers may mean something else from now on."""
        with self._db.transaction() as db:
            ((another,),) = db.execute("SELECT lower(hex(randomblob(8)))").fetchall()
            set_note(db, HISTORY_ID, another)
