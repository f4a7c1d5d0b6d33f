"""Does a recording contradict what was declared of it? Weights that changed without a word are a payload, a mounting or a gain.

The rigid parameters of every replay are compared with the mean of those before in the same context. A change of them is not wear:
wear does not weigh anything.
"""

from typing import NamedTuple


class Contradiction(NamedTuple):
    """Which condition, if any, and in words."""

    condition: str | None
    text: str


NOTHING_SAID = Contradiction(None, "")
