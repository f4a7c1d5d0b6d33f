"""The register machine of ur-rtde's control script: it reads commands from input registers and writes replies to output registers.

Input integer 0 carries the command. Output integer 0 is 1 when the script is ready and 2 when a command is done. Output integer 1
carries a result, output integer 2 the progress of an asynchronous motion, and the output doubles carry vectors. A command with
arguments for which a real controller raises a runtime exception ends the program here too.
"""

import logging
import math
from collections.abc import Callable

import numpy as np

from monitor.simulate.arm.kinematics import se3
from monitor.simulate.machine.machine import Machine
from monitor.simulate.machine.moves import Move, StopMotion
from monitor.simulate.machine.state import Runtime
from monitor.simulate.program.interpreter import FUNCTIONS, Pose, Value
from monitor.simulate.program.player import Player, Program, follow, joint_speed, tool_speed
from monitor.simulate.program.queries import DECLARATIONS, UntilContact
from monitor.simulate.program.scripts import ControlScript

log = logging.getLogger(__name__)

READY, DONE = 1, 2
SERVO_J, SERVO_L, SPEED_J, SPEED_L, END = 11, 24, 9, 10, 255
MOVES = frozenset({1, 2, 3, 4, 45})  # these commands wait until the arm may move
REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})  # executed in every control period
JOG_STOP_M_S2 = 1.2  # deceleration of jogStop in ur-rtde's script
NOT_SIMULATED = {  # commands that ur-rtde has and this controller refuses
    6: "forceMode",
    12: "servoC",
    18: "teachMode",
    20: "forceModeSetDamping",
    21: "forceModeSetGainScaling",
    52: "freedriveMode",
    56: "ftRtdeInputEnable",
    57: "enableExternalFtSensor",
    66: "directTorque",
    67: "getMassMatrix",
    68: "getCoriolisAndCentrifugalTorques",
    70: "getJacobian",
    71: "getJacobianTimeDerivative",
}
DECLARED = {17: ("set_payload", 4), 29: ("set_tcp", 6), 59: ("set_gravity", 3), 65: ("set_target_payload", 10)}  # with their figures
ASKED = {  # number of a command → the function of URScript that it asks for, and how many vectors it takes
    25: ("tool_contact", 0),
    26: ("get_steptime", 0),
    27: ("get_actual_joint_positions_history", 0),
    28: ("get_target_waypoint", 0),
    30: ("get_inverse_kin", 2),
    36: ("is_within_safety_limits", 1),
    37: ("is_within_safety_limits", 1),
    38: ("get_joint_torques", 0),
    39: ("pose_trans", 2),
    40: ("get_tcp_offset", 0),
    43: ("get_actual_tcp_pose", 0),
    44: ("get_forward_kin", 2),
    46: ("get_inverse_kin", 1),
    47: ("is_steady", 0),
    54: ("get_freedrive_status", 0),
    58: ("get_actual_tool_flange_pose", 0),
    60: ("get_inverse_kin_has_solution", 1),
    61: ("get_inverse_kin_has_solution", 2),
    63: ("tool_contact", 0),
    64: ("tool_contact", 0),
    69: ("get_target_joint_accelerations", 0),
}
POSITIONS_BEFORE, POSE_WITHIN = 27, 36  # the one takes a whole number, the other a pose
PACKETS_MAX = 16  # servoj targets kept within one control period


