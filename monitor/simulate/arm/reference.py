"""How the controller follows a stream of servoj targets.

The manufacturer does not publish how servoj smooths its targets. Here the targets are extrapolated with their speed and acceleration
for a few milliseconds, and a critically damped second-order filter follows them. Its bandwidth is 2/lookahead at the usual gain and
grows with the gain. The filter is linear as long as it meets no limit, so all servo periods of a control period are one product of
matrices.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.physics import Target

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


def trapezoid(t: float, speed: float, acceleration: float) -> tuple[float, float, float]:
    """A trapezoid of speed from rest to rest: the share of the way 0 … 1 at time t [s], its rate [1/s] and its acceleration [1/s²]."""
    ramp_s = speed / acceleration
    rest = total_s(speed, acceleration) - t
    if t < ramp_s:
        return 0.5 * acceleration * t * t, acceleration * t, acceleration
    if rest < ramp_s:
        return 1.0 - 0.5 * acceleration * rest * rest, acceleration * rest, -acceleration
    return speed * (t - 0.5 * ramp_s), speed, 0.0


def total_s(speed: float, acceleration: float) -> float:
    """How long a trapezoid lasts [s]."""
    return speed / acceleration + 1.0 / speed


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


# --- The reference of the servo: position, speed and acceleration that the controller asks of the joints at every servo period ---

SLIDER_PER_S = 2.0  # how fast moves follow the speed slider: from full speed to standstill in half a second


class Reference:
    """The present reference: q, q̇, q̈, each (J,). Position and speed are continuous through every change of mode."""

    def __init__(self, robot: Robot, q: Array, tick_s: float) -> None:
        self.q, self.qd, self.qdd = q.copy(), np.zeros_like(q), np.zeros_like(q)
        self._max_speed = robot.max_speed_rad_s
        self._half = np.full_like(self.q, 0.5)  # array · array takes half as long in numpy as array · number at this size
        self._tick_s = tick_s
        self._advance: Callable[[float], object] | None = None  # makes one step of the motion; None while the arm holds
        self._then: Callable[[], None] | None = None  # starts the motion that waits for the present stop
        self.mode = "hold"
        self.speed_slider = 1.0  # 0 … 1; it slows moves down, and has no effect on servoj, speedj and stops
        self._slider_share = 1.0  # follows the slider without a jump
        self.given = np.zeros_like(q)  # how far force control has led the arm off its path

    @property
    def at_rest(self) -> bool:
        """Whether the reference stands. servoj and speedj count as motion even at zero speed."""
        return self._advance is None

    @property
    def queued(self) -> bool:
        """Whether another motion waits for the present stop to end."""
        return self._then is not None

    def steps(self, h: float, n: int) -> list[Target]:
        """Advance n times by h. Returns the mean over each step, where the servo evaluates the reference."""
        return self._servo(h, n) if self.mode == "servo" else [self.step(h) for _ in range(n)]

    def step(self, h: float) -> Target:
        """Advance by h. Returns the mean over the step."""
        if self._advance is None:
            return Target(self.q, self.qd, self.qdd)
        q, qd = self.q, self.qd
        self._advance(h)
        return Target(self._half * (q + self.q), self._half * (qd + self.qd), self.qdd)

    def reset(self, q: Array) -> None:
        """Hold at q (J,), as after a brake release."""
        self.q = q.copy()
        self.hold()

    def give(self, way: Array) -> None:
        """Lead the arm off its path by so much more (J,) [rad], as force control does."""
        self.given, self.q = self.given + way, self.q + way

    def keep(self) -> None:
        """The next motion begins where force control has led the arm."""
        self.given = np.zeros_like(self.q)

    # --- modes --------------------------------------------------------------------------------------------------
    def stop(self, deceleration_rad_s2: float, then: Callable[[], None] | None = None) -> None:
        """Bring all joints to standstill in the same time, the fastest with this deceleration; `then` starts the next motion."""
        deceleration = max(deceleration_rad_s2, 0.01)

        def advance(h: float) -> None:
            fastest = float(np.max(np.abs(self.qd)))
            keep = 1.0 - deceleration * h / fastest if fastest > deceleration * h else 0.0
            self.glide(self.qd * keep, h)
            if keep == 0.0:
                self.hold()
                if self._then is not None:
                    go_on, self._then = self._then, None
                    go_on()

        self.begin("stop", advance)
        self._then = then
        if not self.qd.any():
            advance(1e-9)

    def move(self, q_end: Array, speed_rad_s: float, acceleration_rad_s2: float) -> None:
        """Start a movej: a trapezoid of speed, the same time for all joints. A moving arm stops first."""
        if self.qd.any():
            self.stop(acceleration_rad_s2, lambda: self.move(q_end, speed_rad_s, acceleration_rad_s2))
            return
        start, way = self.q.copy(), q_end - self.q
        length = float(np.max(np.abs(way)))
        if length < 1e-9:
            self.hold()
            return
        v, a = speed_rad_s / length, acceleration_rad_s2 / length  # speed and acceleration of the path parameter s ∈ [0, 1]
        v = min(v, float(np.min(self._max_speed / np.maximum(np.abs(way), 1e-12))), math.sqrt(a))
        end_s, t = total_s(v, a), 0.0

        def advance(h: float) -> None:
            nonlocal t
            share, change = self.slider_share(h)
            t = min(t + share * h, end_s)
            s, sd, sdd = trapezoid(t, v, a)
            self.q, self.qd, self.qdd = start + s * way, (share * sd) * way, (share * share * sdd + change * sd) * way
            if t >= end_s:
                self.hold()

        self.begin("move", advance)

    def speed(self, qd: Array, acceleration_rad_s2: float) -> None:
        """Start a speedj: accelerate to this speed (J,) and keep it until another motion starts."""
        goal = np.clip(qd, -self._max_speed, self._max_speed)
        acceleration = max(acceleration_rad_s2, 0.01)

        def advance(h: float) -> None:
            change = goal - self.qd
            largest = float(np.max(np.abs(change)))
            self.glide(goal if largest <= acceleration * h else self.qd + change * (acceleration * h / largest), h)

        self.begin("speed", advance)

    def follow(self, targets: Sequence[Vector], time_s: float, lookahead_s: float, gain: float) -> None:
        """Follow servoj: `targets` (J,) arrived in this control period, oldest first; one call of servoj lasts `time_s`."""
        period = time_s if time_s > 0.0 else self._tick_s
        if self.mode != "servo":
            self._stream = Servoj(self.q.tolist(), self.qd.tolist(), period, self._tick_s, self._max_speed.tolist())
            self.begin("servo", lambda h: self._servo(h, 1))
        self._stream.receive(targets, period, lookahead_s, gain)

    def _servo(self, h: float, n: int) -> list[Target]:
        rows = self._stream.advance(h, n, self.q, self.qd)
        self.q, self.qd, self.qdd = rows[n]
        return [Target(*row) for row in rows[:n]]

    def slider_share(self, h: float) -> tuple[float, float]:
        """The share of its own speed that a move has in this step of length h, and the rate at which this share changes [1/s]."""
        before, most = self._slider_share, SLIDER_PER_S * h
        self._slider_share = min(max(self.speed_slider, before - most), before + most)
        return self._slider_share, (self._slider_share - before) / h

    def put(self, q: Array, qd: Array, qdd: Array) -> None:
        """Set the reference, each (J,)."""
        self.q, self.qd, self.qdd = q, qd, qdd

    def glide(self, qd: Array, h: float) -> None:
        """Advance by h with constant acceleration to the speed q̇ (J,)."""
        self.q = self.q + (0.5 * h) * (self.qd + qd)
        self.qdd = (qd - self.qd) / h
        self.qd = qd

    def begin(self, mode: str, advance: Callable[[float], object]) -> None:
        """Start another motion. `advance(h)` is called at every step until `hold`."""
        self.mode, self._advance, self._then = mode, advance, None

    def hold(self) -> None:
        """Stand at the present position."""
        self.mode, self._advance = "hold", None
        self.qd, self.qdd = np.zeros_like(self.q), np.zeros_like(self.q)
