"""Universal Robots behind the room's `Driver`: ur-rtde in child processes; dashboard server, Robot API and a look over plain sockets."""

import re
import signal
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from typing import NamedTuple

from monitor.acquire.child import Child
from monitor.acquire.driver import NodeSays, OurEnd, OurProgram, ReplayTask, SafetyStop, Session
from monitor.acquire.safety.oversight import Interruption
from monitor.acquire.state import ArmState, Identity, Services, Software
from monitor.acquire.ur import conversation, primary
from monitor.acquire.ur.last_resorts import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT, forbid_new_sockets
from monitor.acquire.ur.node_script import OFFER, VERSION, control_program, control_script, hand_over_script
from monitor.acquire.ur.node_server import HandOverServer, answer_of
from monitor.acquire.ur.primary import ReportedErrors
from monitor.acquire.ur.robot_api import PORT as ROBOT_API_PORT
from monitor.acquire.ur.rtde import Listening, observe, output_integers, rows_of, software_of
from monitor.acquire.ur.witness import PrimaryWitness
from monitor.errors import RobotUnreachable
from monitor.model.robot import robot_names
from monitor.reason import Sentence
from monitor.recording import Array

CURRENT_ROWS, CURRENT_RATE_HZ, CURRENT_WITHIN_S = 125, 125.0, 3.0  # one second of currents beside torques
REMOTE_TIMEOUT_S = 0.5  # for one answer whether remote control is on; a controller answers within some milliseconds


CALL_SILENCE_S = 0.08  # a call that blocks ends the process 0.06 s after its last sign of life, a lack of processor time after 0.1 s
CONNECTION_WORDS = (  # what ur-rtde and the libraries below it print when a connection breaks off
    "Robot closed the connection",
    "Robot is disconnected",
    "Lost connection to robot",
    "Connection reset by peer",
    "Broken pipe",
    "End of file",
    "boost::system::system_error",
)


CONNECTION_ABORTED = Sentence("connection_aborted", "the RTDE connection broke off, and its library aborted or blocked")
CONNECTION_NOT_REOPENED = Sentence(
    "connection_not_reopened", "the RTDE connection broke off, and its library was kept from connecting again"
)
TARGET_NOT_TAKEN_IN_TIME = Sentence("target_not_taken_in_time", "the controller did not take a target in time")
CALL_BLOCKED = Sentence(
    "call_blocked", "ur-rtde's {call} had not returned after {silent_ms:.0f} ms: the control program does not say that it takes commands"
)
PROCESS_STARVED = Sentence("process_starved", "the streaming process got no processor time for {silent_ms:.0f} ms")
PROCESS_ENDED = Sentence("process_ended", "the child process ended {how}")


def cause_of_death(exit_code: int, silent_s: float, printed: str = "", call: str = "") -> Interruption:
    """Why a session's process ended without a last word; it had been silent for silent_s before, since it called `call` of ur-rtde.

    The process lets the kernel end it where it would open a new connection (SIGSYS), and where it does not report in time (SIGALRM).
    ur-rtde aborts it (SIGABRT) where one of its own threads meets a connection that was reset, or blocks; what it `printed` says so.
    """
    if exit_code < 0 and any(word in printed for word in CONNECTION_WORDS):
        return Interruption("connection_lost", CONNECTION_ABORTED())
    if exit_code == -signal.SIGSYS:
        return Interruption("connection_lost", CONNECTION_NOT_REOPENED())
    if exit_code == -signal.SIGALRM and call:
        return Interruption("no_control", CALL_BLOCKED(call=call, silent_ms=1000.0 * silent_s))
    if exit_code == -signal.SIGALRM and silent_s < CALL_SILENCE_S:
        return Interruption("stalled", TARGET_NOT_TAKEN_IN_TIME())
    if exit_code == -signal.SIGALRM:
        return Interruption("late", PROCESS_STARVED(silent_ms=1000.0 * silent_s))
    how = f"by signal {-exit_code}" if exit_code < 0 else f"with code {exit_code}"
    return Interruption("child_died", PROCESS_ENDED(how=how))


