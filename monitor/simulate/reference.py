"""Reference: what the controller asks of the joints at every servo period: hold, follow servoj, speedj, movej, stop.

How the manufacturer's servoj smooths its targets is not published. Here: the targets are carried on with their speed for a few
milliseconds, and a critically damped second-order filter follows them, twice as fast as 1/lookahead and faster with more gain.
"""

import math
from collections.abc import Callable

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.physics import Target

SERVO_MAX_RAD_S2 = 30.0  # the filter never asks for more: twice what an excitation needs, about what the drives can give
SPEED_CHANGE_MAX_RAD_S2 = 40.0  # faster changes of the targets' speed are jitter of the network
ACCELERATION_TRUST = 0.5  # share of each newly seen acceleration: two targets of memory
STREAM_BURST = 8  # targets, or periods of silence, that are still put in order
FIT_CLEAR_RAD, FIT_BETTER = 1e-3, 0.25  # at low speed every place fits, and a wrong one would confirm itself
SPACING_PRIOR, SPACING_KEEP = 5.0, 0.98  # the spacing of targets is learnt over some fifty
SPACING_NOMINAL = 0.15  # and is the one that servoj was told if it is so near
PHASE_KEEP = 0.9  # a stream's place in time is forgotten in ten targets
STREAM_GAP_PERIODS = 2.0  # so much longer the motion is carried on when a target is late
BACK_RAD_S = 20.0  # how briskly: 1 rad/s is braked with 20–30 rad/s²
STREAM_GAP_BACK_S = 0.1  # and in this time it goes back to the last target if none comes


