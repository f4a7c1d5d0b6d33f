"""ur-rtde's control connection: without upload, without a second connection, and with a time limit for every call.

ur-rtde would stop a program that runs, upload its own when it connects, and do both again whenever a connection breaks off. Here it is
constructed without upload, its dashboard connection is ended, and the kernel forbids it new connections. What is left is what it is
asked for: the control program when `upload` is called, and commands to that program. At the node of a program that lends the arm nothing
is ever uploaded: the control loop is in the program.
"""

import os
import socket
from collections.abc import Callable
from typing import TypeVar

from rtde_control import RTDEControlInterface

from monitor.acquire.ur.failures import StreamFailure
from monitor.acquire.ur.last_resorts import (
    RTDE_PORT,
    SCRIPT_PORT,
    PeerWatch,
    end_dashboard,
    end_scripts,
    end_this_process_on_alarm,
    forbid_new_sockets,
    report_within,
    send_at_once,
)
from monitor.errors import MotionRefused, RobotUnreachable
from monitor.reason import Sentence
from monitor.recording import Array

TARGET_CALL_S = 0.05  # a call of servoJ takes 0.05 ms; a busy machine adds 30 ms now and then; one that blocks waits for a lost connection
STANDING_CALL_S = 0.5  # uploading and commands to a program whose arm stands take one to three ticks
ENDING_CALL_S = 2.0  # the end of the program, with the arm at rest
STANDING_S = 1.0  # between two reports of this process while the arm stands

Result = TypeVar("Result")


NO_CONTROL_CONNECTION = Sentence("no_control_connection", "{host}: RTDE control: {why}")
ARM_IN_USE = Sentence(
    "arm_in_use",
    "another RTDE client holds the controller's input registers, which the commands of a replay need: another driver, a URCap, a fieldbus "
    "adapter, or a connection that has just ended. ur-rtde cannot tell which, and names fieldbuses alone: {why!r}",
)
CONNECTIONS_NOT_SHOWN = Sentence("connections_not_shown", "this machine does not show this process's connections: {why}")
SOCKETS_NOT_LOCKED = Sentence("sockets_not_locked", "this machine cannot keep ur-rtde from reconnecting and moving the arm again: {why}")
CONNECTION_BROKE_OFF = Sentence("connection_broke_off", "the RTDE connection broke off: {why}")


