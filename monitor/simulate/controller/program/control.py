"""The register machine of ur-rtde's control script: one pass a tick, commands in, acknowledgements out.

Command register I0; OI0 = 1 ready, 2 done; OI1 a result; OI2 the word of asynchronous motions; OD0… vectors. A command whose
arguments the real controller would answer with a runtime exception ends the program, as there.
"""

import logging
import math
from collections import deque
from collections.abc import Callable
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm import motions
from monitor.simulate.controller.program import queries
from monitor.simulate.controller.program.scripts import ControlScript, Move, Progress, Step, Steps, StopMotion, Wait, Write

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller

log = logging.getLogger(__name__)

READY, DONE = 1, 2
SERVO_J, SERVO_L, SPEED_J, SPEED_L, END = 11, 24, 9, 10, 255
MOTIONS = frozenset({1, 2, 3, 4, 45})  # wait for an arm that may move
REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
SERVO_TIME_MIN_S, SERVO_TIME_MAX_S = 1e-4, 10.0  # what a call of servoj may be told to last; shorter: a tick
LOOKAHEAD_S, GAIN = (0.03, 0.2), (100.0, 2000.0)  # servoj's documented ranges


class ControlProgram:
    """ur-rtde's script, running."""

    def __init__(self, script: ControlScript, controller: "Controller") -> None:
        self._int, self._double = script.int_offset, script.double_offset
        self.command_register = f"input_int_register_{self._int}"  # carries commands, and the watchdog listens to it
        self._controller = controller
        self._executing = False
        self._busy: Callable[[], bool] | None = None  # a blocking motion keeps the loop busy
        self._asynchronous: Callable[[], bool] | None = None
        self._path = script.path
        self._writes = self._operation = 0
        self._last_refused = 0
        self._packets: list[list[float]] = []
        self._speed_l: Callable[[Array, float], None] | None = None
        self._progress(-1)
        self._set(0, READY)

    # --- registers ----------------------------------------------------------------------------------------------
    def _input(self, index: int) -> int:
        return self._controller.inputs.ints[self._int + index]

    def vector(self, index: int = 0, length: int = 6) -> list[float]:
        """Input doubles from `index` on."""
        at = self._double + index
        return self._controller.inputs.doubles[at : at + length]

    def _set(self, index: int, value: int) -> None:
        self._controller.output_ints[self._int + index] = value

    def _answer(self, values: Array) -> None:
        self._controller.output_doubles[self._double : self._double + len(values)] = [float(value) for value in values]

    def _progress(self, value: int) -> None:
        """OI2: bits 0–14 progress, 15 running, 16–22 count of writes, 24–30 number of the operation; −1 means finished."""
        self._writes = (self._writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        running = min(value, 32767) + 32768 if value >= 0 else 0
        self._set(2, self._writes * 65536 + self._operation * 16777216 + running)

    # --- life ---------------------------------------------------------------------------------------------------
    def received(self) -> None:
        """A packet with the command register has come: every servoj target counts, not only the last of a tick."""
        if self._input(0) == SERVO_J and len(self._packets) < 16:
            self._packets.append(self.vector())

    def step(self) -> bool:
        """One pass of the loop. False when the script has ended."""
        packets, self._packets = self._packets, []
        if self._busy is not None:
            if not self._busy():
                return True
            self._busy = None
            self._set(0, DONE)
        if self._asynchronous is not None and self._asynchronous():
            self._asynchronous = None
            self._progress(-1)
        if self._controller.program is not self:  # a path has met something impossible
            return True
        command = self._input(0)
        if command == END:
            return False
        if command in REALTIME:
            self._realtime(command, packets)
            self._set(0, READY)
        elif command == 0:
            self._executing = False
            self._set(0, READY)
        elif not self._executing and (command not in MOTIONS or self._controller.may_move):
            self._executing = True
            self._once(command)
            if self._busy is None and self._controller.program is self:  # a runtime exception ends the program: never done
                self._set(0, DONE)
        return True

    def _raise(self, why: str) -> None:
        self._controller.stop_program(f"runtime exception: {why}")

    # --- commands -----------------------------------------------------------------------------------------------
    def _realtime(self, command: int, packets: list[list[float]]) -> None:
        controller, reference = self._controller, self._controller.reference
        if command in queries.REALTIME:
            queries.REALTIME[command](self)
        elif not controller.may_move:  # a protective stop in which the program plays on: the arm stands
            return
        elif command in (SERVO_J, SERVO_L):
            time_s, lookahead_s, gain = self.vector(8, 3)
            told = packets or ([self.vector()] if reference.mode != "servo" or command == SERVO_L else [])
            if not all(map(math.isfinite, (*chain.from_iterable(told), time_s, lookahead_s, gain))):
                controller.protective_stop("servoj with a target that is not a number")
                return
            if command == SERVO_L:
                found = controller.moves.inverse(np.array(told[-1]))
                if found is None:
                    controller.protective_stop("servol: no joint positions for the target")
                    return
                told = [found.tolist()]
            why = controller.moves.sudden(told[-1]) if told else ""
            if why:
                controller.protective_stop(f"servoj: {why}")
                return
            time_s = min(time_s, SERVO_TIME_MAX_S) if time_s > SERVO_TIME_MIN_S else 0.0
            lookahead_s, gain = min(max(lookahead_s, LOOKAHEAD_S[0]), LOOKAHEAD_S[1]), min(max(gain, GAIN[0]), GAIN[1])
            reference.follow(told, time_s, lookahead_s, gain)
        elif command in (SPEED_J, SPEED_L):
            wanted, acceleration = np.array(self.vector()), self.vector(6, 1)[0]
            if not (np.isfinite(wanted).all() and math.isfinite(acceleration)):
                controller.protective_stop("speedj with a target that is not a number")
            elif command == SPEED_J:
                reference.speed(wanted, acceleration)
            else:
                if reference.mode != "speedl" or self._speed_l is None:
                    self._speed_l = motions.tool_speed(controller.kinematics, reference, controller.robot.max_speed_rad_s)
                self._speed_l(wanted, acceleration)
        elif command != self._last_refused:
            self._refuse(command)
        self._last_refused = command

    def _once(self, command: int) -> None:
        controller, reference = self._controller, self._controller.reference
        first = self.vector(0, 1)[0]
        match command:
            case 1 | 2 | 3 | 4:  # moveJ, moveJ_IK, moveL, moveL_FK
                speed, acceleration = self.vector(6, 2)
                move = Move(
                    tuple(self.vector()), pose=command in (2, 3), straight=command in (3, 4), speed=speed, acceleration=acceleration
                )
                why = controller.moves.start(move)
                if why:
                    self._raise(f"{'moveL' if move.straight else 'moveJ'}: {why}")
                else:
                    self._motion(lambda: controller.moves.over, asynchronous=self._input(1) == 1)
            case 15 | 16:  # speedStop, servoStop; stopl of the latter is a joint deceleration here
                straight = command == 15 and reference.mode == "speedl"
                controller.moves.stop(StopMotion(first if math.isfinite(first) else 10.0, straight))
                self._motion(lambda: controller.moves.over, asynchronous=False)
            case 33 | 34:  # stopL, stopJ
                controller.moves.stop(StopMotion(first if math.isfinite(first) else 2.0, straight=command == 33))
                self._motion(lambda: controller.moves.over, asynchronous=self._input(1) == 1)
            case 45:  # movePath
                playing = Player(self._path, controller, self._progress)
                self._motion(playing.over, asynchronous=self._input(1) == 1)
            case 8:  # zeroFtSensor: nothing touches the arm, its sensor shows zero already
                pass
            case 31:
                controller.protective_stop("asked for by the program")
            case 35:  # setWatchdog
                if math.isfinite(first) and first > 0.0:
                    controller.arm_watchdog(self.command_register, first)
                else:
                    self._raise(f"rtde_set_watchdog: {first:g} Hz; expected more than 0")
            case _ if command in queries.ONCE:
                try:
                    result = queries.ONCE[command](self)
                except queries.Impossible as wrong:
                    self._raise(str(wrong))
                else:
                    self._tell(result)
            case _:
                self._refuse(command)

    def _tell(self, result: "queries.Result") -> None:
        if isinstance(result, bool | int):
            self._set(1, int(result))
        elif result is not None:
            self._answer(result)

    @property
    def controller(self) -> "Controller":
        """Whose program it is."""
        return self._controller

    def whole(self, index: int) -> int:
        """An input integer."""
        return self._input(index)

    def answer(self, result: "queries.Result") -> None:
        """Into the output registers."""
        self._tell(result)

    def _motion(self, over: Callable[[], bool], *, asynchronous: bool) -> None:
        if self._asynchronous is not None:
            self._progress(-1)
        self._asynchronous = over if asynchronous else None
        if asynchronous:
            self._progress(0)
        else:
            self._busy = None if over() else over

    def _refuse(self, command: int) -> None:
        """Visibly: told in the log and in the truth, done with result 0."""
        log.warning("command %d of the control script is not simulated: refused", command)
        self._controller.refused_commands.append(command)
        self._set(1, 0)


class Player:
    """Plays a list of steps, each to its end: moves come to rest at every waypoint, blend radii are not modelled."""

    def __init__(self, steps: tuple[Step, ...], controller: "Controller", on_progress: Callable[[int], None] = lambda _: None) -> None:
        self._left, self._controller, self._on_progress = deque(steps), controller, on_progress
        self._until_s = -math.inf

    def over(self) -> bool:
        """Go on as far as possible; True when nothing is left."""
        controller = self._controller
        while controller.moves.over and controller.clock_s >= self._until_s:
            if not self._left:
                return True
            if isinstance(self._left[0], Move) and not controller.may_move:
                return False
            match self._left.popleft():
                case Move() as move:
                    why = controller.moves.start(move)
                    if why:
                        self._left.clear()
                        controller.stop_program(f"runtime exception: {why}")
                        return False
                case StopMotion() as stop:
                    controller.moves.stop(stop)
                case Write(register, value, whole):
                    if whole:
                        controller.output_ints[register] = int(value)
                    else:
                        controller.output_doubles[register] = value
                case Progress(value):
                    self._on_progress(value)
                case Wait(seconds):
                    self._until_s = controller.clock_s + seconds
        return False


class StepsProgram:
    """A script that is a list of steps: ends after the last."""

    command_register = ""

    def __init__(self, script: Steps, controller: "Controller") -> None:
        self._player = Player(script.steps, controller)

    def received(self) -> None:
        """Listens to nothing."""

    def step(self) -> bool:
        """False when nothing is left to do."""
        return not self._player.over()


class SteppedProgram:
    """Stands for the player of `stepped.py`, which moves the reference itself, so that nobody else starts a program."""

    command_register = ""

    def received(self) -> None:
        """Listens to nothing."""

    def step(self) -> bool:
        """Runs until it is stopped."""
        return True
