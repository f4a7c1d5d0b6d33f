"""The conditions under which an arm may move, each with its name: does it hold, and what was found.

`joint-monitor check` prints every condition; a replay logs them, and refuses at the first that does not hold. What the controller cannot
report does not speak against a motion: such a condition holds, is marked as not checked, and says what that means. What should be known
and is not known speaks against it. A new condition is one line of CONDITIONS.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

from monitor.acquire.safety import of_configuration, of_controller, of_installation, of_state
from monitor.acquire.safety.inputs import ConditionInputs, ConditionResult, Unreported
from monitor.errors import DOES_NOT_HOLD, MotionRefused
from monitor.reason import Reason


class Condition(NamedTuple):
    """One condition. The check returns what was found; it raises MotionRefused or Unreported."""

    name: str
    needs: Literal["configuration", "controller", "state", "permit"]  # what must be known before it can be checked
    check: Callable[[ConditionInputs], Reason]
    at_the_last: bool = True  # the parent checks it again just before the arm moves


CONDITIONS = (  # in the order in which a person would check them
    Condition("motion_allowed", "configuration", of_configuration.motion_allowed),
    Condition("address", "configuration", of_configuration.address),
    Condition("time_window", "configuration", of_configuration.time_window),
    Condition("trajectory", "configuration", of_configuration.trajectory),
    Condition("trajectory_clear", "configuration", of_configuration.trajectory_clear, at_the_last=False),  # nothing can change it meanwhile
    Condition("drive_gains", "configuration", of_installation.drive_gains),
    Condition("tcp_speed", "configuration", of_installation.tcp_speed),
    Condition("safety_planes", "configuration", of_installation.safety_planes),
    Condition("previous_stop", "configuration", of_configuration.previous_stop),
    Condition("services", "controller", of_controller.services, at_the_last=False),
    Condition("robot_model", "controller", of_controller.robot_model),
    Condition("software", "controller", of_controller.software),
    Condition("serial", "controller", of_controller.serial),
    Condition("joint_limits", "controller", of_controller.joint_limits),
    Condition("remote_control", "controller", of_controller.remote_control),
    Condition("safety_mode", "state", of_state.safety_mode),
    Condition("robot_mode", "state", of_state.robot_mode),
    Condition("joints_running", "state", of_state.joints_running),
    Condition("teach_button", "state", of_state.teach_button),
    Condition("no_other_program", "state", of_state.no_other_program),
    Condition("finite", "state", of_state.finite),
    Condition("stationary", "state", of_state.stationary),
    Condition("speed_scaling", "state", of_state.speed_scaling),
    Condition("payload", "state", of_state.payload),
    Condition("payload_cog", "state", of_installation.payload_cog),
    Condition("tcp_offset", "state", of_installation.tcp_offset),
    Condition("gravity", "state", of_state.gravity),
    Condition("approach_near", "state", of_state.approach_near),
    Condition("approach_clear", "state", of_state.approach_clear, at_the_last=False),  # the streaming process proves it once more
    Condition("temperatures", "state", of_state.temperatures),
    Condition("permit", "permit", of_state.permit, at_the_last=False),  # the gate asks for it last of all
)

OF_CONFIGURATION = tuple(condition.name for condition in CONDITIONS if condition.needs == "configuration")
OF_CONTROLLER = tuple(condition.name for condition in CONDITIONS if condition.needs == "controller")
OF_STATE = tuple(condition.name for condition in CONDITIONS if condition.needs == "state")
AT_THE_LAST = tuple(condition.name for condition in CONDITIONS if condition.at_the_last)


def conditions(inputs: ConditionInputs) -> tuple[ConditionResult, ...]:
    """What every condition finds."""
    return tuple(_result(condition, inputs) for condition in CONDITIONS)


def named_conditions(inputs: ConditionInputs, names: tuple[str, ...]) -> tuple[ConditionResult, ...]:
    """What the conditions of these names find, in the order of the names."""
    by_name = {condition.name: condition for condition in CONDITIONS}
    return tuple(_result(by_name[name], inputs) for name in names)


def refuse_unless(results: tuple[ConditionResult, ...]) -> None:
    """Raises MotionRefused with the first condition that does not hold: its name, and what was found as a reason."""
    for result in results:
        if not result.holds:
            raise MotionRefused(DOES_NOT_HOLD(condition=result.name, why=result.reason))


def _result(condition: Condition, inputs: ConditionInputs) -> ConditionResult:
    try:
        return ConditionResult(name=condition.name, holds=True, reason=condition.check(inputs))
    except MotionRefused as refusal:
        return ConditionResult(name=condition.name, holds=False, reason=refusal.reason)
    except Unreported as unreported:
        return ConditionResult(name=condition.name, holds=True, reason=unreported.reason, checked=False)


def check_quick(known: ConditionInputs) -> None:
    """Whether this trajectory may be played on this robot at all, without the proof of clearance, which takes a second.

    Raises MotionRefused.
    """
    refuse_unless(named_conditions(known, ("motion_allowed", "address", "trajectory", "drive_gains")))


def check_state(known: ConditionInputs, *, without: tuple[str, ...] = ()) -> tuple[ConditionResult, ...]:
    """Whether the arm may begin to move from where it is: every condition on its state, without those of these names.

    Raises MotionRefused with the first condition that does not hold.
    """
    found = named_conditions(known, tuple(name for name in OF_STATE if name not in without))
    refuse_unless(found)
    return found
