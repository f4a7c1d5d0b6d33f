"""Windows of the history, put together where they ended alike."""

from collections.abc import Sequence
from typing import Protocol, TypeVar

from monitor.errors import DOES_NOT_HOLD
from monitor.reason import FREE, Reason


class Ended(Protocol):
    """A window that has ended, or has not."""

    @property
    def state(self) -> str:
        """How it ended."""

    @property
    def reason(self) -> Reason | None:
        """Why."""


Window = TypeVar("Window", bound=Ended)


def cause(reason: Reason | None) -> str:
    """What a window ended by: the condition that a refusal names, else the code of its reason; of a free text the whole."""
    if reason is None:
        return ""
    if reason.code == DOES_NOT_HOLD.code:
        return str(reason.parameters["condition"])
    return reason.text if reason.code == FREE else reason.code


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