NEEDED = {  # the ports of a motion, as the pendant names them, beside that of the dashboard or the Robot API
    primary.PORT: "Primary Client Interface",  # joint limits, the history of stops, the program's name
    SCRIPT_PORT: "Real-Time Client Interface",  # takes our program
    RTDE_PORT: "Real-Time Data Exchange (RTDE)",
}
# https://github.com/UniversalRobots/Universal_Robots_ROS2_Driver, ur_robot_driver/doc/installation/robot_setup.rst
SWITCH = "Settings > Security > Services on the pendant, from software 5.10 on; before it they are always on, and a firewall keeps us out"
CONNECT_S = 1.0  # for one connection; a controller takes it within milliseconds


def takes_connection(host: str, port: int) -> bool:
    """Whether somebody listens there. Nothing is sent."""
    try:
        socket.create_connection((host, port), timeout=CONNECT_S).close()
    except OSError:
        return False
    return True


GENERATIONS = {"cb3": ("3",), "e-series": ("5", "10")}  # each by the major versions of its software
E_SERIES_FROM = 5  # first major version of the software of the e-Series


class Span(NamedTuple):
    """A span of versions of the controller's software, both ends included, by major and minor number, and what is known of it."""

    first: tuple[int, int]
    last: tuple[int, int]
    reason: str  # of its bounds
    drives: bool = True  # ur-rtde can drive it
    tested: bool = True  # replays on it are tested, as far as its wire is known
    played: tuple[str, ...] = ()  # versions of the simulator on which the tests play a replay
    on_their_simulator: str = ""  # versions of the manufacturer's simulator on which it tests its own client library, as that says
    seen: str = ""  # what somebody saw on an arm

    @property
    def text(self) -> str:
        """Its bounds, for a person."""
        return " to ".join(dict.fromkeys(f"{major}.{minor}" for major, minor in (self.first, self.last)))


# What is in none of these spans moves only where the configuration allows untested software. The docs have this as a table: `make docs`.
SOFTWARE = (
    Span((3, 0), (3, 9), "RTDE's protocol 2, which ur-rtde speaks, came with 3.10", drives=False),
    Span(
        (3, 10),
        (3, 15),
        "CB3: from RTDE's protocol 2 to the generation's last version",
        played=("3.10.0", "3.15.8"),
        on_their_simulator="3.14.3, 3.15.8",
        seen="a UR5 at rest, in a public recording",
    ),
    Span((5, 0), (5, 3), "ur-rtde asks a minor version of 4 or more for its registers, and crashes in its constructor", drives=False),
    Span(
        (5, 4),
        (5, 26),
        "e-Series: from ur-rtde's registers to the newest version for which it has a script; 5.24 to 5.26 speak the wire of 5.23, "
        "with more names",
        played=("5.4.0", "5.9.0", "5.11.0", "5.23.0", "5.24.0", "5.25.1", "5.26.0"),
        on_their_simulator="5.9.4, 5.12.8, 5.15.2, 5.22.2, 5.25.1",
        seen="UR3e and UR10e in motion, in public recordings; 5.25.1 plays the manufacturer's own control script (a public report of 2026)",
    ),
    Span((10, 0), (10, 10), "PolyScope X before 10.11 has neither a dashboard nor a Robot API: no program could be stopped", drives=False),
    Span(
        (10, 11),
        (10, 11),
        "PolyScope X 10.11 does not tell whether it is in remote control, and its Robot API is not published",
        tested=False,
        played=("10.11.0",),
        on_their_simulator="10.11.0",
    ),
    Span(
        (10, 12),
        (10, 14),
        "PolyScope X: from the Robot API that tells remote control to the newest version whose names and Robot API are published",
        played=("10.12.0", "10.12.1", "10.13.0", "10.14.0"),
        on_their_simulator="10.12.0, 10.12.1, 10.13.0",
        seen="a UR7e, of which version 10 is not said: ur-rtde did not control it reliably, for no known cause (a public report of 2026)",
    ),
)
TESTED_LIBRARY = "1.6.5"  # the release of ur-rtde with which all of this was tested
# Versions, the last of each span excluded, for which ur-rtde 1.6.5 keeps a name in its script that the manufacturer's client library 2.14
# gives to later versions only: `ft_rtde_input_enable` from 5.9.1 on, and the scales of `direct_torque` from 10.12.1 on. A controller that
# does not know a name refuses the whole script: these get only the part of it that a replay needs.
NAMES_TOO_EARLY = (((5, 9, 0), (5, 9, 1)), ((10, 0, 0), (10, 12, 1)))


