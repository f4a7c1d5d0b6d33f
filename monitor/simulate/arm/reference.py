"""The reference of the servo: position, speed and acceleration that the controller asks of the joints at every servo period."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.physics import Target
from monitor.simulate.arm.servoj import Servoj, Vector

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
        ramp_s, total_s = v / a, v / a + 1.0 / v
        t = 0.0

        def advance(h: float) -> None:
            nonlocal t
            share, change = self.slider_share(h)
            t = min(t + share * h, total_s)
            rest = total_s - t
            if t < ramp_s:
                s, sd, sdd = 0.5 * a * t * t, a * t, a
            elif rest < ramp_s:
                s, sd, sdd = 1.0 - 0.5 * a * rest * rest, a * rest, -a
            else:
                s, sd, sdd = v * (t - 0.5 * ramp_s), v, 0.0
            self.q, self.qd, self.qdd = start + s * way, (share * sd) * way, (share * share * sdd + change * sd) * way
            if rest <= 0.0:
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
