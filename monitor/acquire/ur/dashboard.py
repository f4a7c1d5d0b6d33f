"""The dashboard server of software before 10 over a plain socket."""

import re
import socket
import time
from typing import Self

from monitor.acquire.state import Identity
from monitor.errors import RobotUnreachable
from monitor.reason import Sentence

PORT = 29999
LONGEST_LINE = 4096  # bytes; a dashboard's answer is far shorter


NO_DASHBOARD = Sentence("no_dashboard", "{host}: no dashboard on port {port} ({why})")
NO_ANSWER = Sentence("dashboard_no_answer", "{host}: no answer from the dashboard ({why})")
NO_LINES = Sentence("dashboard_no_lines", "{host}: the dashboard does not answer in lines within {limit_s:g} s")
CLOSED = Sentence("dashboard_closed", "{host}: the dashboard closed the connection")


class NobodyListens(RobotUnreachable):
    """No connection to this server: the controller may have the other one."""


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
            raise NobodyListens(NO_DASHBOARD(host=self._host, port=PORT, why=str(error))) from None
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
            raise RobotUnreachable(NO_ANSWER(host=self._host, why=str(error))) from None
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

    def safety_mode(self) -> str | None:
        """The safety mode in capitals; None where it does not say."""
        match = re.fullmatch(r"safetymode:\s*(\w+)", self.ask("safetymode"), re.IGNORECASE)
        return match[1].upper() if match else None

    def stop(self) -> None:
        """Stop the program that runs."""
        self.ask("stop")

    def identity(self) -> Identity:
        """Model, serial number, software version, and whether the controller takes commands over the network."""
        model = re.fullmatch(r"UR\d+e?", self.ask("get robot model"), re.IGNORECASE)
        serial = re.fullmatch(r"\d+", self.ask("get serial number"))
        firmware = re.search(r"\d+\.\d+\.\d+(\.\d+)?", self.ask("PolyscopeVersion"))
        return Identity(
            model=model.group() if model else None,
            serial=serial.group() if serial else None,
            firmware=firmware.group() if firmware else None,
            remote_control=self.remote_control(),
        )

    def _line(self) -> str:
        deadline = time.monotonic() + self._timeout_s
        while b"\n" not in self._waiting:
            if len(self._waiting) > LONGEST_LINE or time.monotonic() > deadline:
                raise RobotUnreachable(NO_LINES(host=self._host, limit_s=self._timeout_s))
            try:
                data = self._socket.recv(LONGEST_LINE)
            except OSError as error:
                raise RobotUnreachable(NO_ANSWER(host=self._host, why=str(error))) from None
            if not data:
                raise RobotUnreachable(CLOSED(host=self._host))
            self._waiting += data
        line, _, self._waiting = self._waiting.partition(b"\n")
        return line.decode(errors="replace").strip()
