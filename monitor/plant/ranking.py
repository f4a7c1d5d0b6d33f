"""The order in which arms are shown: the worst first; an arm that nobody hears is as visible as one that is sick. No I/O."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

SICK, UNSEEN, DOUBTFUL, WELL = range(4)  # the worst first
GRADES = ("sick", "unseen", "doubtful", "well")
_OF_STATE = {"FAILURE": SICK, "MAINTENANCE_REQUIRED": SICK, "OFF_SPEC": DOUBTFUL, "CHECK_FUNCTION": DOUBTFUL, "NORMAL": WELL}
_WORST_FIRST = tuple(_OF_STATE)
CLOCK_S = 120.0  # two clocks that are kept differ by less, what a document takes on its way included


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmStatus:
    """One arm as the plant knows it."""

    site: str
    robot: str
    model: str | None
    state: str | None  # NE 107, as the arm said it last; None: no replay is assessed yet, or nothing was heard
    why: str | None
    since: str | None
    stale: bool  # nothing was learnt for a long time: the state is of then
    silent_since_unix_s: float | None  # None: the arm's monitor is heard
    silent_why: str | None
    problem: str | None  # why its history cannot be copied; None: it can
    alerts: int  # active ones
    unacknowledged: int  # of these
    troubles: tuple[str, ...]  # of its monitor
    last_replay: str | None
    version: str | None
    joints: tuple[str | None, ...] = ()  # the state of each
    active_alerts: tuple[Mapping[str, Any], ...] = ()  # as the arm says them
    histories: int  # 1, and one more for each time that its history was restored or replaced
    clock_ahead_s: float | None = None  # of its monitor's clock before the plant's, when it was heard last; None: not known
    same_history: tuple[str, ...] = ()  # other arms that have the very same one: it was renamed, or its disk was copied

    @property
    def clock_differs(self) -> bool:
        """Whether its clock or the plant's is wrong. Of an arm that is not heard its last word may just be old."""
        return self.clock_ahead_s is not None and abs(self.clock_ahead_s) > CLOCK_S and self.silent_since_unix_s is None

    @property
    def grade(self) -> int:
        """SICK, UNSEEN, DOUBTFUL or WELL: the worst that holds."""
        grades = [_OF_STATE.get(self.state or "", DOUBTFUL)]
        if self.silent_since_unix_s is not None or self.stale:
            grades.append(UNSEEN)
        if self.problem is not None or self.troubles or self.clock_differs:
            grades.append(DOUBTFUL)
        return min(grades)


def worst_first(arms: list[ArmStatus]) -> list[ArmStatus]:
    """By grade, then by state, then the one with more alerts that nobody has acknowledged, then by name."""

    def rank(arm: ArmStatus) -> tuple[int, int, int, str, str]:
        state = _WORST_FIRST.index(arm.state) if arm.state in _WORST_FIRST else len(_WORST_FIRST)
        return arm.grade, state, -arm.unacknowledged, arm.site, arm.robot

    return sorted(arms, key=rank)
