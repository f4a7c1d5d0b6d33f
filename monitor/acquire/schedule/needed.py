"""Whether a replay is needed, where the arm's ordinary work is observed: `[schedule] replay = "when_needed"`.

A replay is needed while the arm is learnt, where evidence asks for one, of a joint of which nothing was told for long, and after
`at_most_days` in any case. The windows stay those of the schedule: one that opens while no replay is needed is left out.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from monitor.acquire.schedule.windows import PULLED_FORWARD, ScheduleSettings, Window
from monitor.reason import Reason, Sentence, joints_by_number
from monitor.recording import DAY_S

ALWAYS, WHEN_NEEDED = "always", "when_needed"
# Half of a day's noise is still there on the next: a replay on every second day tells nine tenths of what a daily one does.
SUSPECTED_DAYS = 2.0  # [d] between the replays that a suspicion asks for, at least
SUSPECTED_SHARE = 1.0 / 6.0  # of `unobserved_days`, likewise: whoever lets a joint be untold for a month wants few replays

EVERY_WINDOW = Sentence("every_window", "every window")
NOTHING_LEARNT_YET = Sentence("nothing_learnt_yet", "nothing is learnt yet")
IS_LEARNT = Sentence("arm_is_learnt", "the first {days:g} days, in which the arm is learnt")
PRODUCTION_ASKS = Sentence("production_asks", "work alone has found wear of {joints}: a replay shall confirm it")
DOUBTED = Sentence("change_doubted", "the last replays make a change of {joints} likely: the next ones shall tell")
PRODUCTION_SUSPECTS = Sentence("production_suspects", "work makes wear of {joints} likely: replays shall tell")
UNTOLD = Sentence("joints_untold", "work does not tell enough of {joints}: after {days:g} days a replay is needed")
AT_LATEST = Sentence("replay_at_latest", "{days:g} days after the last replay")


class Told(NamedTuple):
    """What replays and work have told of the arm so far."""

    began_unix_s: float | None = None  # the first window; None: there was none
    replayed_unix_s: float | None = None  # the last replay that was learned from; None: there was none
    joints_unix_s: tuple[float, ...] = ()  # (J,) when each joint was told of last, by a replay or by work
    asks: tuple[int, ...] = ()  # joints (from 1) of which work alone has found wear
    suspects: tuple[int, ...] = ()  # joints (from 1) of which work makes wear likely
    doubted: tuple[int, ...] = ()  # joints (from 1) of which replays alone tell, and the last ones make a step likely


class Need(NamedTuple):
    """From when a replay is needed, and why."""

    from_unix_s: float  # −∞: now
    why: Reason

    def at(self, unix_s: float) -> bool:
        """Whether it is needed at that time."""
        return self.from_unix_s <= unix_s


def need(settings: ScheduleSettings, told: Told) -> Need:
    """From when the next replay is needed."""
    if settings.replay == ALWAYS:
        return Need(-math.inf, EVERY_WINDOW())
    if told.began_unix_s is None or told.replayed_unix_s is None or not told.joints_unix_s:
        return Need(-math.inf, NOTHING_LEARNT_YET())
    learnt_by = told.began_unix_s + DAY_S * settings.learning_days
    if told.replayed_unix_s < learnt_by:
        return Need(-math.inf, IS_LEARNT(days=settings.learning_days))
    if told.asks:
        return Need(-math.inf, PRODUCTION_ASKS(joints=joints_by_number(told.asks)))
    if told.doubted:
        return Need(-math.inf, DOUBTED(joints=joints_by_number(told.doubted)))
    at_latest = _at_latest(settings, told.replayed_unix_s, told.joints_unix_s)
    if told.suspects:
        again = told.replayed_unix_s + DAY_S * (suspected_days(settings) - 0.5)  # windows are not always at the same time of the day
        if again <= at_latest.from_unix_s:
            return Need(again, PRODUCTION_SUSPECTS(joints=joints_by_number(told.suspects)))
    return at_latest


def _at_latest(settings: ScheduleSettings, replayed_unix_s: float, joints_unix_s: Sequence[float]) -> Need:
    """From when a replay is needed, whatever work has found; arguments as in `Told`."""
    last = replayed_unix_s + DAY_S * settings.at_most_days
    oldest = min(joints_unix_s)
    untold = oldest + DAY_S * settings.unobserved_days
    if untold < last:
        joints = [j + 1 for j, at in enumerate(joints_unix_s) if at + DAY_S * settings.unobserved_days <= max(untold, oldest) + DAY_S]
        return Need(untold, UNTOLD(joints=joints_by_number(joints), days=settings.unobserved_days))
    return Need(last, AT_LATEST(days=settings.at_most_days))


def suspected_days(settings: ScheduleSettings) -> float:
    """Days between the replays that a suspicion asks for."""
    return SUSPECTED_DAYS if settings.replay == ALWAYS else max(SUSPECTED_DAYS, SUSPECTED_SHARE * settings.unobserved_days)


def suspicion_asks(settings: ScheduleSettings, replayed_unix_s: float | None, judged_unix_s: float) -> bool:
    """Whether a suspicion asks for a replay in the day after the work of a day was judged, as in `need`."""
    return replayed_unix_s is None or judged_unix_s - replayed_unix_s >= DAY_S * (suspected_days(settings) - 1.0)


def needed_windows(windows: Sequence[Window], needed: Need) -> list[Window]:
    """The windows in which a replay is needed, as far as can be told now: of those that need one, each needs it until a replay."""
    return [window for window in windows if needed.at(window.closes_unix_s) or window.why in PULLED_FORWARD]


GAP_S = 60.0  # temperatures that were not observed for so long are not known to be steady


class ColdStart:
    """When the arm ran again after a long rest."""

    def __init__(self, last_running_unix_s: float | None) -> None:
        self.last_running_unix_s = last_running_unix_s  # from before this process, where it is known
        self.at_unix_s: float | None = None  # the last cold start
        self._rested = False  # this process has observed the rest: a gap in our own listening is no rest of the arm

    def observe(self, running: bool, now_unix_s: float, after_h: float) -> None:
        """Take note of whether the arm runs now; one that cannot be heard does not. A rest counts from `after_h` on; 0: no rest counts."""
        if not running:
            self._rested = True
            return
        last = self.last_running_unix_s
        if self._rested and after_h > 0 and last is not None and now_unix_s - last >= 3600.0 * after_h:
            self.at_unix_s = now_unix_s
        self._rested, self.last_running_unix_s = False, now_unix_s


class WarmUp:
    """Whether the joints' temperatures are steady: warm from work, or as cold as the room."""

    SPAN_S, STEP_S = 600.0, 10.0  # temperatures of the last 10 min, one every 10 s

    def __init__(self) -> None:
        self._seen: list[tuple[float, tuple[float, ...]]] = []

    def observe(self, temperature_c: Iterable[float], now_unix_s: float) -> None:
        """Take note of the joints' temperatures [°C] now."""
        if self._seen and now_unix_s - self._seen[-1][0] < self.STEP_S:
            if now_unix_s < self._seen[-1][0]:
                self._seen.clear()  # the clock was set back
            return
        self._seen.append((now_unix_s, tuple(temperature_c)))
        while now_unix_s - self._seen[0][0] > self.SPAN_S + 2 * self.STEP_S:
            del self._seen[0]

    def steady(self, now_unix_s: float, within_k: float) -> bool:
        """Whether no joint's temperature changed by more than within_k in SPAN_S, without a gap of GAP_S in the observations."""
        times = [at for at, _ in self._seen]
        if not times or now_unix_s - times[0] < self.SPAN_S:
            return False
        if any(after - before > GAP_S for before, after in zip(times, [*times[1:], now_unix_s], strict=True)):
            return False
        return all(max(joint) - min(joint) <= within_k for joint in zip(*(values for _, values in self._seen), strict=True))
