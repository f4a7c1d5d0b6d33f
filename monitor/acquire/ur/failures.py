"""What ends a stream of targets: a failure with its cause, by the controller's state, the arm's position, or the clock. Values only."""

import math
from collections import deque

import numpy as np

from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import RUNTIME_PLAYING, ArmState, program_name
from monitor.reason import Reason, Sentence, reason_of
from monitor.recording import Array


class StreamFailure(Exception):
    """The stream must end now, for this cause.

    `ours` is False where another program than ours may be what plays: nobody may stop it then, and our watchdog ends ours.
    """

    def __init__(self, cause: str, said: str | Reason, *, ours: bool = True) -> None:
        super().__init__(str(said))
        self.cause, self.reason, self.ours = cause, reason_of(said), ours


class Stopped(Exception):
    """A stop was asked for, for this cause, and the arm stands."""

    def __init__(self, cause: str = "parent_asked_to_stop") -> None:
        super().__init__(cause)
        self.cause = cause


PROGRAM_LEFT = Sentence("program_left", "the control program is {name:word} (runtime state {runtime_state})")


def state_failure(
    state: ArmState,
    settings: ReplaySettings,
    payload_kg: float | None = None,
    *,
    playing: bool = True,
    up_to_speed: bool = True,
) -> StreamFailure | None:
    """Why the stream must end, as the controller's state says; None while everything is in order.

    `payload_kg` is the configured payload; None skips its comparison. Without `playing` no program need run yet. `up_to_speed` is False
    until the program has played at full speed once: until then only the slider counts. The most specific cause comes first where several
    hold.
    """
    runtime = state.runtime_state
    stands = playing and runtime != RUNTIME_PLAYING
    checks = (
        (state.safety_cause, state.not_safe),
        ("teach_button", state.teach_button),  # before the robot mode, which an arm in freedrive leaves
        ("robot_mode", state.not_running or state.joint_not_running),
        ("program_stopped", PROGRAM_LEFT(name=program_name(runtime), runtime_state=runtime) if stands else None),
        ("bad_data", state.no_position),
        ("speed_scaling", state.slow if up_to_speed else state.slider_low),
        ("payload", state.other_payload(payload_kg, settings.max_payload_error_kg)),
        ("joint_temperature", state.temperature_outside(settings.joint_temperature_range_c)),
    )
    for cause, why in checks:
        if why is not None:
            # with a full slider so begins every program, and ours has begun long ago
            another = cause == "speed_scaling" and up_to_speed and state.slider_full
            return StreamFailure(cause, why, ours=not another)
    return None


RECENT_S = 0.5  # a failure so soon after late targets is taken for their consequence
MOST_TICKS = 2.5  # between two rows: one tick that is left out is made up for, a longer gap interrupts the stream of targets
LATE_SHARE = 0.5  # of the longest gap: a process that slept so long without a check was late itself
WATCHDOG_SHARE = 0.5  # of the watchdog's time: after a longer gap, the watchdog may have stopped the program because of us


TARGETS_LATE = Sentence("targets_late", "targets came late, {gap_ms:.0f} ms between two cycles; then {cause}: {then}")


class CycleGaps:
    """The gaps between two cycles: the longest of the last half second, and the longest of all."""

    def __init__(self) -> None:
        self.longest_s = 0.0
        self._recent_s, self._recent_at_s = 0.0, float("-inf")

    def add(self, now_s: float, gap_s: float) -> None:
        """Take note of a gap that ended now, on the host's clock."""
        if gap_s >= self._recent_s or now_s - self._recent_at_s > RECENT_S:
            self._recent_s, self._recent_at_s = gap_s, now_s
        self.longest_s = max(self.longest_s, gap_s)

    def clear(self) -> None:
        """Forget every gap: what took long before the arm moved explains nothing."""
        self.longest_s = self._recent_s = 0.0

    def were_late(self, now_s: float, tick_s: float) -> bool:
        """Whether the stream of targets was interrupted within the last half second."""
        return self._recent_s >= MOST_TICKS * tick_s and now_s - self._recent_at_s <= RECENT_S

    def explain(self, failure: StreamFailure, now_s: float, *, tick_s: float, watchdog_s: float) -> StreamFailure:
        """The failure by its true cause: `late` where late targets just before it can have caused it, else the failure itself.

        `watchdog_s` is the time after which the controller's watchdog stops a program that receives no target.
        """
        enough_s = {
            "bad_target": MOST_TICKS * tick_s,
            "program_stopped": WATCHDOG_SHARE * watchdog_s,
            "servo_refused": WATCHDOG_SHARE * watchdog_s,
        }.get(failure.cause)
        if enough_s is None or self._recent_s < enough_s or now_s - self._recent_at_s > RECENT_S:
            return failure
        return StreamFailure("late", TARGETS_LATE(gap_ms=1000 * self._recent_s, cause=failure.cause, then=failure.reason))


