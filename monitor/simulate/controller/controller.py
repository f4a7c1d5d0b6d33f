"""Controller: modes, safety, life of programs and the clock of one simulated arm; no sockets, no wall clock.

`step` is one control tick: programs, reference, servo and physics, sensors, supervision, in this order.
"""

import logging
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm.friction import FrictionLaw
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.limits import Limits
from monitor.simulate.arm.physics import Arm, Target, arm_model
from monitor.simulate.arm.reference import Reference
from monitor.simulate.arm.sensors import Sensors
from monitor.simulate.arm.thermal import Temperatures
from monitor.simulate.controller.modes import RobotMode, Runtime, SafetyMode, Stop
from monitor.simulate.controller.moves import PROGRAM_STOP_RAD_S2, Moves
from monitor.simulate.controller.program.control import ControlProgram, SteppedProgram, StepsProgram
from monitor.simulate.controller.program.scripts import ControlScript, Immediate, Refused, Steps, parse
from monitor.simulate.controller.published import known
from monitor.simulate.controller.registers import REGISTERS, Inputs, Outputs, Recipe
from monitor.simulate.controller.scenario_player import Life
from monitor.simulate.controller.truth import truth
from monitor.simulate.faults import Place, outputs_of
from monitor.simulate.scenario import Scenario
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire import primary, realtime
from monitor.simulate.wire.packing import Variable
from monitor.simulate.wire.variables import Moments, output_variables

log = logging.getLogger(__name__)

SUBSTEP_S = 0.002  # servo and integration; the e-Series' own tick
PROTECTIVE_STOP_RAD_S2 = 25.0
UNLOCK_AFTER_S = 5.0
STANDING_RAD_S = 0.01  # slower is the servo's settling, by microradians
LOG_LENGTH = 200
LIFE_S = 1.0  # how often the room and the scenario's events are looked at
PROGRAM_NAME = "rtde_control"
HISTORY_TICKS = 1024  # measured positions kept for get_actual_joint_positions_history


