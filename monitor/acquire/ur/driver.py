"""Universal Robots behind the room's `Driver`: ur-rtde in child processes, and dashboard server or Robot API over a plain socket."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from monitor.acquire.driver import OurProgram, ReplayTask, SafetyStop, Session, SessionEnded
from monitor.acquire.state import ArmState, Identity, arm_state
from monitor.acquire.ur import conversation, primary
from monitor.acquire.ur.job import job_document
from monitor.acquire.ur.process import Child
from monitor.acquire.ur.robot_api import PORT as ROBOT_API_PORT
from monitor.acquire.ur.rtde_rows import software_of

REMOTE_TIMEOUT_S = 0.5  # for one answer whether remote control is on; a controller answers within some milliseconds
ANSWER_POLL_S = 0.05  # between two checks for the observing process's answer


class UniversalRobots:
    """Arms of the CB3 and e-Series generations, with whatever software. Every method names the arm by its host."""

    robot_api_port = ROBOT_API_PORT

    def __init__(self, *, robot_api_port: int = ROBOT_API_PORT) -> None:
        """The port is that of a PolyScope X."""
        self.robot_api_port = robot_api_port

    def identity(self, host: str) -> Identity:
        """Who the controller says it is, and its joints' limits. Raises RobotUnreachable.

        The Robot API of a PolyScope X does not tell its software and, before 10.14, its model: RTDE and the primary port do.
        """
        with conversation.conversation(host, robot_api_port=self.robot_api_port) as controller:
            told = controller.identity()
        configured = primary.configured(host)
        told = told._replace(joint_limits=configured.limits)
        if not told.robot_api:
            return told
        model, firmware = told.model or configured.model, software_of(host)
        sources = ["software by RTDE"] if firmware else []
        sources += ["model by the primary port"] if told.model is None and model is not None else []
        return told._replace(model=model, firmware=firmware, sources=", ".join(["Robot API", *sources]))

    def state(self, host: str, rate_hz: float, timeout_s: float) -> ArmState | None:
        """The arm's state now, by receiving only; None where no RTDE data comes within timeout_s."""
        child = Child("monitor.acquire.ur.observe", {"host": host, "rate_hz": rate_hz})
        until = time.monotonic() + timeout_s
        try:
            while time.monotonic() < until:
                for frame in child.frames(ANSWER_POLL_S):
                    return None if isinstance(frame, dict) else arm_state(frame)
        except SessionEnded:
            return None
        finally:
            child.end()
        return None

    def listen(self, host: str, rate_hz: float, *, every_tick: bool) -> Session:
        """A process that receives only and sends rows."""
        return Child("monitor.acquire.ur.listen", {"host": host, "rate_hz": rate_hz, "every_tick": every_tick})

    def stream(self, task: ReplayTask) -> Session:
        """A process that plays one replay once it is told `go`."""
        return Child("monitor.acquire.ur.stream", job_document(task))

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

    def stop_program(self, host: str, ours: OurProgram) -> bool:
        """End our program and no other. False where the controller did not show that it has ended."""
        return conversation.stop_program(host, ours, robot_api_port=self.robot_api_port)


UNIVERSAL_ROBOTS = UniversalRobots()
