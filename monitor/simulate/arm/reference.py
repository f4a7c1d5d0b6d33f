"""Reference: what the controller asks of the joints at every servo period: hold, follow servoj, speedj, movej, stop."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.physics import Target
from monitor.simulate.arm.servoj import Servoj, Vector

PACE_PER_S = 2.0  # how fast moves follow the speed slider: from full speed to none in half a second


class Reference:
    """Position, speed and acceleration asked for, continuous through every change of mode."""

    def __init__(self, robot: Robot, q: Array, tick_s: float) -> None:
        self.q, self.qd, self.qdd = q.copy(), np.zeros_like(q), np.zeros_like(q)
        self._max_speed = robot.max_speed_rad_s
        self._half = np.full_like(self.q, 0.5)  # array · array takes numpy half as long as array · number at this size
        self._tick_s = tick_s
        self._advance: Callable[[float], object] | None = None  # None: hold
        self._then: Callable[[], None] | None = None
        self.mode = "hold"
        self.pace = 1.0  # of the speed slider: moves go so much slower; servoj, speedj and stops do not
        self._paced = 1.0  # on its way there

    @property
    def at_rest(self) -> bool:
        """Nothing is being asked for but to stand; servoj and speedj count as motion even at zero speed."""
        return self._advance is None

    @property
    def queued(self) -> bool:
        """Whether another motion follows the present stop."""
        return self._then is not None

    def steps(self, h: float, n: int) -> list[Target]:
        """Go on n times by h; the mean over each step, where the servo evaluates it."""
        return self._servo(h, n) if self.mode == "servo" else [self.step(h) for _ in range(n)]

    def step(self, h: float) -> Target:
        """Go on by h; the mean over the step."""
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
            pace, change = self.paced(h)
            t = min(t + pace * h, total_s)
            rest = total_s - t
            if t < ramp_s:
                s, sd, sdd = 0.5 * a * t * t, a * t, a
            elif rest < ramp_s:
                s, sd, sdd = 1.0 - 0.5 * a * rest * rest, a * rest, -a
            else:
                s, sd, sdd = v * (t - 0.5 * ramp_s), v, 0.0
            self.q, self.qd, self.qdd = start + s * way, (pace * sd) * way, (pace * pace * sdd + change * sd) * way
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

    def follow(self, targets: Sequence[Vector], time_s: float, lookahead_s: float, gain: float) -> None:
        """servoj: the targets (J,) that arrived in this tick, oldest first, possibly none; one call of servoj lasts `time_s`."""
        period = time_s if time_s > 0.0 else self._tick_s
        if self.mode != "servo":
            self._stream = Servoj(self.q.tolist(), self.qd.tolist(), period, self._tick_s, self._max_speed.tolist())
            self.begin("servo", lambda h: self._servo(h, 1))
        self._stream.tell(targets, period, lookahead_s, gain)

    def _servo(self, h: float, n: int) -> list[Target]:
        rows = self._stream.advance(h, n, self.q, self.qd)
        self.q, self.qd, self.qdd = rows[n]
        return [Target(*row) for row in rows[:n]]

    def paced(self, h: float) -> tuple[float, float]:
        """Share of its own speed at which a move goes in this step, and how fast that changes [1/s]: a slider brings no jerk."""
        before, most = self._paced, PACE_PER_S * h
        self._paced = min(max(self.pace, before - most), before + most)
        return self._paced, (self._paced - before) / h

    def put(self, q: Array, qd: Array, qdd: Array) -> None:
        """Where a motion says that it is now, each (J,)."""
        self.q, self.qd, self.qdd = q, qd, qdd

    def glide(self, qd: Array, h: float) -> None:
        """Go on for h, the speed changing evenly to q̇ (J,)."""
        self.q = self.q + (0.5 * h) * (self.qd + qd)
        self.qdd = (qd - self.qd) / h
        self.qd = qd

    def begin(self, mode: str, advance: Callable[[float], object]) -> None:
        """Another motion: `advance(h)` is called every h until `hold`."""
        self.mode, self._advance, self._then = mode, advance, None

    def hold(self) -> None:
        """Stand here."""
        self.mode, self._advance = "hold", None
        self.qd, self.qdd = np.zeros_like(self.q), np.zeros_like(self.q)
