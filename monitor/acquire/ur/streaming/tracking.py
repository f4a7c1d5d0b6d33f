"""Whether the arm follows its controller, and whether the controller follows us. Values only, no clock.

An arm that leaves the controller's own target was held up or pushed: a person must look. A controller whose target is elsewhere than what
was sent got its targets late, or does not take them. The first is told apart from the second, because a busy host delays targets
now and then, and a servo that gets its targets late stays near its own target all the same. A controller that takes no target for longer
than our program lives without one plays another program.
"""

import math
from collections import deque

import numpy as np

from monitor.acquire.ur.streaming.failures import StreamFailure
from monitor.reason import joint_text
from monitor.recording import Array

LAG_S = 0.04  # an arm may be so far behind the controller's target; real ones are 1 to 10 ms behind it
SPEED_SHARE_S = 0.01  # per rad/s of the target, for the servo's error in fast motions; real ones have less than a tenth of it
FASTEST_RAD_S, JUMP_RAD = 2.0 * math.pi, 0.02  # the fastest joint of any arm; beyond it a position jumped
WATCHED_S = 0.15  # without a target for so long our program has been ended: by its watchdog after 0.1 s, or by the guard of a node
BEHIND_RAD_S = 0.05  # a controller that goes at this speed to where it was sent long ago gets its targets too late
ROWS = 3  # successive rows before a small distance counts: one row may be torn between two ticks of the controller


class Tracking:
    """Compares each row with the rows before and with what was sent."""

    def __init__(self, tick_s: float, *, largest_rad: float, lasting_rad: float) -> None:
        """A joint ends the motion at a distance of largest_rad, or of lasting_rad in successive rows."""
        self._largest_rad, self._lasting_rad = largest_rad, lasting_rad
        self._own: deque[Array] = deque(maxlen=max(2, round(LAG_S / tick_s) + 1))  # the controller's targets, (J,) each
        self._outside = 0  # successive rows
        self._tick_s = tick_s
        self._apart_s = 0.0  # for so long the controller's target has been outside of what was sent
        self._before: Array | None = None  # (J,) the measured position of the row before

    def failure(
        self, q: Array, own_q: Array, own_qd: Array, sent: Array, *, late: bool, step_s: float | None = None
    ) -> StreamFailure | None:
        """Why the motion must end after this row; None while everything is where it should be.

        q, own_q, own_qd : (J,) the measured position [rad], and the controller's own target with its speed [rad/s].
        sent : (n, J) the targets of the last 0.2 s. late : whether the stream of targets was interrupted just before.
        step_s : controller's time since the row before; None: one tick.
        """
        before, self._before = q if self._before is None else self._before, q
        j, jump = _farthest(q, before[None])
        if not jump <= FASTEST_RAD_S * (self._tick_s if step_s is None else step_s) + JUMP_RAD:
            text = (
                f"the position of {joint_text(j + 1)} jumped by {jump:.3f} rad between two rows: no joint is so fast, its encoder is wrong"
            )
            return StreamFailure("following_error", text)
        self._own.append(own_q)
        j, far = _farthest(q, np.array(self._own))
        allowed = self._lasting_rad + SPEED_SHARE_S * abs(float(own_qd[j]))
        # a servo whose targets were late may shake for a moment; it stays within largest_rad
        self._outside = self._outside + 1 if far > allowed and not late else 0
        if far > self._largest_rad or self._outside >= ROWS:
            return StreamFailure(
                "following_error", f"{joint_text(j + 1)} is {far:.3f} rad from the controller's own target: something holds it"
            )
        j, far = _farthest(own_q, sent)
        self._apart_s = self._apart_s + (self._tick_s if step_s is None else step_s) if far > self._lasting_rad else 0.0
        if far <= self._largest_rad:
            return None
        # the arm follows its controller, so nothing holds it: targets do not arrive, or another program moves it
        elsewhere = f"the controller's own target of {joint_text(j + 1)} is {far:.3f} rad from where it was sent"
        if late:
            return StreamFailure("late", f"targets came late: {elsewhere}", ours=False)
        above = own_q[j] > sent[:, j].max()
        follows = (-own_qd[j] if above else own_qd[j]) > BEHIND_RAD_S
        if not follows and self._apart_s + len(sent) * self._tick_s >= WATCHED_S:
            return StreamFailure("program_stopped", f"{elsewhere}, and a program plays: it has taken the place of ours", ours=False)
        return StreamFailure("stalled", f"{elsewhere}: targets do not arrive", ours=False)


def _farthest(q: Array, targets: Array) -> tuple[int, float]:
    """The joint of q (J,) that is farthest outside the range of targets (n, J), and its distance [rad]; inf where it is no number."""
    outside = np.maximum(targets.min(axis=0) - q, q - targets.max(axis=0))  # (J,)
    j = int(outside.argmax())  # a NaN counts as the largest
    far = float(outside[j])
    return j, math.inf if math.isnan(far) else far
