"""Borrowings: which replay took the arm from which running program, and for how long that program waited. I/O."""

from collections.abc import Sequence
from dataclasses import dataclass

from monitor.store.history.database import Database
from monitor.store.history.ledger import LedgerRow


@dataclass(frozen=True, slots=True, kw_only=True)
class Borrow:
    """One arm that a program lent."""

    ledger_id: int
    due_since_unix_s: float
    taken_at_unix_s: float
    program: str | None  # as the controller calls it; None: it tells no names
    waited_s: float | None  # from the taking of the arm until the program went on; None: it did not
    given_back: bool


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
        marks = ", ".join("?" * len(rows))
        found = self._db.rows(
            "SELECT ledger_id, due_since_unix_s, taken_at_unix_s, program, waited_s, given_back "  # noqa: S608 - marks alone are put in
            f"FROM borrow WHERE ledger_id IN ({marks})",
            tuple(row.id for row in rows),
        )
        keys = ("ledger_id", "due_since_unix_s", "taken_at_unix_s", "program", "waited_s")
        return {row[0]: Borrow(**dict(zip(keys, row[:-1], strict=True)), given_back=bool(row[-1])) for row in found}
