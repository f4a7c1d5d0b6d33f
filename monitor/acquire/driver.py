"""What a robot must be able to do so that this room can replay on it, check it and listen to it. `ur/` is the one implementation.

Everything that depends on the make of the robot lies behind `Driver`. A connection is held by a `Session`, a process of its own where a
maker's library holds it, because such a library may crash or hang; the session's process may be killed at any moment.
"""

import importlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal, NamedTuple, Protocol

from monitor.acquire.safety.oversight import Interruption
from monitor.acquire.safety.torque_basis import BandBasis
from monitor.acquire.safety.way import Left
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.acquire.state import ArmState, Identity, Services
from monitor.errors import MonitorError
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.reason import Reason
from monitor.recording import Array, Context


class SessionEnded(MonitorError):
    """The session's process has ended, and everything that it sent has been delivered."""


class SafetyStop(NamedTuple):
    """A stop by the robot's own safety system."""

    cause: str  # protective_stop, safeguard_stop, emergency_stop or safety
    reason: Reason


class ReportedError(NamedTuple):
    """An error that the controller has reported."""

    code: str  # as the pendant writes it, e.g. C153A2
    joint: int | None  # from 1, where the code tells it


class ReportedMode(NamedTuple):
    """The safety mode has changed to this one."""

    mode: int


Reported = ReportedError | ReportedMode


class ErrorLink(Protocol):
    """A connection on which the controller reports its errors and its safety mode."""

    def poll(self) -> Sequence[Reported]:
        """What has come since the last call, oldest first; nothing while nobody answers."""

    def close(self) -> None:
        """Close the connection."""


class History(NamedTuple):
    """What happened to an arm between two times."""

    known: bool = False  # the robot has told all of it; False: it may not have
    found: Reason | None = None  # what was told that the end of a motion does not explain


class Witness(Protocol):
    """A connection on which the robot tells of itself whatever becomes of the session's: from before a motion until after it."""

    def begin(self) -> None:
        """Connect. Without that, and where nobody answers, nothing is known."""

    def ours_runs(self) -> bool:
        """Whether the program that runs now, or is paused, is known to be ours."""

    def history(self, since_s: float, until_s: float, *, programs: bool = True) -> History:
        """What happened between two times (monotonic [s]). programs : False: another program may run, and may move the arm."""

    def close(self) -> None:
        """Close the connection."""


class NodeSays(NamedTuple):
    """What a node that lends the arm leaves in the controller's registers."""

    version: int  # of its text; 0: no node of ours was played
    reached: int  # how often one was reached, also while nothing was due


class NodeServer(Protocol):
    """Serves the text of a program's node, as long as it is open."""

    @property
    def port(self) -> int:
        """The port that was bound."""

    def serve(self, text: str) -> None:
        """Serve another text from now on."""

    def close(self) -> None:
        """Stop listening."""


OurEnd = Literal["ended", "replaced", "not_shown"]  # of our program: another has taken its place; the robot did not show that it has ended


class OurProgram(NamedTuple):
    """What is known of the program that a session has left on the robot."""

    at_s: float | None  # when the program that runs was last known to be ours (monotonic [s]); None: it is not known
    state: Literal["running", "paused", "starting"] = "running"  # starting: it was being sent, and may begin to run only now
    name: str | None = None  # as the robot calls it; None: it is not known
    runs: Callable[[], bool] | None = None  # of a witness: whether what runs now is known to be ours; None: there is none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReplayTask:
    """What the streaming process needs to know of one replay."""

    settings: ReplaySettings
    excitation: Excitation
    robot: Robot
    context: Context
    installation: Installation = field(default_factory=Installation)
    basis: BandBasis = field(default_factory=BandBasis)  # what was learnt for the torque band
    left: Left | None = None  # how the last motion left the arm; None: it brought it back
    software: str | None = None  # of the controller, as it says
    program: str | None = None  # what the driver sends in the place of its library's own program; None: that one


class Session(Protocol):
    """What holds the connection to one robot: a process, unless it only receives. The thread that starts it must outlive it."""

    @property
    def printed(self) -> str:
        """The end of what the process printed, for a message after a crash."""

    def send(self, word: str) -> None:
        """Send one word to the process; without effect where it has ended."""

    def frames(self, timeout_s: float) -> Iterator[Array | dict[str, Any]]:
        """Rows (WIDTH,) and messages that have come, oldest first, after waiting up to timeout_s for the first.

        A message is a dictionary with a `kind`. Raises SessionEnded once everything has been delivered.
        """

    def wait(self, timeout_s: float) -> None:
        """Wait until `frames` has something, at most so long."""

    def end(self, patience_s: float = 0.0) -> int:
        """End the process, by force unless it ends by itself within patience_s. Returns its exit code, or minus the signal's number."""