class ControlProgram(Program):
    """ur-rtde's control script, running."""

    def __init__(self, script: ControlScript, machine: Machine) -> None:
        self.command_register = f"input_int_register_{script.int_offset}"  # the watchdog listens to this register
        self._machine, self._int_offset, self._double_offset = machine, script.int_offset, script.double_offset
        self._path = script.path
        self._executing = False
        self._blocking: Callable[[], bool] | None = None  # tells whether the motion is over that blocks the script
        self._asynchronous: Callable[[], bool] | None = None  # tells whether the asynchronous motion is over
        self._writes = self._operation = 0
        self._last_refused = 0
        self._packets: list[list[float]] = []  # servoj targets since the last control period
        self._write_progress(-1)
        self._write(0, READY)

    # --- registers ----------------------------------------------------------------------------------------------
    def _integer(self, index: int) -> int:
        """One integer argument; the first is the number of the command."""
        return self._machine.registers.inputs.ints[self._int_offset + index]

    def _vector(self, index: int = 0, length: int = 6) -> list[float]:
        """Consecutive double arguments, from `index` on."""
        at = self._double_offset + index
        return self._machine.registers.inputs.doubles[at : at + length]

    def _write(self, index: int, value: int) -> None:
        if (index, value) == (0, READY) and self._machine.registers.never_ready:
            value = 0
        self._machine.registers.output_ints[self._int_offset + index] = value

    def _answer(self, command: int) -> None:
        """Call the function of URScript that a command stands for, and write its value. Raises ValueError for impossible arguments."""
        name, vectors = ASKED[command]
        arguments: list[Value] = [self._vector(6 * k) for k in range(vectors)]
        if command == POSITIONS_BEFORE:
            arguments = [self._integer(1)]
        elif command == POSE_WITHIN:
            arguments = [Pose(*arguments)]
        value = FUNCTIONS[name](self._machine, *arguments)
        if isinstance(value, int):
            self._write(1, int(value))
            return
        values = value if isinstance(value, list) else [value]
        self._machine.registers.output_doubles[self._double_offset : self._double_offset + len(values)] = map(float, values)

    def _write_progress(self, value: int) -> None:
        """Write output integer 2; −1 means that the motion has ended.

        Bits 0–14 hold the progress, bit 15 is set while the motion runs, bits 16–22 count the writes, bits 24–30 the operations.
        """
        self._writes = (self._writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        running = min(value, 32767) + 32768 if value >= 0 else 0
        self._write(2, self._writes * 65536 + self._operation * 16777216 + running)

    # --- one pass of the loop -----------------------------------------------------------------------------------
    def received(self) -> None:
        """Note that a packet with the command register arrived. Every servoj target counts, not only the last of a control period."""
        if self._integer(0) == SERVO_J and len(self._packets) < PACKETS_MAX:
            self._packets.append(self._vector())

    def step(self) -> bool:
        """Run one pass of the script's loop. Returns False when the script has ended."""
        packets, self._packets = self._packets, []
        if self._blocking is not None:
            if not self._blocking():
                return True
            self._blocking = None
            self._write(0, DONE)
        if self._asynchronous is not None and self._asynchronous():
            self._asynchronous = None
            self._write_progress(-1)
        if self._ended:  # by a step of a path that the arm cannot make
            return True
        command = self._integer(0)
        if command == END:
            return False
        if command in REALTIME:
            self._realtime(command, packets)
            self._write(0, READY)
        elif command == 0:
            self._executing = False
            self._write(0, READY)
        elif not self._executing and (command not in MOVES or self._machine.modes.may_move):
            self._executing = True
            self._once(command)
            if self._blocking is None and not self._ended:  # a command that ends the program is never done
                self._write(0, DONE)
        return True

    @property
    def _ended(self) -> bool:
        return self._machine.modes.runtime == Runtime.STOPPED

    def _raise(self, reason: str) -> None:
        self._machine.supervisor.raise_exception(reason)

    # --- commands -----------------------------------------------------------------------------------------------
    def _realtime(self, command: int, packets: list[list[float]]) -> None:
        if command in ASKED:
            self._answer(command)
        elif not self._machine.modes.may_move:  # in a protective stop the program may play on, but the arm stands
            return
        elif command in (SERVO_J, SERVO_L):
            if not self._servo(command, packets):
                return
        elif command in (SPEED_J, SPEED_L):
            self._speed(command)
        elif command != self._last_refused:
            self._refuse(command)
        self._last_refused = command

    def _servo(self, command: int, packets: list[list[float]]) -> bool:
        """Give the targets of servoj or servol to the reference. Returns False if they lead to a protective stop."""
        machine, reference = self._machine, self._machine.reference
        time_s, lookahead_s, gain = self._vector(8, 3)
        targets = packets or ([self._vector()] if reference.mode != "servo" or command == SERVO_L else [])
        if command == SERVO_L and np.isfinite(targets[-1]).all():  # `follow` refuses others
            found = machine.moves.inverse(np.array(targets[-1]))
            if found is None:
                machine.supervisor.protective_stop("servol: no joint positions for the target")
                return False
            targets = [found.tolist()]
        return follow(machine, targets, time_s, lookahead_s, gain)

    def _speed(self, command: int) -> None:
        """Give the speed of speedj or speedl to the reference."""
        (joint_speed if command == SPEED_J else tool_speed)(self._machine, np.array(self._vector()), self._vector(6, 1)[0])

    def _once(self, command: int) -> None:
        machine, first = self._machine, self._vector(0, 1)[0]
        match command:
            case 1 | 2 | 3 | 4:  # moveJ, moveJ_IK, moveL, moveL_FK
                self._move(command)
            case 15 | 16:  # speedStop, servoStop; the stopl inside servoStop is a joint deceleration here
                straight = command == 15 and machine.reference.mode == "speedl"
                machine.moves.stop(StopMotion(first if math.isfinite(first) else 10.0, straight))
                self._motion(lambda: machine.moves.over, asynchronous=False)
            case 33 | 34:  # stopL, stopJ
                machine.moves.stop(StopMotion(first if math.isfinite(first) else 2.0, straight=command == 33))
                self._motion(lambda: machine.moves.over, asynchronous=self._integer(1) == 1)
            case 45:  # movePath
                self._motion(Player(self._path, machine, self._write_progress).over, asynchronous=self._integer(1) == 1)
            case 7 | 8 | 19 | 53 | 62:  # ends of modes that never began, zeroFtSensor and startContactDetection: there is nothing to do
                pass
            case 41:  # jogStart
                self._jog()
            case 42:  # jogStop
                machine.moves.stop(StopMotion(JOG_STOP_M_S2, straight=True))
                self._motion(lambda: machine.moves.over, asynchronous=False)
            case 51:  # moveUntilContact
                self._motion(UntilContact(machine, np.array(self._vector()), self._vector(12, 1)[0]).over, asynchronous=False)
            case 31:  # triggerProtectiveStop
                machine.supervisor.protective_stop("asked for by the program")
            case 35:  # setWatchdog
                if math.isfinite(first) and first > 0.0:
                    machine.watchdog.watch(self.command_register, first)
                else:
                    self._raise(f"rtde_set_watchdog: {first:g} Hz; expected more than 0")
            case _ if command in DECLARED or command in ASKED:
                try:
                    if command in ASKED:
                        self._answer(command)
                    else:
                        name, figures = DECLARED[command]
                        DECLARATIONS[name](machine, self._vector(0, figures))
                except ValueError as wrong:
                    self._raise(str(wrong))
            case _:
                self._refuse(command)

    def _jog(self) -> None:
        """Move the tool at a speed along the axes of the base, the tool or another frame, until jogStop."""
        machine, figures = self._machine, self._vector(0, 14)
        if not all(map(math.isfinite, figures)):
            self._raise("jogStart: expected finite figures")
            return
        frames = {1: machine.kinematics.at(machine.measurements.latest.q), 2: se3(figures[8:14])}
        rotation = frames[int(figures[6])].rotation if int(figures[6]) in frames else np.eye(3)
        if machine.modes.may_move:
            tool_speed(machine, np.concatenate((rotation @ figures[:3], rotation @ figures[3:6])), figures[7])

    def _move(self, command: int) -> None:
        speed, acceleration = self._vector(6, 2)
        move = Move(tuple(self._vector()), pose=command in (2, 3), straight=command in (3, 4), speed=speed, acceleration=acceleration)
        obstacle = self._machine.moves.start(move)
        if obstacle:
            self._raise(f"{'moveL' if move.straight else 'moveJ'}: {obstacle}")
        else:
            self._motion(lambda: self._machine.moves.over, asynchronous=self._integer(1) == 1)

    def _motion(self, over: Callable[[], bool], *, asynchronous: bool) -> None:
        """Wait for a motion that has started; `over` tells whether it has ended."""
        if self._asynchronous is not None:
            self._write_progress(-1)
        self._asynchronous = over if asynchronous else None
        if asynchronous:
            self._write_progress(0)
        else:
            self._blocking = None if over() else over

    def _refuse(self, command: int) -> None:
        """End the program at a command that is not simulated, and record it: ur-rtde would take an answer for success."""
        log.warning("command %d of the control script is not simulated: refused", command)
        self._machine.journal.refused_commands.append(command)
        self._raise(f"not simulated: {NOT_SIMULATED.get(command, f'command {command}')}")
