"""Whether the controller's own watchdog ends our program: it is tried before every motion, with an arm that stands."""

from monitor.acquire.state import RUNTIME_PLAYING, RUNTIME_STATES, RUNTIME_STOPPED, RUNTIME_STOPPING, arm_state
from monitor.acquire.ur.streaming.arm import Arm
from monitor.acquire.ur.streaming.failures import StreamFailure, state_failure
from monitor.acquire.ur.streaming.upload import START_S

WATCHDOG_LATE_S = 0.1  # a program that ends so much later than its watchdog says is not watched
WATCHDOG_EARLY_SHARE = 0.5  # a program that ends before this share of the watchdog's time was not ended by it


def prove_watchdog(arm: Arm) -> None:
    """Set the watchdog, send nothing, and see the controller end the program in time; the arm stands meanwhile.

    Raises StreamFailure where the program goes on, or ends for another reason.
    """
    control = arm.control
    assert control is not None
    arm.set_watchdog()
    period_s = 1.0 / arm.settings.watchdog_hz
    row = arm.next_row()
    since_s, state = float(row[0]), arm_state(row)
    while state.runtime_state == RUNTIME_PLAYING:
        if failure := arm.replaced():
            raise failure
        if row[0] - since_s > period_s + WATCHDOG_LATE_S:
            # where the controller tells no names it may be another one by now, which nobody of us may stop
            raise StreamFailure("no_watchdog", f"without targets the program went on for {row[0] - since_s:.2f} s", ours=arm.messages.open)
        if failure := state_failure(state, arm.settings, arm.payload_kg, up_to_speed=False):
            raise failure
        row = arm.next_row()
        state = arm_state(row)
    took_s = row[0] - since_s
    if took_s < WATCHDOG_EARLY_SHARE * period_s - arm.tick_s:
        text = f"the program ended {took_s:.2f} s after its watchdog was set; asked {period_s:g} s"
        arm.program_sent = state.runtime_state not in {RUNTIME_STOPPED, RUNTIME_STOPPING}
        raise StreamFailure("program_stopped", text, ours=False)  # what plays from now on is another
    while state.runtime_state != RUNTIME_STOPPED or control.program_runs():
        if failure := arm.replaced():
            raise failure
        if row[0] - since_s > period_s + START_S or state.runtime_state not in {RUNTIME_STOPPED, RUNTIME_STOPPING}:
            name = RUNTIME_STATES.get(state.runtime_state, "unknown")
            text = f"without targets the program is {name}; expected stopped"
            raise StreamFailure("no_watchdog", text, ours=state.runtime_state != RUNTIME_PLAYING)  # it ended: what plays now is another
        row = arm.next_row()
        state = arm_state(row)
    arm.program_sent = False