class Reference:
    """Position, speed and acceleration asked for, continuous through every change of mode."""

    def __init__(self, robot: Robot, q: Array, tick_s: float) -> None:
        self.q, self.qd, self.qdd = q.copy(), np.zeros_like(q), np.zeros_like(q)
        self._max_speed, self._min_speed = robot.max_speed_rad_s, -robot.max_speed_rad_s
        self._strongest = np.full_like(self.q, SERVO_MAX_RAD_S2)
        self._half = np.full_like(self.q, 0.5)  # array · array takes numpy half as long as array · number at this size
        self._pulls = np.zeros((4, len(self.q)))  # what the servo filter weighs: distance, target's speed, its acceleration, own speed
        self._tick_s = tick_s
        self._advance: Callable[[float], None] | None = None  # None: hold
        self._waiting: list[Array] = []  # servoj targets not yet taken
        self._then: Callable[[], None] | None = None
        self.mode = "hold"
        self.pace = 1.0  # of the speed slider: moves go so much slower; servoj, speedj and stops do not

    @property
    def at_rest(self) -> bool:
        """Nothing is being asked for but to stand; servoj and speedj count as motion even at zero speed."""
        return self._advance is None

    def step(self, h: float) -> Target:
        """Go on by h; the mean over the step, where the servo evaluates it."""
        if self._advance is None:
            return Target(self.q, self.qd, self.qdd)
        q, qd = self.q, self.qd
        self._advance(h)
        return Target(self._half * (q + self.q), self._half * (qd + self.qd), self.qdd)

    def reset(self, q: Array) -> None:
        """Stand at q: after brakes or power-on."""
        self.q = q.copy()
        self.hold()

    # --- modes --------------------------------------------------------------------------------------------------
    def stop(self, deceleration_rad_s2: float, then: Callable[[], None] | None = None) -> None:
        """All joints to standstill in the same time, the fastest with this deceleration."""
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
        """movej: trapezoid, all joints in the same time; from motion, after a stop."""
        if self.qd.any():
            self.stop(acceleration_rad_s2, lambda: self.move(q_end, speed_rad_s, acceleration_rad_s2))
            return
        start, way = self.q.copy(), q_end - self.q
        length = float(np.max(np.abs(way)))
        if length < 1e-9:
            self.hold()
            return
        v, a = speed_rad_s / length, acceleration_rad_s2 / length  # of the path parameter s ∈ [0, 1]
        v = min(v, float(np.min(self._max_speed / np.maximum(np.abs(way), 1e-12))), math.sqrt(a))
        ramp_s, total_s = v / a, v / a + 1.0 / v
        t = 0.0

        def advance(h: float) -> None:
            nonlocal t
            pace = self.pace
            t = min(t + pace * h, total_s)
            rest = total_s - t
            if t < ramp_s:
                s, sd, sdd = 0.5 * a * t * t, a * t, a
            elif rest < ramp_s:
                s, sd, sdd = 1.0 - 0.5 * a * rest * rest, a * rest, -a
            else:
                s, sd, sdd = v * (t - 0.5 * ramp_s), v, 0.0
            self.q, self.qd, self.qdd = start + s * way, (pace * sd) * way, (pace * pace * sdd) * way
            if rest <= 0.0:
                self.hold()

        self.begin("move", advance)

    def speed(self, qd: Array, acceleration_rad_s2: float) -> None:
        """speedj: towards this speed until told otherwise."""
        goal = np.clip(qd, -self._max_speed, self._max_speed)
        acceleration = max(acceleration_rad_s2, 0.01)

        def advance(h: float) -> None:
            change = goal - self.qd
            largest = float(np.max(np.abs(change)))
            self.glide(goal if largest <= acceleration * h else self.qd + change * (acceleration * h / largest), h)

        self.begin("speed", advance)

    def follow(self, targets: list[Array], time_s: float, lookahead_s: float, gain: float) -> None:
        """servoj: the targets that arrived in this tick, oldest first, possibly none.

        One call of servoj lasts `time_s`: targets that come faster wait, and the newest counts.
        """
        period = time_s if time_s > 0.0 else self._tick_s
        if self.mode != "servo":
            self._goal, self._between_qd, self._goal_qdd = self.q.copy(), self.qd.copy(), np.zeros_like(self.q)
            self._goal_qd, self._age_s, self._first, self._waiting = self.qd.copy(), math.inf, True, []
            self._heard_s, self._heard = SPACING_PRIOR * period, SPACING_PRIOR
            self.begin("servo", self._servo)
        self._carry_s = period * (1.0 + STREAM_GAP_PERIODS)
        self._rate = 2.0 / lookahead_s * math.sqrt(gain / 500.0)
        self._waiting = [*self._waiting, *targets][-STREAM_BURST:]
        if self._waiting and self._age_s > period - 0.75 * self._tick_s:
            self._take(self._waiting[-1], len(self._waiting), period)
            self._waiting = []

    def _take(self, target: Array, arrived: int, period: float) -> None:
        """The newest target: its speed from the one before, and its place in time.

        The network makes targets late and bunches them, so their place follows from how many came and how far apart they come
        on the average; where some were never sent, from where the motion so far expects them.
        """
        if self._first:  # has no speed
            self._between_qd, self._goal_qdd, self._first = np.zeros_like(target), np.zeros_like(target), False
            self._age_s = 0.0
        else:
            if self._age_s < STREAM_BURST * period:  # longer silence is no spacing
                self._heard_s = SPACING_KEEP * self._heard_s + self._age_s
                self._heard = SPACING_KEEP * self._heard + arrived
            spacing = self._heard_s / self._heard
            spacing = period if abs(spacing / period - 1.0) < SPACING_NOMINAL else spacing
            late = round(self._age_s / spacing) - arrived
            count = arrived if late <= 0 else self._fitting(target, spacing, arrived, min(late, STREAM_BURST))
            between = count * spacing
            room = SPEED_CHANGE_MAX_RAD_S2 * between
            change = (target - self._goal) / between - self._between_qd
            if float(change.max()) > room or float(change.min()) < -room:
                change = np.minimum(np.maximum(change, -room), room)
            self._between_qd = self._between_qd + change
            self._goal_qdd = self._goal_qdd + ACCELERATION_TRUST * (change / between - self._goal_qdd)
            self._goal_qd = self._between_qd + (0.5 * between) * self._goal_qdd
            self._age_s = min(max(PHASE_KEEP * (self._age_s - between), -period), 2.0 * period)
        self._goal = target
        self._pulls[1], self._pulls[2] = self._goal_qd, self._goal_qdd

    def _fitting(self, target: Array, spacing: float, arrived: int, late: int) -> int:
        """How many places on the newest target is: as many as arrived, unless the motion so far clearly says that some were skipped."""

        def miss(count: int) -> float:
            t = count * spacing
            return float(np.linalg.norm(target - self._goal - t * (self._goal_qd + (0.5 * t) * self._goal_qdd)))

        best = min(range(arrived, arrived + late + 1), key=miss)
        denied = miss(arrived) > FIT_CLEAR_RAD and miss(best) < FIT_BETTER * miss(arrived)
        return best if denied else arrived

    def _servo(self, h: float) -> None:
        if self._first:
            self.glide(self.qd * 0.5, h)  # no target has come yet
            return
        self._age_s += h
        age = min(self._age_s, self._carry_s)
        w, before = self._rate, self.qd
        if age == self._age_s:  # g̈ + 2w·(ġ + a·g̈ − q̇) + w²·(g + a·ġ + a²/2·g̈ − q)
            pulls, wa = self._pulls, w * age
            pulls[0], pulls[3] = self._goal - self.q, before
            pull = np.array((w * w, w * (2.0 + wa), 1.0 + wa * (2.0 + 0.5 * wa), -2.0 * w)).dot(pulls)
        else:  # no target any more: back to the last one
            goal = self._goal + age * (self._goal_qd + (0.5 * age) * self._goal_qdd)
            away = max(0.0, 1.0 - (self._age_s - age) / STREAM_GAP_BACK_S)
            pull = BACK_RAD_S**2 * (self._goal + away * (goal - self._goal) - self.q) - 2.0 * BACK_RAD_S * self.qd
        qdd = np.minimum(np.maximum(pull, -self._strongest), self._strongest)
        self.glide(np.minimum(np.maximum(before + h * qdd, self._min_speed), self._max_speed), h)

    def put(self, q: Array, qd: Array, qdd: Array) -> None:
        """Where a motion says that it is now, each (J,)."""
        self.q, self.qd, self.qdd = q, qd, qdd

    def glide(self, qd: Array, h: float) -> None:
        """Go on for h, the speed changing evenly to q̇ (J,)."""
        self.q = self.q + (0.5 * h) * (self.qd + qd)
        self.qdd = (qd - self.qd) / h
        self.qd = qd

    def begin(self, mode: str, advance: Callable[[float], None]) -> None:
        """Another motion: `advance(h)` is called every h until `hold`."""
        self.mode, self._advance, self._then = mode, advance, None

    def hold(self) -> None:
        """Stand here."""
        self.mode, self._advance = "hold", None
        self.qd, self.qdd = np.zeros_like(self.q), np.zeros_like(self.q)