def generation_of(firmware: str | None) -> str | None:
    """The generation of arms that a version of the software drives: its name does not tell UR5 and UR5e apart. None: unknown."""
    major = (firmware or "").partition(".")[0]
    return next((name for name, of_it in GENERATIONS.items() if major in of_it), None)


def understood(identity: Identity) -> Identity:
    """The same, with what its software tells of it."""
    number = numbers_of(identity.firmware)
    span = next((each for each in SOFTWARE if number is not None and each.first <= number[:2] <= each.last), None)
    known = Software(
        expected=_tested(), client_library=f"ur-rtde {version('ur_rtde')}", expected_client_library=f"ur-rtde {TESTED_LIBRARY}"
    )
    if span is not None:
        known = known._replace(drivable=span.drives, tested=span.drives and span.tested, reason=span.reason)
    says_later = identity.robot_api
    return identity._replace(
        generation=generation_of(identity.firmware),
        software=known,
        no_remote_control="PolyScope X tells it from 10.12 on; " if says_later else "this generation has no local control; ",
    )


def numbers_of(firmware: str | None) -> tuple[int, int, int] | None:
    """Major, minor and bugfix number of a version, "10.12" being 10.12.0; None where it is none."""
    match = re.match(r"(\d+)\.(\d+)(?:\.(\d+))?", firmware or "")
    return (int(match[1]), int(match[2]), int(match[3] or 0)) if match else None


def _tested() -> str:
    """The spans of tested versions, as text."""
    spans = [span.text for span in SOFTWARE if span.drives and span.tested]
    return f"{', '.join(spans[:-1])} and {spans[-1]}"


def model_of(identity: Identity) -> str | None:
    """The shipped model that a controller names: an e-Series controller leaves the e out, and its software is 5 or newer."""
    if identity.model is None:
        return None
    plain, known = identity.model.lower(), robot_names()
    major = (identity.firmware or "").partition(".")[0]
    e_series = major.isdigit() and int(major) >= E_SERIES_FROM
    wanted = (f"{plain}e", plain) if e_series and not plain.endswith("e") else (plain,)
    return next((name for name in wanted if name in known), None)


