"""A replay that is due and waits for the node of the program that lends the arm: a value, and the note that outlives a restart."""

import json
from dataclasses import dataclass, replace
from typing import Any, Self

from monitor.publish.timestamps import rfc3339
from monitor.store.store import Store

NOTE = "replay_due"
WAITING = "waiting for the program's node"


@dataclass(frozen=True, slots=True, kw_only=True)
class DueReplay:
    """Since when a replay is due, by which window, and what keeps it waiting."""

    key_unix_s: float  # of its window, as the ledger will know it
    since_unix_s: float
    until_unix_s: float  # without a replay by then its window is skipped
    kind: str = "scheduled"  # or requested
    why: str = "cron"  # what opened its window
    tries: int = 0  # replays begun for it that this machine or the network ended
    refused: str = ""  # why the program is not asked to offer the arm; empty: it is
    passed_by: str = ""  # why the arm was not taken at the last node; empty: none was reached since

    @property
    def text(self) -> str:
        """What it waits for, as a clause."""
        if self.refused:
            return f"not offered to the program: {self.refused}"
        return f"{WAITING}; {f'at the last one: {self.passed_by}' if self.passed_by else 'none was reached yet'}"

    @property
    def reason(self) -> str:
        """Why its window ended without a replay."""
        if self.refused:
            return self.refused
        return f"hand_over: at the last node: {self.passed_by}" if self.passed_by else "hand_over: the program reached no node"

    def as_document(self) -> dict[str, Any]:
        """For the document `monitor`, its times not yet text."""
        return {
            "since_unix_s": self.since_unix_s,
            "until_unix_s": self.until_unix_s,
            "kind": self.kind,
            "why": self.why,
            "tries": self.tries,
            "text": self.text,
        }

    def keep(self, store: Store) -> None:
        """Note it. Raises StoreError."""
        lasting = {name: getattr(self, name) for name in ("key_unix_s", "since_unix_s", "until_unix_s", "kind", "why", "tries")}
        store.notes.set(NOTE, json.dumps(lasting))

    @classmethod
    def kept(cls, store: Store) -> Self | None:
        """The one that was noted; None where none is due. Raises StoreError."""
        noted = store.notes.get(NOTE)
        return cls(**json.loads(noted)) if noted else None

    def another_try(self, now_unix_s: float) -> Self:
        """The same after a replay that ended early: the ledger has its window already, so that the next try is one of its own."""
        return replace(self, key_unix_s=now_unix_s, tries=self.tries + 1, refused="", passed_by="")

    def since_text(self) -> str:
        """The whole as a sentence without its stop."""
        return f"due since {rfc3339(self.since_unix_s)} ({self.why}), {self.text}"


def forget(store: Store) -> None:
    """Note that none is due. Raises StoreError."""
    store.notes.set(NOTE, "")
