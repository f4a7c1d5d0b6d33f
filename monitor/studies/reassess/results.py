"""The place of finished results, a folder or an S3 bucket: each under the address of all that it was made from. I/O.

A result is written whole or not at all, and never changed: who finds one need not compute it.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from monitor.errors import ArchiveRefused, ArchiveUnavailable, BadInput, StoreError
from monitor.store.archive.places import ArchiveSettings, open_place

Found = TypeVar("Found")


class ResultsRefused(StoreError):
    """The place of the results refuses: nothing that is computed can be kept."""


class Results:
    """Results by kind and address. Every method raises ResultsRefused where the place does not answer, or does not let us in."""

    def __init__(self, place: str, *, make: bool = False) -> None:
        """Place : a folder, or s3://BUCKET/PREFIX. make : a folder that is not there. Raises BadInput for another address."""
        self.place = place
        if "://" not in place:
            folder = Path(place).absolute()
            place = str(folder)
            if make:
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                except OSError as wrong:
                    raise BadInput(f"--results {self.place}: cannot be made: {wrong.strerror or wrong}") from None
        try:
            self._at = open_place(ArchiveSettings(address=place))
        except BadInput as wrong:
            raise BadInput(f"--results {wrong}") from None

    def has(self, kind: str, address: str) -> bool:
        """Whether a result is finished."""
        return self._asked(lambda: self._at.has(_key(kind, address)))

    def read(self, kind: str, address: str) -> bytes | None:
        """A finished result; None where there is none."""
        return self._asked(lambda: self._at.read(_key(kind, address)))

    def write(self, kind: str, address: str, content: bytes) -> None:
        """Keep a finished result."""
        self._asked(lambda: self._at.write(_key(kind, address), content))

    def _asked(self, ask: Callable[[], Found]) -> Found:
        try:
            return ask()
        except (ArchiveUnavailable, ArchiveRefused) as wrong:
            raise ResultsRefused(f"--results {str(wrong).replace('[store] recordings', 'the address')}") from None


def whole(place: str) -> str:
    """The place as a worker with another working directory finds it."""
    return place if "://" in place else os.path.abspath(place)


def _key(kind: str, address: str) -> str:
    return f"{kind}/{address[:2]}/{address}"
