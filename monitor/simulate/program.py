"""The register machine of ur-rtde's control script: one pass a tick, commands in, acknowledgements out.

Command register I0; OI0 = 1 ready, 2 done; OI1 a result; OI2 the word of asynchronous motions.
"""

import logging
import math
from typing import TYPE_CHECKING

import numpy as np

from monitor.recording import Array
from monitor.simulate.scripts import ControlScript

if TYPE_CHECKING:
    from monitor.simulate.controller import Controller

log = logging.getLogger(__name__)

READY, DONE = 1, 2
SERVO_J, SPEED_J, END = 11, 9, 255
REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
STEADY_RAD_S = 0.01
LOOKAHEAD_S, GAIN = (0.03, 0.2), (100.0, 2000.0)  # servoj's documented ranges


class ControlProgram:
    """ur-rtde's script, running."""

    def __init__(self, script: ControlScript, controller: "Controller") -> None:
        self._int, self._double = script.int_offset, script.double_offset
        self._controller = controller
        self._executing = False
        self._blocked = False  # a blocking motion keeps the loop busy
        self._asynchronous = False
        self._writes = self._operation = 0
        self._last_refused = 0
        self._packets: list[Array] = []
        self._progress(-1)
        self._set(0, READY)

    # --- registers ----------------------------------------------------------------------------------------------
    @property
    def command_register(self) -> str:
        """The variable that carries commands, and that the watchdog listens to."""
        return f"input_int_register_{self._int}"

    def _input(self, index: int) -> int:
        return self._controller.inputs.ints[self._int + index]

    def _vector(self, index: int = 0, length: int = 6) -> list[float]:
        at = self._double + index
        return self._controller.inputs.doubles[at : at + length]

    def _set(self, index: int, value: int) -> None:
        self._controller.output_ints[self._int + index] = value

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
            self._packets.append(np.array(self._vector()))

    def step(self) -> bool:
        """One pass of the loop. False when the script has ended."""
        packets, self._packets = self._packets, []
        reference = self._controller.reference
        if self._blocked:
            if not reference.at_rest:
                return True
            self._blocked = False
            self._set(0, DONE)
        if self._asynchronous and reference.at_rest:
            self._asynchronous = False
            self._progress(-1)
        command = self._input(0)
        if command == END:
            return False
        if command in REALTIME:
            self._realtime(command, packets)
            self._set(0, READY)
        elif command == 0:
            self._executing = False
            self._set(0, READY)
        elif not self._executing:
            self._executing = True
            self._once(command)
            if not self._blocked and self._controller.program is self:  # a refused move has ended the program: never done
                self._set(0, DONE)
        return True

    def _realtime(self, command: int, packets: list[Array]) -> None:
        if not self._controller.may_move:  # a protective stop in which the program plays on: the arm stands
            return
        if command == SERVO_J:
            time_s, lookahead_s, gain = self._vector(8, 3)
            targets = packets or ([np.array(self._vector())] if self._controller.reference.mode != "servo" else [])
            if all(np.isfinite(target).all() for target in targets) and all(map(math.isfinite, (time_s, lookahead_s, gain))):
                self._controller.reference.follow(
                    targets, time_s, min(max(lookahead_s, LOOKAHEAD_S[0]), LOOKAHEAD_S[1]), min(max(gain, GAIN[0]), GAIN[1])
                )
            else:
                self._controller.protective_stop("servoj with a target that is not a number")
        elif command == SPEED_J:
            qd, acceleration = np.array(self._vector()), self._vector(6, 1)[0]
            if np.isfinite(qd).all() and math.isfinite(acceleration):
                self._controller.reference.speed(qd, acceleration)
            else:
                self._controller.protective_stop("speedj with a target that is not a number")
        elif command == 26:  # getStepTime
            self._controller.output_doubles[self._double] = self._controller.tick_s
        elif command != self._last_refused:
            self._refuse(command)
        self._last_refused = command

    def _once(self, command: int) -> None:
        controller, reference = self._controller, self._controller.reference
        first = self._vector(0, 1)[0]
        match command:
            case 1:  # moveJ
                speed, acceleration = self._vector(6, 2)
                why = controller.unreachable(np.array(self._vector()), speed, acceleration)
                if why:
                    controller.stop_program(f"moveJ: {why}")
                    return
                reference.move(np.array(self._vector()), speed, acceleration)
                self._motion(asynchronous=self._input(1) == 1)
            case 15 | 16:  # speedStop, servoStop; stopl of the latter is a joint deceleration here
                reference.stop(first if math.isfinite(first) else 10.0)
                self._motion(asynchronous=False)
            case 34:  # stopJ
                reference.stop(first if math.isfinite(first) else 2.0)
                self._motion(asynchronous=self._input(1) == 1)
            case 17:  # setPayload
                mass, *com = self._vector(0, 4)
                accepted = math.isfinite(mass) and 0.0 <= mass <= 2.0 * controller.settings.arm.payload_max_kg
                if accepted:
                    controller.declared_payload = (mass, *com)
                self._set(1, int(accepted))
            case 31:
                controller.protective_stop("asked for by the program")
            case 35:  # setWatchdog
                accepted = math.isfinite(first) and first > 0.0
                if accepted:
                    controller.arm_watchdog(self.command_register, first)
                self._set(1, int(accepted))
            case 37:  # isJointsWithinSafetyLimits
                self._set(1, int(not controller.outside_limits(np.array(self._vector()))))
            case 47:  # isSteady
                self._set(1, int(reference.at_rest and bool(np.all(np.abs(controller.measured.qd) < STEADY_RAD_S))))
            case _:
                self._refuse(command)

    def _motion(self, *, asynchronous: bool) -> None:
        if self._asynchronous:
            self._progress(-1)
        self._asynchronous = asynchronous
        if asynchronous:
            self._progress(0)
        else:
            self._blocked = not self._controller.reference.at_rest

    def _refuse(self, command: int) -> None:
        """Visibly: told in the log and in the truth, done with result 0."""
        log.warning("command %d of the control script is not simulated: refused", command)
        self._controller.refused_commands.append(command)
        self._set(1, 0)


class MotionProgram:
    """A script that is one motion: ends when the arm rests."""

    command_register = ""

    def __init__(self, controller: "Controller") -> None:
        self._controller = controller

    def received(self) -> None:
        """Listens to nothing."""

    def step(self) -> bool:
        """False when the motion is over."""
        return not self._controller.reference.at_rest


class SteppedProgram(MotionProgram):
    """Stands for the player of `stepped.py`, which moves the reference itself, so that nobody else starts a program."""

    def step(self) -> bool:
        """Runs until it is stopped."""
        return True
