"""What the primary port tells of an arm during a motion and after it, on a connection of its own: the history of a gap in the rows.

The controller sends its state some ten times a second: the time on its clock, the modes, whether a program runs, and where each joint is;
and at once the name of each program that starts. What it sends while the network is away comes when the network is back, in its order, so
nothing that happened meanwhile is lost as long as the connection stands. Layout: the manufacturer's guide to the client interfaces.
"""

import math
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from monitor.acquire.driver import History
from monitor.acquire.state import ROBOT_MODE_RUNNING, ROBOT_MODES, STANDSTILL_RAD_S
from monitor.acquire.ur.packages import Link, take_packages
from monitor.acquire.ur.primary import HEAD, OUR_NAME, PORT, ROBOT_MESSAGE, ROBOT_STATE, program_message, reported_mode
from monitor.reason import Reason, Sentence

MODE_PACKAGE, JOINT_PACKAGE, BOARD_PACKAGE = 0, 1, 3
SAFETY_AT, SAFE_MODES = 60, frozenset({1, 2})  # where the master board's data have the safety mode; normal and reduced
# time [µs]; connected, enabled, power, emergency stop, protective stop, program runs, is paused; robot mode, control mode
MODE = struct.Struct(">Q7?BB")
TEACH = 1  # the control mode in freedrive
JOINT = struct.Struct(">dddffffB")  # position, target [rad], speed [rad/s], current, voltage, two temperatures, mode
KEPT = 1200  # states: two minutes
POLL_S = 0.1
STATE_EVERY_S = 0.15  # a program and a safety mode are told with the time of the state before them
HOLE_S = 0.5  # between two states: what lies between them was not told
WAIT_S = 2.0  # for what a network that was away brings late
RESTS_WITHIN_S, MOVED_RAD = 0.6, 0.01  # after the end of the program; the servo of an arm at rest settles by less

STOPPED_MEANWHILE = Sentence("stopped_meanwhile", "its safety system stopped the arm while nobody saw it")
MODE_MEANWHILE = Sentence("mode_meanwhile", "the robot mode was {mode} ({name:word}) while nobody saw the arm")
TAUGHT_MEANWHILE = Sentence("taught_meanwhile", "somebody held the freedrive button while nobody saw the arm")
PROGRAM_MEANWHILE = Sentence("program_meanwhile", "the program {program!r} ran while nobody saw the arm")
ANOTHER_MEANWHILE = Sentence("another_program_meanwhile", "a program ran, after ours had ended, while nobody saw the arm")
MOVED_MEANWHILE = Sentence("moved_meanwhile", "{joint:joint} moved after the arm had come to rest, while nobody saw it")


class Told(NamedTuple):
    """One state of the arm."""

    at_s: float  # when the controller sent it, by this host's monotonic clock
    controller_s: float
    stopped: bool
    robot_mode: int
    runs: bool  # a program
    paused: bool  # … is paused
    teach: bool  # somebody holds the arm in freedrive
    q: tuple[float, ...]  # (J,) [rad]
    qd: tuple[float, ...]  # (J,) [rad/s]


def told(state: bytes) -> Told | None:
    """What the packages of one robot state say, without its head; `at_s` is not known yet. None where it lacks modes or joints."""
    modes: tuple[int | bool, ...] | None = None
    joints: list[tuple[float, ...]] = []
    safe = True
    waiting = bytearray(state)
    for kind, package in take_packages(waiting, HEAD):
        if kind == MODE_PACKAGE and len(package) >= MODE.size:
            modes = MODE.unpack_from(package)
        elif kind == JOINT_PACKAGE:
            joints = [JOINT.unpack_from(package, at) for at in range(0, len(package) - JOINT.size + 1, JOINT.size)]
        elif kind == BOARD_PACKAGE and len(package) > SAFETY_AT:
            safe = package[SAFETY_AT] in SAFE_MODES
    if modes is None or not joints:
        return None
    time_us, _, _, _, emergency, protective, runs, paused, mode, control = modes
    q, _, qd, *_ = zip(*joints, strict=True)
    return Told(
        math.nan, 1e-6 * time_us, bool(emergency or protective or not safe), int(mode), bool(runs), bool(paused), control == TEACH, q, qd
    )