class Control:
    """The control connection. After construction no thread of this process can open another socket."""

    def __init__(
        self, host: str, rate_hz: float, *, lent: bool = False, program: str | None = None, calling: Callable[[str], None] = lambda _: None
    ) -> None:
        """Connect; nothing is uploaded, and no program is stopped.

        lent : the control loop is part of a program that plays already. program : the text that `upload` sends; None: ur-rtde's own.
        calling : is told the name of each call that may block this process, before it is made.

        Raises RobotUnreachable; MotionRefused where another client controls the arm, or where new connections cannot be forbidden.
        """
        self._host, self._calling = host, calling
        self._pause_s = STANDING_S  # from one call to the next, at most
        self._program = None if program is None else _in_memory(program)
        try:
            self._rtde = RTDEControlInterface(host, rate_hz, *_mode(lent=lent))
        except RuntimeError as error:
            if "already in use" in str(error):
                raise MotionRefused(ARM_IN_USE(why=str(error))) from None
            raise RobotUnreachable(NO_CONTROL_CONNECTION(host=host, why=str(error))) from None
        try:
            send_at_once(host)
            end_dashboard(host)
            self._peer = PeerWatch(host, RTDE_PORT)
            self._script_peer = PeerWatch(host, SCRIPT_PORT)
        except OSError as error:  # /proc is not there
            raise MotionRefused(CONNECTIONS_NOT_SHOWN(why=str(error))) from None
        if lent:
            self.end_uploads()
        if why := forbid_new_sockets():
            raise MotionRefused(SOCKETS_NOT_LOCKED(why=why))
        end_this_process_on_alarm()

    @property
    def connected(self) -> bool:
        """Whether this connection and the receiving one stand, as far as the kernel and ur-rtde know."""
        return not self._peer.ended and bool(self._rtde.isConnected())

    def program_runs(self) -> bool:
        """Whether a program runs, as the control connection reports; the rows come on another one, a tick earlier or later."""
        return bool(self._rtde.isProgramRunning())

    def report(self) -> None:
        """Tell the kernel that this process is on time; between two calls of this method it ends the process."""
        report_within(self._pause_s)

    def report_every(self, pause_s: float) -> None:
        """From now on this process must report at least so often."""
        self._pause_s = pause_s
        self.report()

    @property
    def can_upload(self) -> bool:
        """Whether the connection on which a program is sent stands, as far as the kernel knows."""
        return not self._script_peer.ended

    def upload(self) -> bool:
        """Send the control program; False where it could not be sent.

        The caller knows that no program runs, on this connection too: ur-rtde would try to stop it.
        """
        return self._call(self._upload, STANDING_CALL_S, "reuploadScript")

    def _upload(self) -> bool:
        if self._program is None:
            return bool(self._rtde.reuploadScript())
        self._rtde.setCustomScriptFile(self._program)  # sends it, and does not say whether it could
        return True

    def end_uploads(self) -> None:
        """Make it impossible to send a program from here again."""
        end_scripts(self._host)

    def set_watchdog(self, lowest_hz: float) -> bool:
        """Let the controller stop the program when it receives fewer targets; False where it does not accept that."""
        return self._call(lambda: bool(self._rtde.setWatchdog(lowest_hz)), STANDING_CALL_S, "setWatchdog")

    def servo(self, target: Array, tick_s: float, lookahead_s: float, gain: float) -> bool:
        """Send one target (J,) [rad]; False where the program does not take it."""
        return self._call(lambda: bool(self._rtde.servoJ(target, 0.0, 0.0, tick_s, lookahead_s, gain)), TARGET_CALL_S)

    def stop_servo(self, deceleration_rad_s2: float) -> bool:
        """End the stream of targets; False where the program does not answer."""
        return self._call(lambda: bool(self._rtde.servoStop(deceleration_rad_s2)), ENDING_CALL_S, "servoStop")

    def end_program(self) -> None:
        """Ask the program to end; returns when it has ended, or when it does not."""
        self._call(self._rtde.stopScript, ENDING_CALL_S, "stopScript")

    def _call(self, function: Callable[[], Result], limit_s: float, name: str = "") -> Result:
        """The function's result. The kernel ends the process where it takes longer than limit_s; `name` is told before, if any.

        Raises StreamFailure where ur-rtde reports that the connection is lost.
        """
        if name:
            self._calling(name)
        report_within(limit_s)
        try:
            result = function()
        except RuntimeError as error:  # whatever the sockets below report arrives as this one type
            raise StreamFailure("connection_lost", CONNECTION_BROKE_OFF(why=str(error))) from None
        report_within(self._pause_s)
        return result


def _in_memory(text: str) -> str:
    """The path of a file with this text, which lasts as long as this process."""
    descriptor = os.memfd_create("control_program")
    with os.fdopen(descriptor, "w", closefd=False) as file:
        file.write(text)
    return f"/proc/self/fd/{descriptor}"


def _mode(*, lent: bool) -> tuple[int, ...]:
    """ur-rtde's flags, and for a lent arm the port on which it would serve its own text: any, the program has its text from us.

    Without the flag of the node ur-rtde refuses a controller in local control, which may lend its arm.
    """
    flags = RTDEControlInterface.Flags
    if not lent:
        return (int(flags.FLAG_NO_WAIT),)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    return int(flags.FLAG_USE_EXT_UR_CAP) | int(flags.FLAG_NO_WAIT), port