class UniversalRobots:
    """Arms of the CB3 and e-Series generations, with whatever software. Every method names the arm by its host."""

    no_data = "is port 30004 open?"

    def __init__(self, *, robot_api_port: int = ROBOT_API_PORT) -> None:
        """The port is that of a PolyScope X."""
        self.robot_api_port = robot_api_port

    @property
    def client_library(self) -> str:
        """ur-rtde's version."""
        return version("ur_rtde")

    def identity(self, host: str) -> Identity:
        """Who the controller says it is, and its joints' limits. Raises RobotUnreachable.

        The Robot API of a PolyScope X does not tell its software and, before 10.14, its model: RTDE and the primary port do.
        """
        with conversation.conversation(host, robot_api_port=self.robot_api_port) as controller:
            told = controller.identity()
        configured = primary.configured(host)
        told = told._replace(joint_limits=configured.limits)
        if not told.robot_api:
            return understood(told)
        model, firmware = told.model or configured.model, software_of(host)
        sources = ["software by RTDE"] if firmware else []
        sources += ["model by the primary port"] if told.model is None and model is not None else []
        return understood(told._replace(model=model, firmware=firmware, sources=", ".join(["Robot API", *sources])))

    def services(self, host: str) -> Services:
        """Which of the ports that a motion needs take a connection: one that is opened and closed again starts nothing.

        A controller has a dashboard or a Robot API; where it has neither, both are named.
        """
        stop = {DASHBOARD_PORT: "Dashboard Server", self.robot_api_port: "Robot API"}
        with ThreadPoolExecutor(len(NEEDED) + len(stop)) as looking:
            found = dict(zip((*NEEDED, *stop), looking.map(lambda port: takes_connection(host, port), (*NEEDED, *stop)), strict=True))
        wanted = NEEDED | {port: name for port, name in stop.items() if found[port] or not any(found[each] for each in stop)}
        answers, silent = (tuple(f"{name} ({port})" for port, name in wanted.items() if found[port] == it) for it in (True, False))
        return Services(answers, silent, SWITCH)

    def model_of(self, identity: Identity) -> str | None:
        """The shipped model that a controller names."""
        return model_of(identity)

    def currents_and_torques(self, host: str) -> Array | None:
        """(N, 2, J) rows of one second; a controller before 5.23 reports no torque."""
        variables = ("actual_current", "actual_current_as_torque")
        return rows_of(host, variables, count=CURRENT_ROWS, rate_hz=CURRENT_RATE_HZ, timeout_s=CURRENT_WITHIN_S)

    def state(self, host: str, rate_hz: float, timeout_s: float) -> ArmState | None:
        """The arm's state now, by receiving only; None where no RTDE data comes within timeout_s."""
        return observe(Listening(host, rate_hz), timeout_s)

    def node_says(self, host: str) -> NodeSays | None:
        """What the node of the program that was played last has left in its registers; None where the controller does not answer."""
        try:
            found = output_integers(host, (VERSION, OFFER))
        except RobotUnreachable:
            return None
        return None if found is None else NodeSays(*found)

    def node_control(self, host: str) -> str:
        """ur-rtde's control script for this controller."""
        return control_script(host)

    def node_text(self, control: str, *, version: int = 0) -> str:
        """The text of a node around ur-rtde's control script."""
        return hand_over_script(control, version=version)

    def node_server(self, text: str, *, bind: str, port: int) -> HandOverServer:
        """The server that the manufacturer's External Control node asks at Play."""
        return HandOverServer(text, bind=bind, port=port)

    def node_answer(self, address: str, port: int) -> str | None:
        """What the port answers to a node's request; None where nobody listens."""
        return answer_of(address, port)

    def lock_sockets(self) -> str | None:
        """Set the filter that ends this process at its first attempt to open a socket."""
        return forbid_new_sockets()

    def listen(self, host: str, rate_hz: float) -> Session:
        """A plain socket in this process."""
        return Listening(host, rate_hz)

    def errors(self, host: str) -> ReportedErrors:
        """A connection that tells the errors which the controller reports from now on."""
        return ReportedErrors(host)

    def stream(self, task: ReplayTask) -> Session:
        """A process that plays one replay once it is told `go`. Raises RobotUnreachable where ur-rtde's program cannot be had.

        ur-rtde is not asked for it while a program plays, because it clears its registers; the process refuses the motion then.
        """
        number, host = numbers_of(task.software), task.settings.host
        too_early = any(number is not None and first <= number < known for first, known in NAMES_TOO_EARLY)
        if too_early and task.settings.lent is None and self.playing_program(host) is None:
            task = replace(task, program=control_program(host))
        return Child("monitor.acquire.ur.stream", task)

    def witness(self, host: str) -> PrimaryWitness:
        """What reads the primary port."""
        return PrimaryWitness(host)

    def cause_of_death(self, exit_code: int, silent_s: float, printed: str, call: str) -> Interruption:
        """Why a session's process ended without a last word."""
        return cause_of_death(exit_code, silent_s, printed, call)

    def safety_stop(self, host: str) -> SafetyStop | None:
        """The stop that the controller's safety system holds; None where there is none, or where the controller does not tell."""
        return conversation.safety_stop(host, robot_api_port=self.robot_api_port)

    @contextmanager
    def remote_control(self, host: str) -> Iterator[Callable[[], bool | None]]:
        """A conversation in which each call asks whether the controller takes commands over the network."""
        with conversation.conversation(host, REMOTE_TIMEOUT_S, robot_api_port=self.robot_api_port) as controller:
            yield controller.remote_control

    def playing_program(self, host: str) -> str | None:
        """The name of the program that plays, empty where the software tells no names; None where none plays. Raises RobotUnreachable."""
        return conversation.playing_program(host, robot_api_port=self.robot_api_port)

    def stop_program(self, host: str, ours: OurProgram) -> OurEnd:
        """End our program and no other. Returns how it has ended, as the controller shows it."""
        return conversation.stop_program(host, ours, robot_api_port=self.robot_api_port)


def driver(*, robot_api_port: int = ROBOT_API_PORT) -> UniversalRobots:
    """The driver of this make."""
    return UniversalRobots(robot_api_port=robot_api_port)