class PrimaryWitness:
    """Reads the primary port in a thread until it is closed. Where nobody listens, or the connection is lost, it knows nothing."""

    def __init__(self, host: str, port: int = PORT) -> None:
        """`begin` connects."""
        self._host, self._port = host, port
        self._link: Link | None = None
        self._states: deque[Told] = deque(maxlen=KEPT)
        self._started: deque[tuple[float, str]] = deque(maxlen=KEPT)  # when and which programs were told to have started
        self._offset_s = math.inf  # smallest difference of a state's arrival on the host's clock and its time on the controller's
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="witness", daemon=True)

    def begin(self) -> None:
        """Begin to connect, and to read."""
        self._link = Link.to(self._host, self._port)
        self._thread.start()

    def ours_runs(self) -> bool:
        """Whether a program runs now, or is paused, and the last that was told to have started is ours."""
        states, started = list(self._states), list(self._started)
        if self._link is None or not states or not started:
            return False
        return (states[-1].runs or states[-1].paused) and time.monotonic() - states[-1].at_s <= STATE_EVERY_S and started[-1][1] == OUR_NAME

    def history(self, since_s: float, until_s: float, *, programs: bool = True) -> History:
        """What happened between two times of this host's monotonic clock; waits up to WAIT_S for what comes late.

        programs : False: another program may run, and may move the arm.
        """
        give_up_s = time.monotonic() + WAIT_S
        while self._link is not None and (not self._states or self._states[-1].at_s < until_s) and time.monotonic() < give_up_s:
            time.sleep(0.02)
        states = [each for each in list(self._states) if since_s - HOLE_S <= each.at_s <= until_s + HOLE_S]
        times = [since_s, *(each.at_s for each in states if since_s < each.at_s < until_s), until_s]
        whole = bool(states) and states[0].at_s <= since_s + HOLE_S and states[-1].at_s >= until_s - HOLE_S
        known = whole and float(np.max(np.diff(times))) <= HOLE_S
        found = next(against([each for each in states if each.at_s >= since_s - STATE_EVERY_S], programs=programs), None)
        if found is None and programs:
            names = [name for at_s, name in list(self._started) if since_s - STATE_EVERY_S <= at_s and name != OUR_NAME]
            found = PROGRAM_MEANWHILE(program=names[0]) if names else None
        return History(known, found)

    def close(self) -> None:
        """Close the connection, and end its thread."""
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        waiting, link = bytearray(), self._link
        assert link is not None
        try:
            while not self._over.is_set():
                if link.wait(POLL_S):
                    waiting += link.read()
                    for kind, message in take_packages(waiting, HEAD):
                        self._take(kind, message, time.monotonic())
        except OSError:
            pass  # from now on nothing is told: `history` says so
        finally:
            self._link = None
            link.close()

    def _take(self, kind: int, message: bytes, now_s: float) -> None:
        if kind == ROBOT_STATE and (state := told(message)) is not None:
            self._offset_s = min(self._offset_s, now_s - state.controller_s)
            self._states.append(state._replace(at_s=state.controller_s + self._offset_s))
        elif kind == ROBOT_MESSAGE and (mode := reported_mode(message)) is not None:
            if mode.mode not in SAFE_MODES and self._states:
                self._states.append(self._states[-1]._replace(stopped=True))
        elif kind == ROBOT_MESSAGE and (program := program_message(message)) is not None and program.started:
            at_s = self._states[-1].at_s if self._states else now_s
            self._started.append((at_s, program.name))


def against(states: list[Told], *, programs: bool) -> Iterator[Reason]:
    """What speaks against an arm that only came to rest, in successive states of it."""
    ended_s: float | None = None
    rested: np.ndarray | None = None  # (J,) [rad] where the arm came to rest
    for state in states:
        if state.stopped:
            yield STOPPED_MEANWHILE()
        if state.robot_mode != ROBOT_MODE_RUNNING:
            yield MODE_MEANWHILE(mode=state.robot_mode, name=ROBOT_MODES.get(state.robot_mode, "unknown"))
        if state.teach:
            yield TAUGHT_MEANWHILE()
        if not programs:
            continue
        if ended_s is None:
            ended_s = None if state.runs else state.at_s
        elif state.runs:
            yield ANOTHER_MEANWHILE()
        slow = np.abs(state.qd) <= STANDSTILL_RAD_S  # (J,)
        if ended_s is not None and rested is None and np.all(slow):
            rested = np.array(state.q)
        in_place = slow if rested is None else slow & (np.abs(np.array(state.q) - rested) <= MOVED_RAD)
        late = ended_s is not None and (rested is not None or state.at_s - ended_s > RESTS_WITHIN_S)
        if late and not np.all(in_place):
            yield MOVED_MEANWHILE(joint=int(np.argmin(in_place)) + 1)
