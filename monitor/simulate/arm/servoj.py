"""How this controller follows a stream of servoj targets.

How the manufacturer's servoj smooths its targets is not published. Here: the targets are carried on with their speed for a few
milliseconds, and a critically damped second-order filter follows them, twice as fast as 1/lookahead and faster with more gain.
Unless it meets a limit the filter is linear, so that all servo periods of a tick are one product of matrices.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from monitor.recording import Array

SERVO_MAX_RAD_S2 = 30.0  # the filter never asks for more: twice what an excitation needs, about what the drives can give
SPEED_CHANGE_MAX_RAD_S2 = 40.0  # faster changes of the targets' speed are jitter of the network
ACCELERATION_TRUST = 0.5  # share of each newly seen acceleration: two targets of memory
TURN_TRUST = 0.1  # share of each newly seen change of it: ten of memory, or the network's jitter would shake the arm
# What is seen so is two targets old. Its change is carried on: for the speed at the newest target to a quarter of a target later, and for
# the acceleration from there on to one and a half. Else every target comes as a push, which at a tick's end, where currents and
# accelerations are read, is over again: a recording would be 15 ms late in them.
TARGETS_TO_NOW, TARGETS_AHEAD = 2.25, 3.5
ROUGH_RAD_S3, ROUGH_TARGETS = 150.0, 10  # our excitations stay below 20; after more, most often jitter, no change is carried on
STREAM_BURST = 8  # targets, or periods of silence, that are still put in order
FIT_CLEAR_RAD, FIT_BETTER = 1e-3, 0.25  # at low speed every place fits, and a wrong one would confirm itself
SPACING_PRIOR, SPACING_KEEP = 5.0, 0.98  # the spacing of targets is learnt over some fifty
SPACING_NOMINAL = 0.15  # and is the one that servoj was told if it is so near
PHASE_KEEP = 0.9  # a stream's place in time is forgotten in ten targets
STREAM_GAP_PERIODS = 2.0  # so much longer the motion is carried on when a target is late
BACK_RAD_S = 20.0  # how briskly: 1 rad/s is braked with 20–30 rad/s²
STREAM_GAP_BACK_S = 0.1  # and in this time it goes back to the last target if none comes

Vector = Sequence[float]  # (J,)


class Servoj:
    """One stream of targets, from its first to whatever ends it."""

    def __init__(self, q: Vector, qd: Vector, period_s: float, tick_s: float, max_speed_rad_s: Vector) -> None:
        """Begins at q with q̇ (J,), targets being told to come every `period_s`."""
        self._tick_s, self._max_speed = tick_s, max_speed_rad_s
        self._goal, self._goal_qd, self._between_qd = list(q), list(qd), list(qd)
        self._goal_qdd, self._seen_qdd, self._turns = [0.0] * len(q), [0.0] * len(q), [0.0] * len(q)
        self._rough = [0] * len(q)  # targets for which no change of the joint's acceleration is to be believed
        self._waiting: list[Vector] = []  # not yet taken
        self._first = True  # no target has come yet
        self._age_s = math.inf  # of the newest target
        self._heard_s, self._heard = SPACING_PRIOR * period_s, SPACING_PRIOR
        self._goals, self._rows, self._bound = np.zeros((3, len(q))), np.zeros((5, len(q))), np.zeros((0, len(q)))

    def tell(self, targets: Sequence[Vector], period_s: float, lookahead_s: float, gain: float) -> None:
        """The targets that arrived in this tick, oldest first, possibly none: those that come faster wait, and the newest counts."""
        self._carry_s = period_s * (1.0 + STREAM_GAP_PERIODS)
        self._rate = 2.0 / lookahead_s * math.sqrt(gain / 500.0)
        self._waiting = [*self._waiting, *targets][-STREAM_BURST:]
        if self._waiting and self._age_s > period_s - 0.75 * self._tick_s:
            self._take(self._waiting[-1], len(self._waiting), period_s)
            self._waiting = []

    def _take(self, target: Vector, arrived: int, period: float) -> None:
        """The newest target: its speed from the one before, and its place in time.

        The network makes targets late and bunches them, so their place follows from how many came and how far apart they come
        on the average; where some were never sent, from where the motion so far expects them.
        """
        if self._first:  # has no speed
            self._between_qd, self._goal_qdd, self._seen_qdd, self._turns, self._first = *([0.0] * len(target) for _ in range(4)), False
            self._goal, self._age_s = list(target), 0.0
            self._goals = np.array((self._goal, self._goal_qd, self._goal_qdd))
            return
        if self._age_s < STREAM_BURST * period:  # longer silence is no spacing
            self._heard_s = SPACING_KEEP * self._heard_s + self._age_s
            self._heard = SPACING_KEEP * self._heard + arrived
        spacing = self._heard_s / self._heard
        spacing = period if abs(spacing / period - 1.0) < SPACING_NOMINAL else spacing
        late = round(self._age_s / spacing) - arrived
        count = arrived if late <= 0 else self._fitting(target, spacing, arrived, min(late, STREAM_BURST))
        between = count * spacing
        room, half, most = SPEED_CHANGE_MAX_RAD_S2 * between, 0.5 * between, ROUGH_RAD_S3 * between
        between_qd, goal_qd, goal_qdd = self._between_qd, self._goal_qd, self._goal_qdd
        seen, turns, rough = self._seen_qdd, self._turns, self._rough
        for j, (new, old, qd, before) in enumerate(zip(target, self._goal, between_qd, seen, strict=True)):
            change = (new - old) / between - qd
            if not -room <= change <= room:
                change = min(max(change, -room), room)
            between_qd[j] = speed = qd + change
            seen[j] = acceleration = before + ACCELERATION_TRUST * (change / between - before)
            rough[j] = ROUGH_TARGETS if not -most <= acceleration - before <= most else max(0, rough[j] - 1)
            turns[j] = turn = 0.0 if rough[j] else turns[j] + TURN_TRUST * (acceleration - before - turns[j])
            goal_qd[j] = speed + half * (acceleration + TARGETS_TO_NOW * turn)
            goal_qdd[j] = acceleration + TARGETS_AHEAD * turn
        self._age_s = min(max(PHASE_KEEP * (self._age_s - between), -period), 2.0 * period)
        self._goal = list(target)
        self._goals = np.array((self._goal, self._goal_qd, self._goal_qdd))

    def _fitting(self, target: Vector, spacing: float, arrived: int, late: int) -> int:
        """How many places on the newest target is: as many as arrived, unless the motion so far clearly says that some were skipped."""

        def miss(count: int) -> float:
            t = count * spacing
            expected = [q + t * (qd + 0.5 * t * qdd) for q, qd, qdd in zip(self._goal, self._goal_qd, self._goal_qdd, strict=True)]
            return math.dist(target, expected)

        best = min(range(arrived, arrived + late + 1), key=miss)
        denied = miss(arrived) > FIT_CLEAR_RAD and miss(best) < FIT_BETTER * miss(arrived)
        return best if denied else arrived

    def advance(self, h: float, n: int, q: Array, qd: Array) -> Array:
        """Take n steps of length h from q, q̇ (J,): per step the mean q, the mean q̇ and q̈; last q, q̇, q̈ at the end: (n + 1, 3, J)."""
        if not self._first and self._age_s + n * h <= self._carry_s:
            a = self._age_s
            rows = self._rows
            rows[:3] = np.array(((1.0, a, 0.5 * a * a), (0.0, 1.0, a), (0.0, 0.0, 1.0))).dot(self._goals)  # (3, J): where the goal is now
            rows[3], rows[4] = q, qd
            ahead: Array = gains(self._rate, h, n).dot(rows)  # (3n + 3, J)
            if b"\0" not in (np.abs(ahead) <= self._bounds(n)).tobytes():
                self._age_s += n * h
                return ahead.reshape(n + 1, 3, -1)
        return np.array(self._step_by_step(h, n, q.tolist(), qd.tolist())).reshape(n + 1, 3, -1)

    def _bounds(self, n: int) -> Array:
        """(3n + 3, J) of what `advance` finds: none of q, of q̇ and q̈ the filter's."""
        if len(self._bound) != 3 * (n + 1):
            one = np.array([[math.inf] * len(self._goal), self._max_speed, [SERVO_MAX_RAD_S2] * len(self._goal)])  # (3, J)
            self._bound = np.tile(one, (n + 1, 1))
        return self._bound

    def _step_by_step(self, h: float, n: int, q: list[float], qd: list[float]) -> list[float]:
        """What `advance` finds, flat, with the limits."""
        flat: list[float] = []
        qdd = [0.0] * len(q)
        for _ in range(n):
            wanted = self._wanted(h, q, qd)
            q_mean, qd_mean = [], []
            for j, (acceleration, before, fastest) in enumerate(zip(wanted, qd, self._max_speed, strict=True)):
                speed = min(max(before + h * min(max(acceleration, -SERVO_MAX_RAD_S2), SERVO_MAX_RAD_S2), -fastest), fastest)
                mean = 0.5 * (before + speed)
                q_mean.append(q[j] + 0.5 * h * mean)
                qd_mean.append(mean)
                q[j] += h * mean
                qdd[j] = (speed - before) / h
                qd[j] = speed
            flat += [*q_mean, *qd_mean, *qdd]
        return [*flat, *q, *qd, *qdd]

    def _wanted(self, h: float, q: list[float], qd: list[float]) -> list[float]:
        """(J,) acceleration that the filter asks for, before its limits."""
        if self._first:  # no target has come yet: brake
            return [-0.5 * speed / h for speed in qd]
        self._age_s += h
        age, w = min(self._age_s, self._carry_s), self._rate
        goals = zip(self._goal, self._goal_qd, self._goal_qdd, q, qd, strict=True)
        if age == self._age_s:  # g̈ + 2w·(ġ + a·g̈ − q̇) + w²·(g + a·ġ + a²/2·g̈ − q)
            on_speed, on_acceleration = w * (2.0 + w * age), 1.0 + w * age * (2.0 + 0.5 * w * age)
            return [w * w * (g - at) + on_speed * gd + on_acceleration * gdd - 2.0 * w * speed for g, gd, gdd, at, speed in goals]
        away = max(0.0, 1.0 - (self._age_s - age) / STREAM_GAP_BACK_S)  # no target any more: back to the last one
        on_way = away * age
        return [BACK_RAD_S**2 * (g + on_way * (gd + 0.5 * age * gdd) - at) - 2.0 * BACK_RAD_S * speed for g, gd, gdd, at, speed in goals]


@lru_cache(maxsize=64)
def gains(rate: float, h: float, n: int) -> Array:
    """(3n + 3, 5): what `advance` finds without limits, from g, ġ, g̈ now, q and q̇."""
    rows = []
    q, qd = np.eye(5)[3], np.eye(5)[4]  # each as weights of the five
    for i in range(1, n + 1):
        a = i * h
        qdd = np.array([rate * rate, rate * (2.0 + rate * a), 1.0 + rate * a * (2.0 + 0.5 * rate * a), 0.0, 0.0])
        qdd = qdd - rate * rate * q - 2.0 * rate * qd
        speed = qd + h * qdd
        mean = 0.5 * (qd + speed)
        rows += [q + 0.5 * h * mean, mean, qdd]
        q, qd = q + h * mean, speed
    return np.array([*rows, q, qd, qdd])
