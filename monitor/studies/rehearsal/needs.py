"""When each arm of a fleet needs a replay, by the daemon's own decision: `[schedule] replay = "when_needed"`.

What the daemon reads in its history is kept here as arrays: when a replay was learnt from, when each joint was told of last, and of which
joints work has found wear, or makes it likely, or the last replays a change. Nobody acknowledges an alert: once raised, it stays active.
"""

import numpy as np

from monitor.acquire.schedule.needed import SUSPECTED_DAYS, Told, need
from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.recording import DAY_S, Array

WINDOW_DAY = 0.125  # [d] a window opens at 3 o'clock, and the day before was judged at midnight


class Needs:
    """What replays and work have told of A arms with J joints so far. Days count from the first window."""

    def __init__(self, arms: int, joints: int) -> None:
        self._replayed = np.full(arms, np.nan)  # [d] the last replay that was learned from
        self._joints = np.full((arms, joints), -np.inf)  # [d] when each joint was told of last
        self._asks, self._suspects = np.zeros((arms, joints), dtype=bool), np.zeros((arms, joints), dtype=bool)
        self._doubted = np.zeros((arms, joints), dtype=bool)
        self._active = np.full((arms, joints), -1.0)  # tier of each joint's alert, −1: none

    def asked(self, day: int) -> np.ndarray:
        """(A,) arms of which work asks for a replay on the morning of a day: of a suspicion on every second one."""
        again = ~(day - self._replayed < SUSPECTED_DAYS - 0.5)
        asked: np.ndarray = np.any(self._asks, axis=1) | (np.any(self._suspects, axis=1) & again)
        return asked

    def at(self, day: int, schedule: ScheduleSettings) -> np.ndarray:
        """(A,) arms that replay in the window of a day."""
        closes = DAY_S * (day + WINDOW_DAY) + schedule.grace_s
        return np.array([need(schedule, self._told(arm)).at(closes) for arm in range(len(self._replayed))])

    def replayed(self, day: float, learnt: np.ndarray, tier: Array, doubted: np.ndarray) -> None:
        """After replays. learnt : (A, J) joints that learned from one; tier : (A, J) to which alerts may be raised, −1: none.

        doubted : (A, J) as `doubted_rise`.
        """
        here: np.ndarray = np.any(learnt, axis=1)
        self._replayed = np.where(here, day, self._replayed)
        self._asks &= ~here[:, None]
        self._suspects &= ~here[:, None]
        self._doubted = doubted
        self._heard(day, learnt, tier)

    def worked(self, day: float, learnt: np.ndarray, tier: Array, wanted: Array, suspected: np.ndarray) -> None:
        """After days of work, as `assess_work` does it. wanted : (A, J) the tier that replays would have raised; suspected : (A, J)."""
        self._heard(day, learnt, tier)
        heard: np.ndarray = np.any(learnt, axis=1)
        asks = learnt & (wanted > self._active)
        self._asks = asks | (self._asks & ~learnt)
        self._suspects = np.where(heard[:, None], suspected & learnt & ~self._asks, self._suspects)

    def _heard(self, day: float, learnt: np.ndarray, tier: Array) -> None:
        self._joints = np.where(learnt, day, self._joints)
        self._active = np.maximum(self._active, tier)

    def _told(self, arm: int) -> Told:
        replayed = self._replayed[arm]
        return Told(
            began_unix_s=0.0,
            replayed_unix_s=None if np.isnan(replayed) else DAY_S * float(replayed),
            joints_unix_s=tuple((DAY_S * self._joints[arm]).tolist()),
            asks=_numbers(self._asks[arm]),
            suspects=_numbers(self._suspects[arm]),
            doubted=_numbers(self._doubted[arm]),
        )


def _numbers(joints: np.ndarray) -> tuple[int, ...]:
    return tuple(int(j) + 1 for j in np.flatnonzero(joints))
