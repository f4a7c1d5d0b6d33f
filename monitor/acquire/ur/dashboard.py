"""The controller's dashboard server over a plain socket: who the controller is, and the command that stops a program in any state.

ur-rtde has a dashboard client too, but it lives in the process that may be killed; this one works also after that.
"""

import math
import re
import socket
import time
from typing import Self

from monitor.acquire.driver import OurProgram, SafetyStop
from monitor.acquire.state import Identity
from monitor.errors import RobotUnreachable

PORT = 29999
LONGEST_LINE = 4096  # bytes; a dashboard's answer is far shorter
STOP_WITHIN_S = 1.6  # a replay must report its end within 2 s, also where the controller is gone; the controller's watchdog stops the arm
OURS_S = 0.1  # so long after it was known to be ours a running program is taken for ours: a cell needs longer to start one of its own
LOOK_PAUSE_S = 0.02  # between two looks at a program that is not stopped by us


class Dashboard:
    """One conversation: for each line sent, one line is answered.

    Every method raises RobotUnreachable where the controller does not answer in time or not in lines.
    """

    def __init__(self, host: str, timeout_s: float = 2.0) -> None:
        self._host, self._timeout_s = host, timeout_s
        self._waiting = b""

    def __enter__(self) -> Self:
        try:
            self._socket = socket.create_connection((self._host, PORT), timeout=self._timeout_s)
        except OSError as error:
            raise RobotUnreachable(f"{self._host}: no dashboard on port {PORT} ({error}); is the robot on and the address right?") from None
        try:
            self._line()  # the greeting
        except RobotUnreachable:
            self._socket.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def ask(self, command: str) -> str:
        """The controller's answer to one command."""
        try:
            self._socket.sendall(command.encode() + b"\n")
        except OSError as error:
            raise RobotUnreachable(f"{self._host}: the dashboard closed the connection ({error})") from None
        return self._line()

    def program(self) -> tuple[str, str | None]:
        """PLAYING, PAUSED or STOPPED, and the program's name; None where the software tells only whether a program runs."""
        answer = self.ask("programState")
        state, _, name = answer.partition(" ")
        if state.upper() in {"PLAYING", "PAUSED", "STOPPED"}:
            return state.upper(), name
        return ("STOPPED" if self.ask("running").lower() == "program running: false" else "PLAYING"), None

    def remote_control(self) -> bool | None:
        """Whether the controller takes commands over the network; None where it does not say."""
        return {"true": True, "false": False}.get(self.ask("is in remote control").lower())

    def _line(self) -> str:
        deadline = time.monotonic() + self._timeout_s
        while b"\n" not in self._waiting:
            if len(self._waiting) > LONGEST_LINE or time.monotonic() > deadline:
                raise RobotUnreachable(f"{self._host}: the dashboard does not answer in lines within {self._timeout_s:g} s")
            try:
                data = self._socket.recv(LONGEST_LINE)
            except OSError as error:
                raise RobotUnreachable(f"{self._host}: no answer from the dashboard ({error})") from None
            if not data:
                raise RobotUnreachable(f"{self._host}: the dashboard closed the connection")
            self._waiting += data
        line, _, self._waiting = self._waiting.partition(b"\n")
        return line.decode(errors="replace").strip()


def identity(host: str, timeout_s: float = 2.0) -> Identity:
    """Model, serial number, software version, and whether the controller takes commands over the network."""
    with Dashboard(host, timeout_s) as dashboard:
        model = re.fullmatch(r"UR\d+e?", dashboard.ask("get robot model"), re.IGNORECASE)
        serial = re.fullmatch(r"\d+", dashboard.ask("get serial number"))
        firmware = re.search(r"\d+\.\d+\.\d+(\.\d+)?", dashboard.ask("PolyscopeVersion"))
        remote = dashboard.remote_control()
    return Identity(
        model=model.group() if model else None,
        serial=serial.group() if serial else None,
        firmware=firmware.group() if firmware else None,
        remote_control=remote,
    )


SAFETY_CAUSES = {  # dashboard's safety mode → cause of a replay's end
    "PROTECTIVE_STOP": "protective_stop",
    "SAFEGUARD_STOP": "safeguard_stop",
    "SYSTEM_EMERGENCY_STOP": "emergency_stop",
    "ROBOT_EMERGENCY_STOP": "emergency_stop",
}


def safety_stop(host: str, timeout_s: float = 0.4) -> SafetyStop | None:
    """The stop that the controller's safety system holds; None where there is none, or where the controller does not answer."""
    try:
        with Dashboard(host, timeout_s) as dashboard:
            answer = dashboard.ask("safetymode")
    except RobotUnreachable:
        return None
    match = re.fullmatch(r"safetymode:\s*(\w+)", answer, re.IGNORECASE)
    mode = match[1].upper() if match else "NORMAL"
    return None if mode == "NORMAL" else SafetyStop(SAFETY_CAUSES.get(mode, "safety"), f"the controller's safety mode is {mode}")


def playing_program(host: str, timeout_s: float = 0.5) -> str | None:
    """The name of the program that plays, empty where the software tells no names; None where none plays. Raises RobotUnreachable."""
    with Dashboard(host, timeout_s) as dashboard:
        state, name = dashboard.program()
    return (name or "") if state == "PLAYING" else None


def stop_program(host: str, ours: OurProgram, within_s: float = STOP_WITHIN_S) -> bool:
    """End our program and no other: True once the controller has shown that no program runs, so that ours has ended.

    A `stop` is sent only where the controller has just shown a program that runs, and that program was known to be ours at most OURS_S
    before, and has the name of ours. Each such look makes the next one possible, so a program that ignores a stop is stopped again; after
    a longer pause, or once no program has run, whatever runs may be somebody else's.

    Returns False where the controller did not show the end within within_s.
    """
    until = time.monotonic() + within_s
    ours_at_s = -math.inf if ours.at_s is None else ours.at_s
    while time.monotonic() < until:
        try:
            with Dashboard(host, timeout_s=0.8) as dashboard:
                while time.monotonic() < until:
                    looked_at = time.monotonic()
                    state, name = dashboard.program()
                    another = state != "STOPPED" and bool(name and ours.name) and name != ours.name
                    if another:
                        return True  # it has taken the place of ours
                    is_ours = time.monotonic() - ours_at_s <= OURS_S
                    if state == "STOPPED" and not (is_ours and ours.state == "starting"):
                        return True
                    if is_ours and state != "STOPPED" and (state == "PAUSED" or ours.state != "paused"):
                        dashboard.ask("stop")
                        ours_at_s = looked_at
                    else:
                        time.sleep(LOOK_PAUSE_S)
        except RobotUnreachable:
            time.sleep(LOOK_PAUSE_S)
    return False
