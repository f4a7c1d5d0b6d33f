"""The time that a person names of what was done: work on a joint, a check."""

from monitor.errors import BadInput
from monitor.publish.timestamps import unix_s

CLOCK_S = 300.0  # [s] a person's clock may be ahead of ours by so much


def declared_time(text: str, now_unix_s: float, instead: str) -> float:
    """The time [Unix s] that a person names of something done, now where that person's clock is a little ahead.

    Raises BadInput where it is none, or yet to come; `instead` says what to do then.
    """
    try:
        at = unix_s(text)
    except ValueError:
        raise BadInput(f"at {text!r}: not a date or time; expected e.g. 2026-01-31 or 2026-01-31T14:00:00Z") from None
    if at > now_unix_s + CLOCK_S:
        raise BadInput(f"at {text!r}: that is yet to come; {instead}")
    return min(at, now_unix_s)
