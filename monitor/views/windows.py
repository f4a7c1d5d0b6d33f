"""Windows of the history, put together where they ended alike."""

import re
from collections.abc import Sequence
from typing import Protocol, TypeVar

from monitor.reason import FREE, Reason

LONGEST_CAUSE = 60  # letters; a longer beginning of a reason is no name of a cause


class Ended(Protocol):
    """A window that has ended, or has not."""

    @property
    def state(self) -> str:
        """How it ended."""

    @property
    def reason(self) -> str | Reason | None:
        """Why, in words or as a value."""


Window = TypeVar("Window", bound=Ended)


def cause(reason: str | Reason | None) -> str:
    """The code of a reason; of one without a code, the cause that its text names before its details, figures left out."""
    if isinstance(reason, Reason) and reason.code != FREE:
        return reason.code
    text = str(reason or "")
    name, colon, _ = text.partition(":")
    if colon and len(name) <= LONGEST_CAUSE:
        return name.strip()
    return re.sub(r"[-+]?\d[\d.,:TZ-]*", "…", text).strip()


def runs(windows: Sequence[Window]) -> list[list[Window]]:
    """The windows in their order, those that ended alike one after another together."""
    found: list[list[Window]] = []
    for window in windows:
        before = found[-1][-1] if found else None
        if before is not None and (before.state, cause(before.reason)) == (window.state, cause(window.reason)):
            found[-1].append(window)
        else:
            found.append([window])
    return found
