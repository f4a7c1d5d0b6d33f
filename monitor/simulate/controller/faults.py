"""What each fault of a controller and its sensors does, by its name in `faults.FAULTS`; the other faults are those of the wire."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.simulate.arm.damage import DAMAGES
from monitor.simulate.arm.physics import Arm, Contact
from monitor.simulate.arm.reference import Reference
from monitor.simulate.arm.sensors import SensorFaults
from monitor.simulate.controller.safety import Safety
from monitor.simulate.faults import checked, parsed_version
from monitor.simulate.machine.identity import Identity
from monitor.simulate.machine.journal import CLIENT, SOMEBODY_ELSE, SafetyMessage
from monitor.simulate.machine.machine import Installation, Machine, Measurements
from monitor.simulate.machine.registers import INPUT_TYPES, Registers
from monitor.simulate.machine.state import Clock, Modes, RobotMode, SafetyMode
from monitor.simulate.program.runner import Programs
from monitor.simulate.settings import SimulateSettings

NOW, AFTER_OURS, DURING_UPLOAD = "now", "after_ours", "during_upload"  # when somebody else's program starts
NOBODY = -1  # the connection that owns occupied inputs

Effect = Callable[..., str]  # takes a fault's arguments by name; returns a sentence that says what was done


@dataclass(slots=True, kw_only=True)
class ForeignPlan:
    """One program of somebody else, planned."""

    when: str  # NOW, AFTER_OURS or DURING_UPLOAD
    delay_s: float
    seconds: float
    moves: bool
    due_s: float | None  # on the controller's clock; None until the moment is known


class ForeignPrograms:
    """Starts the planned program of somebody else on one controller."""

    def __init__(self, machine: Machine, programs: Programs) -> None:
        self._machine, self._programs = machine, programs
        self._plan: ForeignPlan | None = None
        self._planned_s = 0.0
        self._held: list[tuple[float, str]] = []  # scripts of clients that the controller has not started yet, with their time

    def plan(self, when: str, *, delay_s: float, seconds: float, moves: bool) -> None:
        """Plan a program that plays for so long. `delay_s` counts from now or from the end of a client's program.

        During an upload the program starts when the client's script arrives, and the script itself is started `delay_s` later.
        """
        self._planned_s = self._machine.clock.now_s
        due_s = self._planned_s + delay_s if when == NOW else None
        self._plan = ForeignPlan(when=when, delay_s=delay_s, seconds=seconds, moves=moves, due_s=due_s)

    def cancel(self) -> None:
        """Forget what is planned."""
        self._plan = None

    def holds(self, script: str) -> bool:
        """Whether a client's script that has just arrived must wait, because somebody else's program starts before it."""
        plan = self._plan
        if plan is None or plan.when != DURING_UPLOAD or not script.startswith("def "):
            return False
        self._start(plan)
        self._held.append((self._machine.clock.now_s + plan.delay_s, script))
        return True

    def step(self) -> list[str]:
        """Start what is due. Returns the scripts of clients that need wait no longer."""
        now_s, plan = self._machine.clock.now_s, self._plan
        if plan is not None:
            if plan.when == AFTER_OURS and plan.due_s is None:
                plan.due_s = self._after_ours(plan.delay_s)
            if plan.due_s is not None and now_s >= plan.due_s:
                self._start(plan)
        if not self._held:
            return []
        due = [script for at_s, script in self._held if now_s >= at_s]
        self._held = [(at_s, script) for at_s, script in self._held if now_s < at_s]
        return due

    def _after_ours(self, delay_s: float) -> float | None:
        logbook = self._machine.journal.logbook
        for run in reversed(logbook.programs):
            if run.boot != logbook.boot:  # its times are of another clock, as are those of every run before it
                return None
            if run.owner == CLIENT and run.ended_s is not None and run.ended_s >= self._planned_s:
                return run.ended_s + delay_s
        return None

    def _start(self, plan: ForeignPlan) -> None:
        self._plan = None
        self._programs.start_foreign(plan.seconds, moves=plan.moves)


class Parts:
    """The parts of one controller, on which faults and scenarios act. `Controller` sets them."""

    settings: SimulateSettings
    clock: Clock
    modes: Modes
    identity: Identity
    registers: Registers
    measurements: Measurements
    installation: Installation
    arm: Arm
    reference: Reference
    machine: Machine
    programs: Programs
    foreign: ForeignPrograms
    safety: Safety
    wire: Mapping[str, Effect]  # the faults of the wire; empty where there is none
    restore: dict[str, Callable[[], object]]  # for each lasting fault, what `clear` does to end it

    def lasts(self, fault: str, end: Callable[[], object]) -> None:
        """Let `clear` end this fault. What was before the first of several stays to be restored."""
        self.restore.setdefault(fault, end)


def inject(name: str, given: dict[str, Any], parts: Parts) -> str:
    """Make one fault happen. Returns a sentence that says what was done.

    Raises BadInput for an unknown name, for wrong arguments, and for a fault of the wire if there is no wire.
    """
    arguments = checked(name, given, joints=parts.settings.arm.joints)
    if name in EFFECTS:
        return EFFECTS[name](parts, **arguments)
    if name not in parts.wire:
        raise BadInput("this fault is one of the wire, and there is none here: run `joint-monitor simulate`")
    return parts.wire[name](**arguments)


# --- people, other machines and mechanics ---------------------------------------------------------------------


def _foreign_program(parts: Parts, when: str, delay: float, seconds: float, moves: str) -> str:
    parts.foreign.plan(when, delay_s=delay, seconds=seconds, moves=moves == "on")
    parts.lasts("foreign_program", parts.foreign.cancel)
    motion = "moves the arm" if moves == "on" else "does not move the arm"
    return f"somebody else's program, which plays for {seconds:g} s and {motion}: {when}, {delay:g} s"


def _teach_button(parts: Parts, state: str) -> str:
    parts.modes.teach_button = state == "on"
    parts.lasts("teach_button", lambda: setattr(parts.modes, "teach_button", False))
    return f"the freedrive button is {'held' if parts.modes.teach_button else 'released'}"


def _speed_slider(parts: Parts, fraction: float) -> str:
    def put(fraction: float) -> None:
        parts.registers.inputs.others.update(speed_slider_mask=1, speed_slider_fraction=fraction)
        parts.reference.speed_slider = parts.registers.speed_fraction

    put(fraction)
    parts.lasts("speed_slider", lambda: put(1.0))
    return f"the speed slider is at {100 * fraction:g} %"


def _tcp_changed(parts: Parts, **pose: float) -> str:
    kinematics = parts.machine.kinematics
    before = kinematics.tool
    kinematics.tool = np.array([pose[name] for name in ("x", "y", "z", "rx", "ry", "rz")])
    parts.lasts("tcp_changed", lambda: setattr(kinematics, "tool", before))
    return f"the tool centre point is at {kinematics.tool.tolist()}"


def _payload_changed(parts: Parts, kg: float, x: float, y: float, z: float) -> str:
    before = parts.installation.installed_payload
    parts.installation.install(payload=(kg, x, y, z))
    parts.lasts("payload_changed", lambda: parts.installation.install(payload=before))
    return f"the controller reckons with {kg:g} kg at {[x, y, z]}; the arm carries what it carried"


def _wrist_turned(parts: Parts, joint: int, turns: float) -> str:
    machine, way = parts.machine, np.zeros(parts.settings.arm.joints)
    way[joint - 1] = 2.0 * np.pi * round(turns)
    if way.any() and not machine.standing:
        raise BadInput("fault wrist_turned: the arm is moving")
    if (outside := machine.limits.outside(parts.measurements.encoder_q + way)) is not None:
        raise BadInput(f"fault wrist_turned: {outside.text}")
    parts.arm.q = parts.arm.q + way
    parts.reference.put(parts.reference.q + way, parts.reference.qd, parts.reference.qdd)
    parts.measurements.read()
    return f"joint {joint} stands at {parts.arm.q[joint - 1]:.3f} rad"


def _reduced(parts: Parts, state: str) -> str:
    modes = parts.modes

    def end() -> None:
        if modes.safety == SafetyMode.REDUCED:
            modes.safety = SafetyMode.NORMAL

    if state == "off":
        end()
    elif modes.safety == SafetyMode.NORMAL:
        modes.safety = SafetyMode.REDUCED
        parts.lasts("reduced", end)
    parts.machine.journal.tell(SafetyMessage, modes.safety)
    return f"the safety mode is {modes.safety.name}"


def _stuck(parts: Parts, joint: int) -> str:
    parts.arm.jam(joint - 1, jammed=True)
    parts.lasts(f"stuck {joint}", lambda: parts.arm.jam(joint - 1, jammed=False))
    return f"joint {joint} is stuck"


def _brake(parts: Parts, joint: int) -> str:
    def put(*, closed: bool) -> None:
        parts.modes.braked = parts.modes.braked | {joint - 1} if closed else parts.modes.braked - {joint - 1}
        parts.arm.jam(joint - 1, jammed=closed)

    put(closed=True)
    parts.lasts(f"brake {joint}", lambda: put(closed=False))
    return f"the brake of joint {joint} is closed"


def _watchdog_dead(parts: Parts) -> str:
    watchdog = parts.machine.watchdog
    watchdog.dead = True
    parts.lasts("watchdog_dead", lambda: setattr(watchdog, "dead", False))
    return "the watchdog is acknowledged and does nothing"


def _never_ready(parts: Parts) -> str:
    parts.registers.never_ready = True
    parts.lasts("never_ready", lambda: setattr(parts.registers, "never_ready", False))
    return "the control program never says that it takes a command"


def _clock_jump(parts: Parts, seconds: float) -> str:
    parts.clock.jump(seconds)
    return f"the published clock has jumped by {seconds:+g} s"


# --- the controller -------------------------------------------------------------------------------------------


def _registers_in_use(parts: Parts) -> str:
    parts.registers.inputs.occupy(INPUT_TYPES, NOBODY)
    return "all inputs that were free belong to a connection that is gone"


def _version(parts: Parts, version: str) -> str:
    parts.identity.reported_version = parsed_version(version)
    return f"reports version {version}"


def _not_found(parts: Parts, names: str) -> str:
    hidden = parts.identity.outputs(names)
    parts.identity.missing_outputs.update(hidden)
    return f"does not know {', '.join(hidden)}"


def _remote(parts: Parts, state: str) -> str:
    parts.identity.remote_control = state == "on"
    return f"remote control is {state}"


def _manual_mode(parts: Parts, state: str) -> str:
    parts.identity.set_manual(state == "on")
    return f"manual mode is {state}"


def _digital_input(parts: Parts, number: float, state: str) -> str:
    bit, registers = 1 << int(number), parts.registers
    registers.digital_inputs = registers.digital_inputs | bit if state == "on" else registers.digital_inputs & ~bit
    return f"digital input {int(number)} is {state}"


def _program_stop(parts: Parts) -> str:
    return "program stopped" if parts.programs.stop("fault: stopped by somebody else", by=SOMEBODY_ELSE) else "no program was running"


def _protective_stop(parts: Parts, runtime: str) -> str:
    parts.safety.protective_stop("fault: protective_stop", runtime=runtime or None)
    return "protective stop"


def _safeguard_stop(parts: Parts, seconds: float) -> str:
    parts.safety.open_safeguard(seconds)
    parts.lasts("safeguard_stop", parts.safety.close_safeguard)
    return "the safeguard is open" + (f" for {seconds:g} s; then the program plays on" if seconds else " until `clear`")


def _emergency_stop(parts: Parts) -> str:
    parts.safety.emergency_stop()
    return "emergency stop"


def _emergency_release(parts: Parts) -> str:
    parts.safety.release_emergency_stop()
    return "emergency stop released, power is off"


# --- the sensors ----------------------------------------------------------------------------------------------


def _temperatures_frozen(parts: Parts) -> str:
    parts.measurements.sensors.faults.frozen_c = parts.measurements.latest.temperature_c.copy()
    return "temperatures stay as they are"


def _temperature_glitch(parts: Parts, joint: int, value: float) -> str:
    parts.measurements.sensors.faults.glitch_c[joint - 1] = value
    return f"joint {joint} says {value:g} °C now and then"


def _current_stuck(parts: Parts, joint: int) -> str:
    value = float(parts.measurements.latest.current[joint - 1])
    parts.measurements.sensors.faults.stuck_a[joint - 1] = value
    return f"joint {joint} goes on telling {value:.3f} A"


def _encoder_offset(parts: Parts, joint: int, value: float) -> str:
    offset = np.zeros(parts.settings.arm.joints)
    offset[joint - 1] = value
    _shift_encoders(parts, offset)
    return f"the encoder of joint {joint} has moved by {value:g} rad"


def _shift_encoders(parts: Parts, offset_rad: np.ndarray) -> None:
    """Shift what the encoders show, and the reference with it: the arm stays, and the controller reports another position."""
    parts.measurements.shift_encoders(offset_rad)
    reference = parts.reference
    reference.put(reference.q + offset_rad, reference.qd, reference.qdd)


def _current_noise(parts: Parts, factor: float) -> str:
    parts.measurements.sensors.set_current_noise(factor)
    return f"currents with {factor:g} times their noise"


def _obstacle(parts: Parts, joint: int, torque: float, stiffness: float, seconds: float) -> str:
    arm = parts.arm
    way = 1.0 if arm.qd[joint - 1] >= 0.0 else -1.0
    arm.contact = Contact(
        joint=joint - 1,
        left_s=seconds or math.inf,
        torque_nm_on_joint=-way * torque,
        stiffness_nm_per_rad=stiffness,
        wall_rad=float(arm.q[joint - 1]),
        side=way,
    )
    return f"joint {joint} is pushed with {torque:g} N·m against its motion; a wall before it has {stiffness:g} N·m/rad"


def _damage(name: str) -> Effect:
    def damage(parts: Parts, joint: int, severity: float) -> str:
        parts.arm.damage_joint(name, joint - 1, severity)
        return f"joint {joint}: {name} of severity {severity:g}; {DAMAGES[name]}"

    return damage


def _clear(parts: Parts) -> str:
    if "clear" in parts.wire:
        parts.wire["clear"]()
    while parts.restore:
        parts.restore.popitem()[1]()
    parts.registers.inputs.release(NOBODY)
    parts.identity.restore()
    parts.registers.digital_inputs = 0
    parts.arm.contact = None
    parts.arm.repair()
    sensors = parts.measurements.sensors
    sensors.set_current_noise(parts.settings.current_noise)
    offset = sensors.faults.encoder_offset_rad
    sensors.faults = SensorFaults(noise_factor=parts.settings.current_noise)
    if offset is not None:
        _shift_encoders(parts, -offset)
    return "every lasting fault is over"


def _recover(parts: Parts) -> str:
    _clear(parts)
    parts.safety.release_emergency_stop()
    parts.safety.close_safeguard()
    parts.programs.stop("somebody recovers the arm", kind="program_stop")
    parts.safety.unlock(after_s=0.0)
    parts.safety.power(RobotMode.RUNNING)
    return "every lasting fault and every stop is over, the power is on"


EFFECTS: dict[str, Effect] = {
    effect.__name__.removeprefix("_"): effect
    for effect in (
        *(_foreign_program, _teach_button, _speed_slider, _tcp_changed, _payload_changed, _wrist_turned, _reduced, _stuck, _brake),
        *(_watchdog_dead, _never_ready, _clock_jump, _registers_in_use, _version, _not_found),
        *(_remote, _manual_mode, _digital_input, _program_stop),
        *(_protective_stop, _safeguard_stop, _emergency_stop, _emergency_release, _temperatures_frozen, _temperature_glitch),
        *(_current_stuck, _encoder_offset, _current_noise, _obstacle, _clear, _recover),
    )
} | {name: _damage(name) for name in DAMAGES}
