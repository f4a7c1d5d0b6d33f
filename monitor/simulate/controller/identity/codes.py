"""Error codes of the manufacturer's list that this controller reports on the primary port."""

from typing import NamedTuple


class ErrorCode(NamedTuple):
    """A code of the manufacturer's list, and how grave it is: 2 a warning, 3 a violation."""

    number: int
    level: int


DEVIATES = ErrorCode(153, 3)  # "position deviates from path": what the supervision of the arm reports, whatever the reason
ASKED = ErrorCode(209, 2)  # "a protective stop was triggered": by a program
