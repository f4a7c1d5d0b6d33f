"""How an arm is: by which ways it is seen, when it was heard, how far it is copied, and the order in which arms are shown.

No I/O, no clock. Times are those of a monotonic clock, unless their names say otherwise.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

SETTLED_S = 2.0  # after this a token that is gone is gone because its monitor is, not because the way to it is just being lost
AGAIN_S, SELDOM_S = 30.0, 900.0  # until an arm that could not be copied is asked again, at first and at last
MOST_SPEAKERS = 20  # monitors of one arm that are remembered
TWICE_S = 120.0  # within which the monitor before the present one speaks again, where there are two; a restart never does
DOUBLED = "two monitors speak as this arm; give each a [robot] id of its own, or end one of them"
SAVE_MONITOR_S = 60.0  # the document `monitor` comes every ten seconds and changes little: so often it is stored


@dataclass(slots=True)
class Arm:
    """One arm."""

    since: float  # when the plant began to expect it
    number: int | None = None  # in the database; None: not entered yet
    ways: set[str] = field(default_factory=set)  # endpoints behind which its token is
    last_ways: set[str] = field(default_factory=set)  # behind which it was last
    gone: float = 0.0  # since when it is behind none
    heard: float | None = None
    state: str | None = None  # NE 107
    history_id: str | None = None  # as copied
    event: int = -1  # how far each log is copied; -1: not known
    change: int = -1
    problem: str | None = None
    failures: int = 0  # in a row
    due_again: float = 0.0  # after a failure: when the next attempt is
    silent: str | None = None  # why, as the database has it
    monitor_saved: float = -SAVE_MONITOR_S
    troubles: tuple[str, ...] = ()
    _speaker: tuple[object, object] | None = None  # which monitor said `monitor` last: its start, its history
    _before: dict[tuple[object, object], float] = field(default_factory=dict)  # monitors before it: when each was heard last
    _doubled_at: float | None = None  # when one of those before was heard again

    def silence(self, now: float, silent_s: float, lost_ways: Iterable[str]) -> str | None:
        """Why nobody hears this arm's monitor; None where it is heard."""
        ways = self.ways or self.last_ways
        lost = sorted(ways & set(lost_ways))
        if ways and lost == sorted(ways):
            return f"no way to it: {', '.join(lost)} does not answer"
        if not self.ways:
            if now - self.gone < SETTLED_S or (self.heard is None and now - self.since < silent_s):
                return self.silent  # it may still come: the plant has just started, or the token is lost before its router is
            return "its monitor is gone" if self.heard is not None else "not seen since the plant was started"
        if now - (self.since if self.heard is None else self.heard) > silent_s:
            return f"its monitor is there, and has said nothing for more than {silent_s:.0f} s"
        return None

    def copied(self, problem: str | None, now: float) -> None:
        """Note how an attempt to copy its history ended: after failures the next ones come more and more seldom."""
        self.failures = 0 if problem is None else self.failures + 1
        self.due_again = now + min(AGAIN_S * 2.0 ** (self.failures - 1), SELDOM_S)

    def behind(self, document: Mapping[str, Any]) -> bool:
        """Whether an arm's document `monitor` shows that its history goes further than it is copied."""
        store = document.get("store")
        if not isinstance(store, Mapping):
            return False
        event, change, identity = store.get("last_event"), store.get("last_change"), store.get("history_id")
        if not isinstance(event, int) or not isinstance(change, int):
            return False  # an older monitor does not say it
        return (event, change) != (self.event, self.change) or identity != self.history_id

    def hear_monitor(self, document: Mapping[str, Any], now: float) -> None:
        """Note which monitor speaks: two of one name take turns, and a monitor that was started anew never speaks as the old one again."""
        store = document.get("store")
        speaker = (str(document.get("started_at")), str(store.get("history_id")) if isinstance(store, Mapping) else None)
        if speaker == self._speaker:
            return
        self._before = {each: at for each, at in self._before.items() if now - at < TWICE_S}
        if speaker in self._before:
            self._doubled_at = now
        if self._speaker is not None and len(self._before) < MOST_SPEAKERS:
            self._before[self._speaker] = now
        self._speaker = speaker

    def doubled(self, now: float) -> bool:
        """Whether two monitors speak as this arm."""
        return self._doubled_at is not None and now - self._doubled_at < TWICE_S

    def worth_saving(self, key: str, document: Mapping[str, Any], now: float) -> bool:
        """Whether a document must be stored now; the next one of its key comes soon where it need not."""
        if key != "monitor":
            return True
        listed = document.get("troubles")
        troubles = tuple(str(each.get("name")) for each in listed if isinstance(each, Mapping)) if isinstance(listed, list) else ()
        if troubles == self.troubles and now - self.monitor_saved < SAVE_MONITOR_S:
            return False
        self.troubles, self.monitor_saved = troubles, now
        return True


# --- the worst first; an arm that nobody hears is as visible as one that is sick

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