class Controller:
    """One simulated controller with its arm."""

    def __init__(self, settings: SimulateSettings, *, before: "Controller | None" = None, law: FrictionLaw | None = None) -> None:
        """`before`: the controller that was killed; its arm, with heat, wear and all, and its life go on. `law`: None for the usual."""
        robot = settings.arm
        self.settings, self.robot, self.tick_s = settings, robot, settings.tick_s
        self._substeps = max(1, round(self.tick_s / SUBSTEP_S))
        self.limits = Limits(robot, self.tick_s)
        self.arm = Arm(
            robot,
            q=np.array(settings.home_rad),
            ambient_c=settings.ambient_c,
            mounting=settings.mounting,
            payload_kg=settings.payload_kg,
            payload_com_m=settings.payload_com_m,
            law=law,
            wear_per_revolution=None if settings.wear_per_revolution is None else np.array(settings.wear_per_revolution),
        )
        if settings.initial_temperature_c is not None:
            start = np.array(settings.initial_temperature_c)
            self.arm.set_temperatures(Temperatures(start, start.copy()))
        if before is not None:
            self.arm = before.arm
            self.arm.brake()
            self.arm.powered = False
        self.kinematics = Kinematics(robot)
        self.history: deque[Array] = deque([self.arm.q], maxlen=HISTORY_TICKS)
        self.reference = Reference(robot, self.arm.q, self.tick_s)
        self.moves = Moves(self)
        self.sensors = Sensors(robot, settings.seed, self.tick_s)
        self.sensors.louder(settings.current_noise)
        self.measured = self.sensors.read(self.arm)
        self.inputs = Inputs(self.knows)
        self.output_ints, self.output_doubles = [0] * REGISTERS, [0.0] * REGISTERS
        self.installed_payload: tuple[float, ...] = (settings.payload_kg, *settings.payload_com_m)  # what a restart comes back to
        self.installed_gravity: Array = settings.mounting.gravity_in_base
        self.declared_payload: tuple[float, ...] = self.installed_payload
        self.declared_inertia: tuple[float, ...] = (0.0,) * 6  # told on, not reckoned with
        self.declared_gravity = self.installed_gravity
        self.moments = Moments(self.arm.believed)
        self.digital_inputs = 0  # bits 0–7 standard, 8–15 configurable, 16–17 tool
        self._offset: Array = np.zeros(robot.joints)  # where the encoders' zeros have gone
        self._shifted = False
        self.ticks = 0
        self._leapt_s = 0.0  # by `live`
        self.robot_mode, self.safety_mode, self.runtime = RobotMode.RUNNING, SafetyMode.NORMAL, Runtime.STOPPED
        self.program: ControlProgram | StepsProgram | SteppedProgram | None = None
        self._watched: str | None = None
        self._watchdog_s, self._fed_at_s = math.inf, 0.0
        self.stops: deque[Stop] = deque(maxlen=LOG_LENGTH)
        self.refused_commands: deque[int] = deque(maxlen=LOG_LENGTH)
        self.refused_scripts: deque[str] = deque(maxlen=LOG_LENGTH)
        self.watchdog_trips = self.odd_inputs = self.scripts_started = 0
        self._protected_at_s = -math.inf
        self._standing: list[Stop] = []  # stops whose standstill is still to come
        self.life = Life(settings.scenario or Scenario())
        self._life_every = max(1, round(LIFE_S / self.tick_s))
        self._life_began_s = 0.0
        self.place: Callable[[], Place] | None = None  # where a scenario's faults happen, once there is a wire
        self.joint_serials = [f"{settings.serial}-{i + 1}" for i in range(robot.joints)]
        self.messages: deque[bytes] = deque(maxlen=LOG_LENGTH)  # for the primary port
        self.reported_version, self.remote_control = settings.polyscope, settings.remote_control
        self.user_role, self.operational_mode = "PROGRAMMER", "NONE"  # as the dashboard was told
        self.missing: set[str] = set()  # outputs that it has forgotten, on command
        self.outputs = Outputs()
        if before is not None:
            self.life, self._life_began_s, self.joint_serials = before.life, before.life.lived_s, before.joint_serials
            self.sensors.faults, self.digital_inputs = before.sensors.faults, before.digital_inputs
            self.installed_payload, self.installed_gravity = before.installed_payload, before.installed_gravity
            self._offset, self._shifted = before._offset, before._shifted
            self.reference.reset(self.arm.q + self._offset)
            self.robot_mode = RobotMode.POWER_OFF
            self.declare(payload=self.installed_payload, gravity=self.installed_gravity)
        else:
            self.life.pass_to(0.0, self)
            if settings.scenario is not None and settings.scenario.room is not None:
                self.arm.set_temperatures(self.arm.thermal.idle(self.arm.ambient_c))
        self.variables: dict[str, Variable] = output_variables(self)
        self.realtime = realtime.packing(self)
        for event in self.life.scenario.events:  # now rather than on its day
            if event.arguments.get("fault") == "not_found":
                outputs_of(self, event.arguments["with"]["names"])

    def knows(self, name: str) -> bool:
        """Whether this version has a variable of this name, if any has."""
        return known(name, self.settings.polyscope)

    @property
    def clock_s(self) -> float:
        """Uptime of the controller: RTDE's timestamp."""
        return self.ticks * self.tick_s + self._leapt_s

    @property
    def lived_s(self) -> float:
        """By the arm, since its scenario began; a controller may have been killed meanwhile."""
        return self._life_began_s + self.clock_s

    # --- one tick -----------------------------------------------------------------------------------------------
    def step(self) -> None:
        """Advance by one control period."""
        self.ticks += 1
        if self.ticks % self._life_every == 0 or self.ticks == 1:
            self.life.pass_to(self.lived_s, self)
        if self._watched is not None and self.clock_s - self._fed_at_s > self._watchdog_s:
            self.watchdog_trips += 1
            self.stop_program(f"{self._watched} was not received for {self._watchdog_s:.3g} s", kind="watchdog")
        if self.program is not None and self.runtime == Runtime.PLAYING and not self.program.step():
            self.stop_program("the program ended", kind="program_end")
        arm = self.arm
        reference = self.reference
        held = self.robot_mode != RobotMode.RUNNING  # by the brakes, or by friction
        held = held or (reference.at_rest and arm.stand(self.tick_s, self._seen(reference.step(self.tick_s))))
        if not held:
            h = self.tick_s / self._substeps
            targets = reference.steps(h, self._substeps)
            if not math.isfinite(sum(reference.q.tolist())):  # whatever has led to it: an arm that is nowhere never comes back
                reference.reset(self.seen_q)
                self.protective_stop("the motion that was asked for is not a number")
                targets = reference.steps(h, self._substeps)
            for target in targets:
                arm.step(h, self._seen(target))
        arm.settle(self.tick_s)
        self.measured = self.sensors.read(arm)
        self.history.append(self.measured.q)
        self._supervise()

    def _supervise(self) -> None:
        if self.robot_mode == RobotMode.RUNNING and self.safety_mode == SafetyMode.NORMAL:
            why = self.limits.broken(self.reference.q, self.seen_q, self.arm.torque_nm)
            if why:
                self.protective_stop(why)
        if self._standing and self.standing:
            for stop in self._standing:
                stop.stood_at_s = self.clock_s
            self._standing = []
            if self.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP:
                self._power_off()

    # --- programs -----------------------------------------------------------------------------------------------
    def write_inputs(self, written: Recipe, values: Sequence[float]) -> None:
        """A packet of inputs has arrived."""
        self.inputs.write(written, values)
        if self.inputs.changed:
            self.inputs.changed = False
            self.outputs.take(self.inputs.others)
            self.reference.pace = self.speed_fraction
        if self._watched in written.names:
            self._fed_at_s = self.clock_s
        if self.program is not None and self.program.command_register in written.names:
            self.program.received()

    def run_script(self, text: str) -> None:
        """A script has arrived on one of the ports."""
        script = parse(text)
        if isinstance(script, Immediate):
            if "unlock" in script.line:
                self.unlock()
            else:
                self.stop_program(f"script: {script.line}")
            return
        why = script.reason if isinstance(script, Refused) else self._not_ready()
        if why:
            log.warning("script refused: %s", why)
            self.refused_scripts.append(why)
            return
        if isinstance(script, Steps) and script.beside:
            StepsProgram(script, self).step()
            return
        self.stop_program("replaced by another script")
        self.scripts_started += 1
        match script:
            case ControlScript():
                self.program = ControlProgram(script, self)
            case Steps():
                self.program = StepsProgram(script, self)
        self.runtime = Runtime.PLAYING
        self.messages.append(primary.key(self, "PROGRAM_XXX_STARTED", PROGRAM_NAME))

    def declare(self, *, payload: tuple[float, ...] | None = None, gravity: Array | None = None) -> None:
        """What a program tells the controller of payload and mounting: it reckons with that, whatever the arm really carries."""
        self.declared_payload = payload or self.declared_payload
        self.declared_gravity = self.declared_gravity if gravity is None else gravity
        arm = self.arm
        same_payload = self.declared_payload == (arm.payload_kg, *arm.payload_com_m)
        if same_payload and np.array_equal(self.declared_gravity, arm.model.gravity.linear):
            model = arm.model
        else:
            model = arm_model(self.robot, arm.mounting, self.declared_payload[0], self.declared_payload[1:])
            model.gravity.linear = self.declared_gravity
        arm.believe(model)
        self.moments = Moments(model)

    def begin_stepped(self) -> str:
        """Take the arm for a stepped replay; says why not, or nothing."""
        why = self._not_ready() or ("a program is running" if self.program is not None else "")
        if not why:
            self.program, self.runtime = SteppedProgram(), Runtime.PLAYING
        return why

    def stop_program(self, reason: str, *, kind: str = "program_stop") -> bool:
        """End the program, if there is one; the arm decelerates to standstill. False if there was none."""
        if self.program is None:
            return False
        self._note(kind, reason)
        raised = reason.startswith("runtime exception")
        self.messages.append(primary.exception(self, reason) if raised else primary.key(self, "PROGRAM_XXX_STOPPED", PROGRAM_NAME))
        self.program, self.runtime = None, Runtime.STOPPED
        self._watched, self._watchdog_s = None, math.inf
        self.moves.interrupted = None
        if self.reference.mode != "stop" or self.reference.queued:
            self.reference.stop(PROGRAM_STOP_RAD_S2)
        return True

    def arm_watchdog(self, variable: str, min_frequency_hz: float) -> None:
        """Stop the program when this input has not been received for 1/f s."""
        self._watched, self._watchdog_s, self._fed_at_s = variable, 1.0 / min_frequency_hz, self.clock_s

    def pause(self) -> bool:
        """Pause a playing program: the arm stops, the program waits."""
        if self.runtime != Runtime.PLAYING:
            return False
        self.runtime = Runtime.PAUSED
        self.moves.interrupt()
        self.reference.stop(PROGRAM_STOP_RAD_S2)
        return True

    def play(self) -> bool:
        """Resume a paused program."""
        if self.runtime != Runtime.PAUSED or self._not_ready():
            return False
        self.runtime, self._fed_at_s = Runtime.PLAYING, self.clock_s
        self.moves.resume()
        return True

    def _not_ready(self) -> str:
        if self.safety_mode != SafetyMode.NORMAL:
            return f"safety mode is {self.safety_mode.name}"
        return "" if self.robot_mode == RobotMode.RUNNING else f"robot mode is {self.robot_mode.name}"

    @property
    def may_move(self) -> bool:
        """Drives on and no safety stop."""
        return not self._not_ready()

    # --- safety -------------------------------------------------------------------------------------------------
    def protective_stop(self, reason: str, *, runtime: str | None = None) -> None:
        """Halt the arm; the program pauses, stops or plays on, as `runtime` says or else the settings."""
        if self.safety_mode != SafetyMode.NORMAL:
            return
        self.safety_mode, self._protected_at_s = SafetyMode.PROTECTIVE_STOP, self.clock_s
        self._note("protective_stop", reason)
        self.messages.extend((primary.safety(self), primary.error(self, reason)))
        if self.program is not None:
            variant = runtime or self.settings.protective_runtime
            if variant == "stopped":
                self.stop_program(reason, kind="protective_stop")
            else:
                self.moves.interrupt()
                if variant == "paused":
                    self.runtime = Runtime.PAUSED
        self.reference.stop(PROTECTIVE_STOP_RAD_S2)

    def unlock(self) -> bool:
        """End a protective stop, 5 s after it began at the earliest."""
        if self.safety_mode != SafetyMode.PROTECTIVE_STOP or self.clock_s - self._protected_at_s < UNLOCK_AFTER_S:
            return False
        self.safety_mode = SafetyMode.NORMAL
        self.limits.forget(self.seen_q)
        self.reference.reset(self.arm.q + self._offset)
        if self.runtime == Runtime.PLAYING:
            self.moves.resume()
        return True

    def emergency_stop(self) -> None:
        """Halt the arm, then drives off."""
        if self.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP:
            return
        self.stop_program("emergency stop", kind="emergency_stop")
        self._note("emergency_stop", "the button was pressed")
        self.safety_mode = SafetyMode.ROBOT_EMERGENCY_STOP
        self.messages.append(primary.safety(self))
        self.reference.stop(PROTECTIVE_STOP_RAD_S2)

    def release_emergency_stop(self) -> None:
        """The button is pulled out again; power stays off."""
        if self.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP:
            self._power_off()
            self.safety_mode = SafetyMode.NORMAL

    def power(self, mode: RobotMode) -> bool:
        """Dashboard's power on (IDLE), brake release (RUNNING), power off."""
        if mode == RobotMode.POWER_OFF:
            self.stop_program("power off")
            self._power_off()
        elif self.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP:
            return False
        elif mode == RobotMode.RUNNING:
            if self.robot_mode == RobotMode.POWER_OFF:
                return False
            if self.robot_mode == RobotMode.RUNNING:
                return True  # nothing to release: whatever moves goes on
            self.reference.reset(self.arm.q + self._offset)
            self.robot_mode = RobotMode.RUNNING
        elif self.robot_mode == RobotMode.POWER_OFF:
            self.robot_mode = RobotMode.IDLE
            self.arm.powered = True
        return True

    def _power_off(self) -> None:
        self.arm.brake()
        self.arm.powered = False
        self.reference.reset(self.arm.q + self._offset)
        self.robot_mode = RobotMode.POWER_OFF

    def _note(self, kind: str, reason: str) -> None:
        log.info("stop kind=%s at=%.3f reason=%s", kind, self.clock_s, reason)
        stop = Stop(self.clock_s, kind, reason)
        self.stops.append(stop)
        self._standing = [*self._standing[-8:], stop]

    # --- scenario -----------------------------------------------------------------------------------------------
    def live(self, hours: float, ambient_c: float | None = None, duty: float | None = None) -> str:
        """Let hours of the arm's life pass at once; says why not, or nothing. What is not given is the scenario's."""
        if self.program is not None:
            return "a program is running"
        for slice_s in self.life.leap(self, 3600.0 * hours, ambient_c, duty):
            self._leapt_s += slice_s
        self.measured = self.sensors.read(self.arm)
        return ""

    def shift_encoders(self, offset_rad: Array) -> None:
        """From now on the encoders show (J,) more than they did; the arm stays where it is, the controller thinks it elsewhere."""
        self._offset = self._offset + offset_rad
        self._shifted = bool(self._offset.any())
        self.sensors.faults.offset_rad = self._offset if self._shifted else None
        self.reference.put(self.reference.q + offset_rad, self.reference.qd, self.reference.qdd)

    def _seen(self, target: Target) -> Target:
        """Where the servo really drives to: what the encoders make of the reference."""
        return target._replace(q=target.q - self._offset) if self._shifted else target

    @property
    def seen_q(self) -> Array:
        """(J,) where the encoders show the arm, noise aside."""
        return self.arm.q + self._offset if self._shifted else self.arm.q

    @property
    def deviation_ratio(self) -> float:
        """Following error as a share of the one that protects the arm."""
        return self.limits.deviation_ratio(self.reference.q, self.seen_q)

    @property
    def speed_fraction(self) -> float:
        """What the speed slider is set to."""
        others = self.inputs.others
        fraction = others.get("speed_slider_fraction", 1.0) if others.get("speed_slider_mask") else 1.0
        return min(max(float(fraction), 0.0), 1.0) if isinstance(fraction, (int, float)) and math.isfinite(fraction) else 1.0

    @property
    def standing(self) -> bool:
        """Nothing is asked for, and the arm has come to rest."""
        return self.reference.at_rest and not np.any(np.abs(self.arm.qd) > STANDING_RAD_S)

    @property
    def watchdog_s(self) -> float | None:
        """How long the watched input may be silent; None where none is watched."""
        return None if self._watched is None else self._watchdog_s

    def truth(self) -> dict[str, Any]:
        """What tests compare with: nothing of it is on the robot's own wire."""
        return truth(self)
