"""May the arm move now? The conditions as a gate: each refusal with the name of the condition and its reason.

Pure functions of what they are given: `replay` and the child process `stream` both ask them, so that neither needs to trust the other.
"""

from monitor.acquire.safety.conditions import OF_STATE, ConditionInputs, ConditionResult, refuse_unless, some
from monitor.acquire.settings import ReplaySettings
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Context


def inputs(settings: ReplaySettings, excitation: Excitation, robot: Robot, context: Context | None = None) -> ConditionInputs:
    """What is known before the controller is asked."""
    return ConditionInputs(
        settings=settings, excitation=excitation, robot=robot, context=context or Context(), now_unix_s=0.0, identity=None, state=None
    )


def check_all(settings: ReplaySettings, excitation: Excitation, robot: Robot, context: Context | None = None) -> None:
    """May this excitation be played on this robot at all, whatever the hour?

    Raises MotionRefused with the reason; returns if nothing speaks against it.
    """
    facts = inputs(settings, excitation, robot, context)
    refuse_unless(some(facts, ("motion_allowed", "address", "trajectory", "trajectory_clear")))


def check_quick(settings: ReplaySettings, excitation: Excitation, robot: Robot) -> None:
    """The same without the proof of clearance, which takes a second.

    Raises MotionRefused.
    """
    refuse_unless(some(inputs(settings, excitation, robot), ("motion_allowed", "address", "trajectory")))


def check_state(facts: ConditionInputs, *, but: tuple[str, ...] = ()) -> tuple[ConditionResult, ...]:
    """May the arm begin to move from where it is? What the controller says of it, leaving out some conditions.

    Raises MotionRefused with the first condition that does not hold.
    """
    found = some(facts, tuple(name for name in OF_STATE if name not in but))
    refuse_unless(found)
    return found
