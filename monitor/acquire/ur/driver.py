"""Universal Robots behind the room's `Driver`: ur-rtde in child processes, and the dashboard server over a plain socket."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from monitor.acquire.driver import OurProgram, ReplayTask, SafetyStop, Session, SessionEnded
from monitor.acquire.state import ArmState, Identity, arm_state
from monitor.acquire.ur import dashboard, primary
from monitor.acquire.ur.job import job_document
from monitor.acquire.ur.process import Child

REMOTE_TIMEOUT_S = 0.5  # for one answer whether remote control is on; a controller answers within some milliseconds
ANSWER_POLL_S = 0.05  # between two checks for the observing process's answer


class UniversalRobots:
    """Arms of the CB3 and e-Series generations. It holds no state: every method names the arm by its host."""

    def identity(self, host: str) -> Identity:
        """Who the controller says it is, from its dashboard server, and its joints' limits. Raises RobotUnreachable."""
        return dashboard.identity(host)._replace(joint_limits=primary.joint_limits(host))

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
        """The stop that the controller's safety system holds; None where there is none, or where the controller does not answer."""
        return dashboard.safety_stop(host)

    @contextmanager
    def remote_control(self, host: str) -> Iterator[Callable[[], bool | None]]:
        """A conversation with the dashboard, in which each call asks whether the controller takes commands over the network."""
        with dashboard.Dashboard(host, timeout_s=REMOTE_TIMEOUT_S) as conversation:
            yield conversation.remote_control

    def playing_program(self, host: str) -> str | None:
        """The name of the program that plays, empty where the software tells no names; None where none plays. Raises RobotUnreachable."""
        return dashboard.playing_program(host)

    def stop_program(self, host: str, ours: OurProgram) -> bool:
        """End our program and no other. False where the controller did not show that it has ended."""
        return dashboard.stop_program(host, ours)


UNIVERSAL_ROBOTS = UniversalRobots()
