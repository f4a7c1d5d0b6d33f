"""Whether an arm may move now: the conditions as a gate, where each refusal has the name of its condition and its reason.

`replay` and the streaming process both ask, so that neither needs to trust the other.
"""

from monitor.acquire.safety.conditions import OF_STATE, named_conditions, refuse_unless
from monitor.acquire.safety.inputs import ConditionInputs, ConditionResult
from monitor.acquire.safety.way import Left
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Context


def inputs(
    settings: ReplaySettings,
    excitation: Excitation,
    robot: Robot,
    context: Context | None = None,
    installation: Installation | None = None,
    left: Left | None = None,
) -> ConditionInputs:
    """What is known before the controller is asked, at no particular time."""
    return ConditionInputs(
        settings=settings,
        excitation=excitation,
        robot=robot,
        context=context or Context(),
        now_unix_s=0.0,
        identity=None,
        state=None,
        installation=installation or Installation(),
        left=left,
    )


def check_all(settings: ReplaySettings, excitation: Excitation, robot: Robot, context: Context | None = None) -> None:
    """Whether this excitation may be played on this robot at all, at whatever time.

    Raises MotionRefused with the reason; returns if every condition holds.
    """
    refuse_unless(
        named_conditions(inputs(settings, excitation, robot, context), ("motion_allowed", "address", "trajectory", "trajectory_clear"))
    )


def check_quick(known: ConditionInputs) -> None:
    """The same without the proof of clearance, which takes a second.

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
