"""Copying a numbered log by cursor: which entries of an answer are new, and whether it is still the same log. No I/O.

A question asks from one entry before the cursor, so that the answer repeats the newest entry that is copied already. Where that entry is
missing or is another one, the log was restored from a backup or replaced: its numbers mean something else now.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Generic, NamedTuple, TypeVar

from monitor.reason import Reason, Sentence

Content = TypeVar("Content")
REPLACED = Sentence("another_history", "its history was restored from a backup, or replaced")()
GONE_BACK = Sentence("numbers_gone_back", "its numbers have gone back: entry {seq} is gone")
ENTRY_GONE = Sentence("entry_gone", "its entry {seq} is gone, though later ones are there")
ANOTHER_ENTRY = Sentence("another_entry", "its entry {seq} is another one than before")


class Cursor(NamedTuple):
    """How far a log is copied."""

    seq: int = 0  # of the newest entry that is copied; 0: none is
    mark: str = ""  # what tells that entry from another one with its number

    @property
    def asks_after(self) -> int:
        """The number after which to ask, so that the answer repeats the newest copied entry."""
        return max(self.seq - 1, 0)


class Entry(NamedTuple, Generic[Content]):
    """One entry of a log."""

    seq: int
    mark: str
    content: Content


class Continues(NamedTuple, Generic[Content]):
    """The log goes on: these entries are new, in order."""

    new: tuple[Entry[Content], ...]
    cursor: Cursor  # after them
    missing: tuple[tuple[int, int], ...] = ()  # numbers between them that no entry has: the first and the last of each gap


class AnotherLog(NamedTuple):
    """The log is not the one that was copied: nothing of it may be mixed with what is copied."""

    why: Reason


class Disordered(NamedTuple):
    """The answer is no log: its numbers do not rise. Nothing of it is taken."""


def step(
    cursor: Cursor, identity: str | None, answered_identity: str | None, entries: Sequence[Entry[Content]]
) -> Continues[Content] | AnotherLog | Disordered:
    """What an answer to `cursor.asks_after` means.

    identity, answered_identity : of the log that is copied, and of the answer; None: unknown, and the entries alone decide.
    """
    if identity is not None and answered_identity is not None and identity != answered_identity:
        return AnotherLog(REPLACED)
    numbers = [cursor.asks_after, *(entry.seq for entry in entries)]
    if any(later <= earlier for earlier, later in pairwise(numbers)):
        return Disordered()
    missing = tuple((earlier + 1, later - 1) for earlier, later in pairwise(numbers) if later - earlier > 1)
    if cursor.seq == 0:
        return Continues(tuple(entries), _after(cursor, entries), missing)
    if not entries:
        return AnotherLog(GONE_BACK(seq=cursor.seq))
    first = entries[0]
    if first.seq != cursor.seq:
        return AnotherLog(ENTRY_GONE(seq=cursor.seq))
    if first.mark != cursor.mark:
        return AnotherLog(ANOTHER_ENTRY(seq=cursor.seq))
    return Continues(tuple(entries[1:]), _after(cursor, entries), missing)


def _after(cursor: Cursor, entries: Sequence[Entry[Content]]) -> Cursor:
    return Cursor(entries[-1].seq, entries[-1].mark) if entries else cursor
