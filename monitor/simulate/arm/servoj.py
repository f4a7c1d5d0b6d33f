"""How the controller follows a stream of servoj targets.

The manufacturer does not publish how servoj smooths its targets. Here the targets are extrapolated with their speed and acceleration
for a few milliseconds, and a critically damped second-order filter follows them. Its bandwidth is 2/lookahead at the usual gain and
grows with the gain. The filter is linear as long as it meets no limit, so all servo periods of a control period are one product of
matrices.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from monitor.recording import Array

SERVO_MAX_RAD_S2 = 30.0  # largest acceleration of the filter: twice what an excitation needs, about what the drives can give
SPEED_CHANGE_MAX_RAD_S2 = 40.0  # faster changes of the targets' speed count as jitter of the network
ACCELERATION_GAIN = 0.5  # weight of a new acceleration in the running estimate: a memory of two targets
QDD_CHANGE_GAIN = 0.1  # weight of a new change of acceleration: a memory of ten targets, so that jitter does not shake the arm
# The estimate of the acceleration is two targets old. It is extrapolated with its change: to a quarter of a target after the newest one
# for the speed there, and to one and a half targets after it for the acceleration from there on. Without this, every target would cause a
# short push that is over at the end of the control period, where currents and accelerations are read: both would be recorded 15 ms late.
TARGETS_TO_NOW, TARGETS_AHEAD = 2.25, 3.5
# After a larger jerk, which is mostly jitter, ten targets are extrapolated without the change of acceleration. Excitations stay below 20.
ROUGH_RAD_S3, ROUGH_TARGETS = 150.0, 10
STREAM_BURST = 8  # targets, or periods of silence, that can still be ordered in time
FIT_CLEAR_RAD, FIT_BETTER = 1e-3, 0.25  # an error must be this large, and the better fit this much smaller: at low speed every time fits
SPACING_PRIOR, SPACING_KEEP = 5.0, 0.98  # the spacing of targets is estimated over some fifty of them
SPACING_NOMINAL = 0.15  # an estimate within this share of servoj's argument `time` is replaced by the argument
PHASE_KEEP = 0.9  # the phase of a stream is estimated over ten targets
STREAM_GAP_PERIODS = 2.0  # when a target is late, the motion is extrapolated for so many periods more
BACK_RAD_S = 20.0  # bandwidth of the return to the last target: it brakes 1 rad/s with 20–30 rad/s²
STREAM_GAP_BACK_S = 0.1  # time within which the extrapolation fades out when no target comes

Vector = Sequence[float]  # (J,)


class Servoj:
    """One stream of targets."""

    def __init__(self, q: Vector, qd: Vector, period_s: float, tick_s: float, max_speed_rad_s: Vector) -> None:
        """Begin at q with q̇, each (J,). Targets are expected every `period_s`."""
        self._tick_s, self._max_speed = tick_s, max_speed_rad_s
        self._goal, self._goal_qd, self._between_qd = list(q), list(qd), list(qd)
        self._goal_qdd, self._estimated_qdd, self._qdd_changes = [0.0] * len(q), [0.0] * len(q), [0.0] * len(q)
        self._rough = [0] * len(q)  # for each joint, the targets left that are extrapolated without the change of acceleration
        self._waiting: list[Vector] = []  # targets that have not been used yet
        self._first = True  # no target has arrived yet
        self._age_s = math.inf  # time since the newest target
        self._spacings_s, self._spacings = SPACING_PRIOR * period_s, SPACING_PRIOR
        self._goals, self._rows, self._bound = np.zeros((3, len(q))), np.zeros((5, len(q))), np.zeros((0, len(q)))

    def receive(self, targets: Sequence[Vector], period_s: float, lookahead_s: float, gain: float) -> None:
        """Take the targets that arrived in this control period, oldest first. Where they come faster than `period_s`, the newest counts."""
        self._extrapolate_s = period_s * (1.0 + STREAM_GAP_PERIODS)
        self._rate = 2.0 / lookahead_s * math.sqrt(gain / 500.0)
        self._waiting = [*self._waiting, *targets][-STREAM_BURST:]
        if self._waiting and self._age_s > period_s - 0.75 * self._tick_s:
            self._take(self._waiting[-1], len(self._waiting), period_s)
            self._waiting = []

    def _take(self, target: Vector, arrived: int, period: float) -> None:
        """Use the newest target: estimate its time, its speed and its acceleration.

        The network delays targets and delivers them in bunches. So the time of a target follows from the number of targets that arrived
        and from their average spacing. If targets may have been skipped, the extrapolated motion decides how many.
        """
        if self._first:  # it has no speed yet
            self._between_qd, self._goal_qdd, self._estimated_qdd, self._qdd_changes = ([0.0] * len(target) for _ in range(4))
            self._first = False
            self._goal, self._age_s = list(target), 0.0
            self._goals = np.array((self._goal, self._goal_qd, self._goal_qdd))
            return
        if self._age_s < STREAM_BURST * period:  # a longer silence says nothing about the spacing
            self._spacings_s = SPACING_KEEP * self._spacings_s + self._age_s
            self._spacings = SPACING_KEEP * self._spacings + arrived
        spacing = self._spacings_s / self._spacings
        spacing = period if abs(spacing / period - 1.0) < SPACING_NOMINAL else spacing
        late = round(self._age_s / spacing) - arrived
        count = arrived if late <= 0 else self._fitting(target, spacing, arrived, min(late, STREAM_BURST))
        between = count * spacing
        room, half, most = SPEED_CHANGE_MAX_RAD_S2 * between, 0.5 * between, ROUGH_RAD_S3 * between
        between_qd, goal_qd, goal_qdd = self._between_qd, self._goal_qd, self._goal_qdd
        estimated, qdd_changes, rough = self._estimated_qdd, self._qdd_changes, self._rough
        for j, (new, old, qd, before) in enumerate(zip(target, self._goal, between_qd, estimated, strict=True)):
            change = (new - old) / between - qd
            if not -room <= change <= room:
                change = min(max(change, -room), room)
            between_qd[j] = speed = qd + change
            estimated[j] = acceleration = before + ACCELERATION_GAIN * (change / between - before)
            rough[j] = ROUGH_TARGETS if not -most <= acceleration - before <= most else max(0, rough[j] - 1)
            qdd_changes[j] = qdd_change = 0.0 if rough[j] else qdd_changes[j] + QDD_CHANGE_GAIN * (acceleration - before - qdd_changes[j])
            goal_qd[j] = speed + half * (acceleration + TARGETS_TO_NOW * qdd_change)
            goal_qdd[j] = acceleration + TARGETS_AHEAD * qdd_change
        self._age_s = min(max(PHASE_KEEP * (self._age_s - between), -period), 2.0 * period)
        self._goal = list(target)
        self._goals = np.array((self._goal, self._goal_qd, self._goal_qdd))

    def _fitting(self, target: Vector, spacing: float, arrived: int, late: int) -> int:
        """By how many spacings the newest target follows the one before: the number that arrived, unless some were clearly skipped."""

        def misfit(count: int) -> float:
            t = count * spacing
            expected = [q + t * (qd + 0.5 * t * qdd) for q, qd, qdd in zip(self._goal, self._goal_qd, self._goal_qdd, strict=True)]
            return math.dist(target, expected)

        best = min(range(arrived, arrived + late + 1), key=misfit)
        skipped = misfit(arrived) > FIT_CLEAR_RAD and misfit(best) < FIT_BETTER * misfit(arrived)
        return best if skipped else arrived

    def advance(self, h: float, n: int, q: Array, qd: Array) -> Array:
        """Take n steps of length h from q, q̇ (J,). Returns (n + 1, 3, J): mean q, mean q̇ and q̈ of each step, then q, q̇, q̈ at the end."""
        if not self._first and self._age_s + n * h <= self._extrapolate_s:
            a = self._age_s
            rows = self._rows
            # (3, J): the target, extrapolated to now
            rows[:3] = np.array(((1.0, a, 0.5 * a * a), (0.0, 1.0, a), (0.0, 0.0, 1.0))).dot(self._goals)
            rows[3], rows[4] = q, qd
            ahead: Array = gains(self._rate, h, n).dot(rows)  # (3n + 3, J)
            if b"\0" not in (np.abs(ahead) <= self._bounds(n)).tobytes():
                self._age_s += n * h
                return ahead.reshape(n + 1, 3, -1)
        return np.array(self.step_by_step(h, n, q.tolist(), qd.tolist())).reshape(n + 1, 3, -1)

    def _bounds(self, n: int) -> Array:
        """(3n + 3, J) bounds of the results of `advance`: infinite for q, the limits of the filter for q̇ and q̈."""
        if len(self._bound) != 3 * (n + 1):
            one = np.array([[math.inf] * len(self._goal), self._max_speed, [SERVO_MAX_RAD_S2] * len(self._goal)])  # (3, J)
            self._bound = np.tile(one, (n + 1, 1))
        return self._bound

    def step_by_step(self, h: float, n: int, q: list[float], qd: list[float]) -> list[float]:
        """The results of `advance` as a flat list, computed in a loop that keeps the limits."""
        flat: list[float] = []
        qdd = [0.0] * len(q)
        for _ in range(n):
            wanted = self._wanted_qdd(h, q, qd)
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

    def _wanted_qdd(self, h: float, q: list[float], qd: list[float]) -> list[float]:
        """(J,) acceleration that the filter asks for, before the limits apply."""
        if self._first:  # no target has arrived yet: brake
            return [-0.5 * speed / h for speed in qd]
        self._age_s += h
        age, w = min(self._age_s, self._extrapolate_s), self._rate
        goals = zip(self._goal, self._goal_qd, self._goal_qdd, q, qd, strict=True)
        if age == self._age_s:  # g̈ + 2w·(ġ + a·g̈ − q̇) + w²·(g + a·ġ + a²/2·g̈ − q)
            on_speed, on_acceleration = w * (2.0 + w * age), 1.0 + w * age * (2.0 + 0.5 * w * age)
            return [w * w * (g - at) + on_speed * gd + on_acceleration * gdd - 2.0 * w * speed for g, gd, gdd, at, speed in goals]
        away = max(0.0, 1.0 - (self._age_s - age) / STREAM_GAP_BACK_S)  # targets have stopped: return to the last one
        on_way = away * age
        return [BACK_RAD_S**2 * (g + on_way * (gd + 0.5 * age * gdd) - at) - 2.0 * BACK_RAD_S * speed for g, gd, gdd, at, speed in goals]


@lru_cache(maxsize=64)
def gains(rate: float, h: float, n: int) -> Array:
    """(3n + 3, 5) matrix of `advance` without limits: it acts on the target g, ġ, g̈ now and on q and q̇."""
    rows = []
    q, qd = np.eye(5)[3], np.eye(5)[4]  # each as its weights of g, ġ, g̈, q, q̇
    for i in range(1, n + 1):
        a = i * h
        qdd = np.array([rate * rate, rate * (2.0 + rate * a), 1.0 + rate * a * (2.0 + 0.5 * rate * a), 0.0, 0.0])
        qdd = qdd - rate * rate * q - 2.0 * rate * qd
        speed = qd + h * qdd
        mean = 0.5 * (qd + speed)
        rows += [q + 0.5 * h * mean, mean, qdd]
        q, qd = q + h * mean, speed
    return np.array([*rows, q, qd, qdd])
