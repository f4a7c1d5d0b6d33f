"""What is asked of a controller beside RTDE, and the command that stops a program in any state: one protocol over two kinds of server.

Software before 10 has a dashboard server, a PolyScope X a Robot API. Which one a controller has is found out by asking: where nobody
listens for the dashboard, the Robot API is asked. ur-rtde has a dashboard client too, but it lives in the process that may be killed, and
has none on a PolyScope X; this one works in both cases.
"""

import logging
import math
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Protocol

from monitor.acquire.driver import OurEnd, OurProgram, SafetyStop
from monitor.acquire.state import Identity
from monitor.acquire.ur.dashboard import Dashboard, NobodyListens
from monitor.acquire.ur.robot_api import PORT as ROBOT_API_PORT
from monitor.acquire.ur.robot_api import Refused, RobotApi
from monitor.errors import RobotUnreachable
from monitor.reason import Sentence

log = logging.getLogger(__name__)

STOP_WITHIN_S = 1.6  # a replay must report its end within 2 s, also where the controller is gone; the controller's watchdog stops the arm
OURS_S = 0.1  # so long after it was known to be ours a running program is taken for ours: a cell needs longer to start one of its own
LOOK_PAUSE_S = 0.02  # between two looks at a program that is not stopped by us
SAFETY_CAUSES = {  # safety mode → cause of a replay's end
    "PROTECTIVE_STOP": "protective_stop",
    "SAFEGUARD_STOP": "safeguard_stop",
    "SYSTEM_EMERGENCY_STOP": "emergency_stop",
    "ROBOT_EMERGENCY_STOP": "emergency_stop",
    "EMERGENCY_STOP": "emergency_stop",
}


class Conversation(Protocol):
    """Questions to one controller. Every method raises RobotUnreachable where it does not answer."""

    def program(self) -> tuple[str, str | None]:
        """PLAYING, PAUSED, STOPPED or another state, and the program's name; None where it is not told."""

    def remote_control(self) -> bool | None:
        """Whether the controller takes commands over the network; None where it does not say."""

    def safety_mode(self) -> str | None:
        """The safety mode in capitals; None where it does not say."""

    def stop(self) -> None:
        """Stop the program that runs."""

    def identity(self) -> Identity:
        """Who the controller says it is, as far as this server tells it."""


NEITHER_ANSWERS = Sentence("neither_server_answers", "{first}, and {second}; is the robot on and the address right?")
_answered_by_robot_api: set[tuple[str, int]] = set()  # controllers whose Robot API answered last: it is asked first


@contextmanager
def conversation(host: str, timeout_s: float = 2.0, *, robot_api_port: int = ROBOT_API_PORT) -> Iterator[Conversation]:
    """A conversation with whichever server the controller has. Raises RobotUnreachable where it has neither, with what both said."""
    known = (host, robot_api_port)
    dashboard, robot_api = Dashboard(host, timeout_s), RobotApi(host, timeout_s, port=robot_api_port)
    first: AbstractContextManager[Conversation] = robot_api if known in _answered_by_robot_api else dashboard
    second: AbstractContextManager[Conversation] = dashboard if first is robot_api else robot_api
    with ExitStack() as stack:
        try:
            opened = stack.enter_context(first)
        except NobodyListens as nobody:
            try:
                opened = stack.enter_context(second)
            except RobotUnreachable as neither:
                raise RobotUnreachable(NEITHER_ANSWERS(first=nobody.reason, second=neither.reason)) from None
        if opened is robot_api:
            _answered_by_robot_api.add(known)
        else:
            _answered_by_robot_api.discard(known)
        yield opened


SAFETY_MODE_IS = Sentence("safety_mode_is", "the controller's safety mode is {mode}")


def safety_stop(host: str, timeout_s: float = 0.4, *, robot_api_port: int = ROBOT_API_PORT) -> SafetyStop | None:
    """The stop that the controller's safety system holds; None where there is none, or where the controller does not tell."""
    try:
        with conversation(host, timeout_s, robot_api_port=robot_api_port) as controller:
            mode = controller.safety_mode() or "NORMAL"
    except RobotUnreachable:
        return None
    return None if mode == "NORMAL" else SafetyStop(SAFETY_CAUSES.get(mode, "safety"), SAFETY_MODE_IS(mode=mode))


def playing_program(host: str, timeout_s: float = 0.5, *, robot_api_port: int = ROBOT_API_PORT) -> str | None:
    """The name of the program that plays, empty where the software tells no names; None where none plays. Raises RobotUnreachable."""
    with conversation(host, timeout_s, robot_api_port=robot_api_port) as controller:
        state, name = controller.program()
    return (name or "") if state == "PLAYING" else None


def stop_program(host: str, ours: OurProgram, within_s: float = STOP_WITHIN_S, *, robot_api_port: int = ROBOT_API_PORT) -> OurEnd:
    """End our program and no other: `ended` once the controller has shown that no program runs, so that ours has ended.

    A `stop` is sent only where the controller has just shown a program that runs, and that program was known to be ours at most OURS_S
    before, and has the name of ours, or where a witness knows now that it is ours. Each such look makes the next one possible, so a program
    that ignores a stop is stopped again; after a longer pause, or once no program has run, whatever runs may be somebody else's.

    Returns `replaced` where a program of another name is there before any look has shown none: it has taken the place of ours;
    `not_shown` where the controller did not show the end within within_s.
    """
    until = time.monotonic() + within_s
    ours_at_s = -math.inf if ours.at_s is None else ours.at_s
    refusal = ""
    while time.monotonic() < until:
        try:
            with conversation(host, timeout_s=0.8, robot_api_port=robot_api_port) as controller:
                while time.monotonic() < until:
                    looked_at = time.monotonic()
                    state, name = controller.program()
                    another = state != "STOPPED" and bool(name and ours.name) and name != ours.name
                    if another:
                        return "replaced"
                    is_ours = time.monotonic() - ours_at_s <= OURS_S
                    if state == "STOPPED" and not (is_ours and ours.state == "starting"):
                        return "ended"
                    may_stop = state != "STOPPED" and (state == "PAUSED" or ours.state != "paused")
                    if (is_ours and may_stop) or (state in {"PLAYING", "PAUSED"} and ours.runs is not None and ours.runs()):
                        ours_at_s = looked_at  # so it was, also where nobody says whether the stop was taken
                        controller.stop()
                    else:
                        time.sleep(LOOK_PAUSE_S)
        except RobotUnreachable as error:
            if isinstance(error, Refused) and str(error) != refusal:
                refusal = str(error)
                log.warning("our program cannot be stopped from here: %s", refusal)
            time.sleep(LOOK_PAUSE_S)
    return "not_shown"
