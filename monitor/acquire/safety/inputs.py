"""What a condition is checked against, and what a check finds. Values only."""

from dataclasses import dataclass, field
from typing import NamedTuple

from monitor.acquire.safety.turns import turned
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.acquire.state import ArmState, Identity
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Context


class Permit(NamedTuple):
    """What somebody else answered when asked whether the arm may move."""

    given: bool
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConditionInputs:
    """Everything that is known when somebody asks whether the arm may move."""

    settings: ReplaySettings
    excitation: Excitation
    robot: Robot
    context: Context  # what the configuration says of the arm
    now_unix_s: float
    identity: Identity | None  # None: the robot has not been asked, or does not answer
    state: ArmState | None  # None: no data has come from the robot
    stopped_before: str | None = None  # description of a stop that nobody has acknowledged
    expected_serial: str | None = None  # of the arm that was moved before; None: none was moved yet, or it says none
    permit: Permit | None = None  # the answer over Zenoh; None: nobody was asked
    installation: Installation = field(default_factory=Installation)

    @property
    def played(self) -> Excitation:
        """The trajectory as it will be played from where the arm stands: around the nearest turn of each joint."""
        return self.excitation if self.state is None else turned(self.excitation, self.robot, self.state.target_q)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionResult:
    """What the check of one condition found. Not `checked`: the controller does not report what the check needs."""

    name: str
    holds: bool
    text: str
    checked: bool = True

    @property
    def status(self) -> str:
        """For a table: ok, NO or not checked."""
        return ("ok" if self.checked else "not checked") if self.holds else "NO"


class Unreported(Exception):
    """A condition cannot be checked; the message says what the controller does not report, and what that means."""