NO_PROCESSOR_TIME = Sentence("no_processor_time", "this process got no processor time for {slept_ms:.0f} ms")
NO_DATA_FOR = Sentence("no_data_for", "no new data from the controller for {age_ms:.0f} ms")


def gap_failure(age_s: float, slept_s: float, limit_s: float) -> StreamFailure:
    """The failure after so long without a row, where this process did not check for slept_s of it."""
    if slept_s >= LATE_SHARE * limit_s:
        return StreamFailure("late", NO_PROCESSOR_TIME(slept_ms=1000 * slept_s))
    return StreamFailure("stalled", NO_DATA_FOR(age_ms=1000 * age_s))


LAG_S = 0.04  # an arm may be so far behind the controller's target; real ones are 1 to 10 ms behind it
SPEED_SHARE_S = 0.01  # per rad/s of the target, for the servo's error in fast motions; real ones have less than a tenth of it
FASTEST_RAD_S, JUMP_RAD = 2.0 * math.pi, 0.02  # the fastest joint of any arm; beyond it a position jumped
WATCHED_S = 0.15  # without a target for so long our program has been ended: by its watchdog after 0.1 s, or by the guard of a node
BEHIND_RAD_S = 0.05  # a controller that goes at this speed to where it was sent long ago gets its targets too late
ROWS = 3  # successive rows before a small distance counts: one row may be torn between two ticks of the controller


POSITION_JUMPED = Sentence(
    "position_jumped",
    "the position of {joint:joint} jumped by {jump_rad:.3f} rad between two rows: no joint is so fast, its encoder is wrong",
)
ARM_HELD = Sentence("arm_held", "{joint:joint} is {far_rad:.3f} rad from the controller's own target: something holds it")
CONTROLLER_ELSEWHERE = Sentence(
    "controller_elsewhere", "the controller's own target of {joint:joint} is {far_rad:.3f} rad from where it was sent"
)
TARGETS_CAME_LATE = Sentence("targets_came_late", "targets came late: {elsewhere}")
PLACE_TAKEN = Sentence("place_taken", "{elsewhere}, and a program plays: it has taken the place of ours")
TARGETS_DO_NOT_ARRIVE = Sentence("targets_do_not_arrive", "{elsewhere}: targets do not arrive")


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
            text = POSITION_JUMPED(joint=j + 1, jump_rad=jump)
            return StreamFailure("following_error", text)
        self._own.append(own_q)
        j, far = _farthest(q, np.array(self._own))
        allowed = self._lasting_rad + SPEED_SHARE_S * abs(float(own_qd[j]))
        # a servo whose targets were late may shake for a moment; it stays within largest_rad
        self._outside = self._outside + 1 if far > allowed and not late else 0
        if far > self._largest_rad or self._outside >= ROWS:
            return StreamFailure("following_error", ARM_HELD(joint=j + 1, far_rad=far))
        j, far = _farthest(own_q, sent)
        self._apart_s = self._apart_s + (self._tick_s if step_s is None else step_s) if far > self._lasting_rad else 0.0
        if far <= self._largest_rad:
            return None
        # the arm follows its controller, so nothing holds it: targets do not arrive, or another program moves it
        elsewhere = CONTROLLER_ELSEWHERE(joint=j + 1, far_rad=far)
        if late:
            return StreamFailure("late", TARGETS_CAME_LATE(elsewhere=elsewhere), ours=False)
        above = own_q[j] > sent[:, j].max()
        follows = (-own_qd[j] if above else own_qd[j]) > BEHIND_RAD_S
        if not follows and self._apart_s + len(sent) * self._tick_s >= WATCHED_S:
            return StreamFailure("program_stopped", PLACE_TAKEN(elsewhere=elsewhere), ours=False)
        return StreamFailure("stalled", TARGETS_DO_NOT_ARRIVE(elsewhere=elsewhere), ours=False)


def _farthest(q: Array, targets: Array) -> tuple[int, float]:
    """The joint of q (J,) that is farthest outside the range of targets (n, J), and its distance [rad]; inf where it is no number."""
    outside = np.maximum(targets.min(axis=0) - q, q - targets.max(axis=0))  # (J,)
    j = int(outside.argmax())  # a NaN counts as the largest
    far = float(outside[j])
    return j, math.inf if math.isnan(far) else far
