"""What a condition is checked against, and what a check finds. Values only."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from monitor.acquire.safety.way import Left, Way, way
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.acquire.state import ArmState, Identity, Services
from monitor.errors import MotionRefused
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Context


class Permit(NamedTuple):
    """What somebody else answered when asked whether the arm may move."""

    given: bool
    reason: Reason


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LastMotion:
    """How the motion before this one ended, as the history knows it."""

    stopped_before: Reason | None = None  # a stop that nobody has acknowledged
    expected_serial: str | None = None  # of the arm that was moved; None: none was moved yet, or it says none
    left: Left | None = None  # how the arm was left; None: it was brought back


CONTROLLER_UNKNOWN = Sentence("controller_unknown", "unknown: the controller does not answer")
NO_DATA = Sentence("no_data", "unknown: no RTDE data")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConditionInputs:
    """Everything that is known when somebody asks whether the arm may move."""

    settings: ReplaySettings
    excitation: Excitation
    robot: Robot
    context: Context = field(default_factory=Context)  # what the configuration says of the arm
    now_unix_s: float = 0.0
    identity: Identity | None = None  # None: the robot has not been asked, or does not answer
    state: ArmState | None = None  # None: no data has come from the robot
    services: Services | None = None  # None: nobody has tried them: a motion connects to each itself
    unreachable: Reason | None = None  # why there is no identity, where the robot was asked for it
    last: LastMotion = LastMotion()
    permit: Permit | None = None  # the answer over Zenoh; None: nobody was asked
    installation: Installation = field(default_factory=Installation)

    @property
    def controller(self) -> Identity:
        """Who the controller is. Raises MotionRefused where it is not known."""
        if self.identity is None:
            raise MotionRefused(CONTROLLER_UNKNOWN())
        return self.identity

    @property
    def arm(self) -> ArmState:
        """The arm's state. Raises MotionRefused where it is not known."""
        if self.state is None:
            raise MotionRefused(NO_DATA())
        return self.state

    @property
    def played(self) -> Excitation:
        """The trajectory as it will be played from where the arm stands: around the nearest turn of each joint."""
        return self.excitation if self.state is None else self.way_from(self.state).excitation

    def way_from(self, state: ArmState) -> Way:
        """The ways to the start and back for an arm in this state."""
        return self.way_from_position(state.target_q)

    def way_from_position(self, q: Array) -> Way:
        """The ways to the start and back for an arm that stands at q (J,)."""
        return way(self.excitation, self.robot, q, self.last.left, max_approach_rad=self.settings.max_approach_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionResult:
    """What the check of one condition found. Not `checked`: the controller does not report what the check needs."""

    name: str
    holds: bool
    reason: Reason
    checked: bool = True

    @property
    def text(self) -> str:
        """What was found, in English."""
        return self.reason.text

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {"name": self.name, "holds": self.holds, "checked": self.checked, **self.reason.document()}

    @property
    def status(self) -> str:
        """For a table: ok, NO or not checked."""
        return ("ok" if self.checked else "not checked") if self.holds else "NO"


class Unreported(Exception):
    """A condition cannot be checked; the reason says what the controller does not report, and what that means."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.text)
        self.reason = reason