class Driver(Protocol):
    """One make of robots. Every method names the robot by its host, a literal IPv4 address."""

    client_library: str  # what drives it, with its version: what was made for one is not taken for another
    no_data: str  # what to look for where the robot answers and sends no data, as a question

    def identity(self, host: str) -> Identity:
        """Who the robot says it is. Raises RobotUnreachable."""

    def services(self, host: str) -> Services:
        """Which services that a motion needs take a connection; nothing is sent to them."""

    def model_of(self, identity: Identity) -> str | None:
        """The shipped model that a controller names; None where it names none of them."""

    def currents_and_torques(self, host: str) -> Array | None:
        """(N, 2, J) rows of a second of currents [A] and torques [N·m]; None where no torque is reported. Raises RobotUnreachable."""

    def errors(self, host: str) -> ErrorLink:
        """A connection that tells the errors which the controller reports from now on."""

    def state(self, host: str, rate_hz: float, timeout_s: float) -> ArmState | None:
        """The robot's state now, by receiving only; None where no data comes within timeout_s."""

    def listen(self, host: str, rate_hz: float) -> Session:
        """A session that receives only and gives every row. Its one message is `lost` with a `reason`, after which it ends."""

    def stream(self, task: ReplayTask) -> Session:
        """A session that plays one replay, as `protocol` has it.

        Raises SessionEnded where no process can be started, RobotUnreachable where what it sends cannot be made.

        It sends the rows of the play, and each event of the protocol as a message of that `kind`: that of a phase with its `duration_s`;
        the last words STOPPED and FAILED with a `cause` and a `reason`, REFUSED and UNREACHABLE with a `reason`. Beside these: `state` with
        a `row` while it waits in the phase READY; `passed_by` with a `reason` for each node at which the arm was not taken; `alive` with
        the newest `row`, `calling` with the `call` of the library that may block, and `waiting` while the robot's next row is late.
        It takes the words GO, without which nothing moves, STOP, BACK, and while the arm moves `here` from whoever watches it: without that
        it lets the arm come to rest. A session that was not told GO gives a lent arm back after STOP, after whatever it refuses itself,
        and where nobody says `here`.
        """

    def witness(self, host: str) -> Witness:
        """A witness for one motion, which has not begun yet."""

    def cause_of_death(self, exit_code: int, silent_s: float, printed: str, call: str) -> Interruption:
        """Why a session's process ended without a last word.

        It had been silent for silent_s, and `printed` this; call : of the maker's library, which had not returned; empty: none.
        """

    def lock_sockets(self) -> str | None:
        """Keep this process from ever opening a connection again, as the streaming process must; why it cannot be done, if so."""

    def node_control(self, host: str) -> str:
        """The part of a node's text that depends on the controller's software. Raises RobotUnreachable."""

    def node_text(self, control: str, *, version: int = 0) -> str:
        """The text of a node around that part, which says this version of itself. Raises BadInput where that part is not as expected."""

    def node_says(self, host: str) -> NodeSays | None:
        """What the node of the program that was played last has left; None where the controller does not answer."""

    def node_server(self, text: str, *, bind: str, port: int) -> NodeServer:
        """Serve the text to the nodes of programs. Raises BadInput where the address cannot be bound."""

    def node_answer(self, address: str, port: int) -> str | None:
        """The text that a node gets from this server; None where nobody listens."""

    def safety_stop(self, host: str) -> SafetyStop | None:
        """The stop that the robot's safety system holds; None where there is none, or where the robot does not answer."""

    def remote_control(self, host: str) -> AbstractContextManager[Callable[[], bool | None]]:
        """A conversation in which can be asked, often, whether the robot takes commands over the network; None: it does not say.

        Raises RobotUnreachable, as each question does.
        """

    def playing_program(self, host: str) -> str | None:
        """The name of the program that plays, empty where the robot tells no names; None where none plays. Raises RobotUnreachable."""

    def stop_program(self, host: str, ours: OurProgram) -> OurEnd:
        """End our program and no other, without any session. Returns how it has ended, as the robot shows it."""


MAKES = {"universal_robots": "monitor.acquire.ur.driver"}  # each with the module whose `driver` makes its Driver; a second make is a line


def driver_of(make: str, **options: Any) -> Driver:
    """The driver of a make. Its module is imported only now: every command reads a configuration, few ask a controller."""
    made: Driver = importlib.import_module(MAKES[make]).driver(**options)
    return made


@cache
def usual_driver() -> Driver:
    """The driver of the one make that there is, with its usual ports."""
    return driver_of(next(iter(MAKES)))
