"""When somebody else's program starts: after a time, after the end of a client's program, or while a client uploads its own."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.simulate.arm.physics import Arm, Contact
from monitor.simulate.arm.reference import Reference
from monitor.simulate.arm.sensors import SensorFaults
from monitor.simulate.controller.safety import Safety
from monitor.simulate.faults import FaultyWire, checked, parsed_version
from monitor.simulate.machine.identity import Identity
from monitor.simulate.machine.journal import CLIENT, SOMEBODY_ELSE
from monitor.simulate.machine.machine import Machine, Measurements
from monitor.simulate.machine.registers import INPUT_TYPES, Registers
from monitor.simulate.machine.state import SafetyMode
from monitor.simulate.program.runner import Programs
from monitor.simulate.settings import SimulateSettings

NOW, AFTER_OURS, DURING_UPLOAD = "now", "after_ours", "during_upload"
MOMENTS = (NOW, AFTER_OURS, DURING_UPLOAD)


@dataclass(slots=True, kw_only=True)
class ForeignPlan:
    """One program of somebody else, planned."""

    when: str  # one of MOMENTS
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


# --- What faults act on ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultTarget:
    """Parts of a controller, and its wire if it has one."""

    settings: SimulateSettings
    identity: Identity
    registers: Registers
    measurements: Measurements
    arm: Arm
    reference: Reference
    machine: Machine
    programs: Programs
    foreign: ForeignPrograms
    safety: Safety
    wire: FaultyWire | None
    restore: dict[str, Callable[[], object]] = field(default_factory=dict)  # for each lasting fault, what `clear` does to end it

    def lasts(self, fault: str, end: Callable[[], object]) -> None:
        """Let `clear` end this fault. What was before the first of several stays to be restored."""
        self.restore.setdefault(fault, end)

    def clear(self) -> None:
        """End the lasting faults that were registered."""
        while self.restore:
            self.restore.popitem()[1]()


# --- Faults that people, other machines and mechanics make: what each of them does ----------------------


def _foreign_program(target: FaultTarget, arguments: dict[str, Any]) -> str:
    when, delay_s, seconds, moves = arguments["when"], arguments["delay"], arguments["seconds"], arguments["moves"] == "on"
    target.foreign.plan(when, delay_s=delay_s, seconds=seconds, moves=moves)
    target.lasts("foreign_program", target.foreign.cancel)
    motion = "moves the arm" if moves else "does not move the arm"
    return f"somebody else's program, which plays for {seconds:g} s and {motion}: {when}, {delay_s:g} s"


def _teach_button(target: FaultTarget, arguments: dict[str, Any]) -> str:
    modes = target.machine.modes
    modes.teach_button = arguments["state"] == "on"
    target.lasts("teach_button", modes.release_teach_button)
    return f"the freedrive button is {'held' if modes.teach_button else 'released'}"


def _speed_slider(target: FaultTarget, arguments: dict[str, Any]) -> str:
    _set_slider(target, arguments["fraction"])
    target.lasts("speed_slider", lambda: _set_slider(target, 1.0))
    return f"the speed slider is at {100 * arguments['fraction']:g} %"


def _set_slider(target: FaultTarget, fraction: float) -> None:
    target.registers.inputs.others.update(speed_slider_mask=1, speed_slider_fraction=fraction)
    target.reference.speed_slider = target.registers.speed_fraction


def _tcp_changed(target: FaultTarget, arguments: dict[str, Any]) -> str:
    kinematics = target.machine.kinematics
    before = kinematics.tool
    kinematics.tool = np.array([arguments[name] for name in ("x", "y", "z", "rx", "ry", "rz")])
    target.lasts("tcp_changed", lambda: setattr(kinematics, "tool", before))
    return f"the tool centre point is at {kinematics.tool.tolist()}"


def _payload_changed(target: FaultTarget, arguments: dict[str, Any]) -> str:
    installation = target.machine.installation
    before, payload = installation.installed_payload, tuple(arguments[name] for name in ("kg", "x", "y", "z"))
    installation.install(payload=payload)
    target.lasts("payload_changed", lambda: installation.install(payload=before))
    return f"the controller reckons with {payload[0]:g} kg at {list(payload[1:])}; the arm carries what it carried"


def _wrist_turned(target: FaultTarget, arguments: dict[str, Any]) -> str:
    joint, machine = arguments["joint"] - 1, target.machine
    way = np.zeros(target.settings.arm.joints)
    way[joint] = 2.0 * np.pi * round(arguments["turns"])
    obstacle = "the arm is moving" if way.any() and not machine.standing else machine.limits.outside(target.measurements.encoder_q + way)
    if obstacle:
        raise BadInput(f"fault wrist_turned: {obstacle}")
    target.arm.q = target.arm.q + way
    target.reference.put(target.reference.q + way, target.reference.qd, target.reference.qdd)
    target.measurements.read()
    return f"joint {joint + 1} stands at {target.arm.q[joint]:.3f} rad"


def _reduced(target: FaultTarget, arguments: dict[str, Any]) -> str:
    modes, on = target.machine.modes, arguments["state"] == "on"
    if on and modes.safety == SafetyMode.NORMAL:
        modes.safety = SafetyMode.REDUCED
        target.lasts("reduced", modes.end_reduced)
    elif not on:
        modes.end_reduced()
    target.machine.journal.safety_message(modes.safety)
    return f"the safety mode is {modes.safety.name}"


def _stuck(target: FaultTarget, arguments: dict[str, Any]) -> str:
    joint = arguments["joint"] - 1
    target.arm.jam(joint, jammed=True)
    target.lasts(f"stuck {joint}", lambda: target.arm.jam(joint, jammed=False))
    return f"joint {joint + 1} is stuck"


def _brake(target: FaultTarget, arguments: dict[str, Any]) -> str:
    joint, modes = arguments["joint"] - 1, target.machine.modes
    modes.braked |= {joint}
    target.arm.jam(joint, jammed=True)

    def release() -> None:
        modes.braked -= {joint}
        target.arm.jam(joint, jammed=False)

    target.lasts(f"brake {joint}", release)
    return f"the brake of joint {joint + 1} is closed"


def _watchdog_dead(target: FaultTarget, _: dict[str, Any]) -> str:
    watchdog = target.machine.watchdog
    watchdog.dead = True
    target.lasts("watchdog_dead", watchdog.revive)
    return "the watchdog is acknowledged and does nothing"


def _clock_jump(target: FaultTarget, arguments: dict[str, Any]) -> str:
    target.machine.clock.jump(arguments["seconds"])
    return f"the published clock has jumped by {arguments['seconds']:+g} s"


INTERFERENCE: dict[str, Callable[[FaultTarget, dict[str, Any]], str]] = {
    "foreign_program": _foreign_program,
    "teach_button": _teach_button,
    "speed_slider": _speed_slider,
    "tcp_changed": _tcp_changed,
    "payload_changed": _payload_changed,
    "wrist_turned": _wrist_turned,
    "reduced": _reduced,
    "stuck": _stuck,
    "brake": _brake,
    "watchdog_dead": _watchdog_dead,
    "clock_jump": _clock_jump,
}


# --- Faults of a controller and its sensors: what each of them does -------------------------------------

NOBODY = -1  # the connection that owns occupied inputs


def inject(name: str, given: dict[str, Any], target: FaultTarget) -> str:
    """Make one fault happen. Returns a sentence that says what was done.

    Raises BadInput for an unknown name, for wrong arguments, and for a fault of the wire if there is no wire.
    """
    arguments = checked(name, given, joints=target.settings.arm.joints)
    if name in ACTIONS:
        return ACTIONS[name](target, arguments)
    if target.wire is None:
        raise BadInput("this fault is one of the wire, and there is none here: run `joint-monitor simulate`")
    return target.wire.inject(name, arguments)


# --- the controller -------------------------------------------------------------------------------------------


def _registers_in_use(target: FaultTarget, _: dict[str, Any]) -> str:
    target.registers.inputs.occupy(INPUT_TYPES, NOBODY)
    return "all inputs that were free belong to a connection that is gone"


def _version(target: FaultTarget, arguments: dict[str, Any]) -> str:
    target.identity.report_version(parsed_version(arguments["version"]))
    return f"reports version {arguments['version']}"


def _not_found(target: FaultTarget, arguments: dict[str, Any]) -> str:
    names = target.identity.outputs(arguments["names"])
    target.identity.hide_outputs(names)
    return f"does not know {', '.join(names)}"


def _remote(target: FaultTarget, arguments: dict[str, Any]) -> str:
    target.identity.set_remote_control(arguments["state"] == "on")
    return f"remote control is {arguments['state']}"


def _manual_mode(target: FaultTarget, arguments: dict[str, Any]) -> str:
    target.identity.set_manual(arguments["state"] == "on")
    return f"manual mode is {arguments['state']}"


def _digital_input(target: FaultTarget, arguments: dict[str, Any]) -> str:
    bit = 1 << int(arguments["number"])
    registers = target.registers
    registers.digital_inputs = registers.digital_inputs | bit if arguments["state"] == "on" else registers.digital_inputs & ~bit
    return f"digital input {int(arguments['number'])} is {arguments['state']}"


def _program_stop(target: FaultTarget, _: dict[str, Any]) -> str:
    return "program stopped" if target.programs.stop("fault: stopped by somebody else", by=SOMEBODY_ELSE) else "no program was running"


def _protective_stop(target: FaultTarget, arguments: dict[str, Any]) -> str:
    target.safety.protective_stop("fault: protective_stop", runtime=arguments["runtime"] or None)
    return "protective stop"


def _safeguard_stop(target: FaultTarget, arguments: dict[str, Any]) -> str:
    seconds = arguments["seconds"]
    target.safety.open_safeguard(seconds)
    target.lasts("safeguard_stop", target.safety.close_safeguard)
    return "the safeguard is open" + (f" for {seconds:g} s; then the program plays on" if seconds else " until `clear`")


def _emergency_stop(target: FaultTarget, _: dict[str, Any]) -> str:
    target.safety.emergency_stop()
    return "emergency stop"


def _emergency_release(target: FaultTarget, _: dict[str, Any]) -> str:
    target.safety.release_emergency_stop()
    return "emergency stop released, power is off"


# --- the sensors ----------------------------------------------------------------------------------------------


def _temperatures_frozen(target: FaultTarget, _: dict[str, Any]) -> str:
    target.measurements.sensors.faults.frozen_c = target.measurements.latest.temperature_c.copy()
    return "temperatures stay as they are"


def _temperature_glitch(target: FaultTarget, arguments: dict[str, Any]) -> str:
    target.measurements.sensors.faults.glitch_c[arguments["joint"] - 1] = arguments["value"]
    return f"joint {arguments['joint']} says {arguments['value']:g} °C now and then"


def _current_stuck(target: FaultTarget, arguments: dict[str, Any]) -> str:
    joint = arguments["joint"] - 1
    value = float(target.measurements.latest.current[joint])
    target.measurements.sensors.faults.stuck_a[joint] = value
    return f"joint {arguments['joint']} goes on telling {value:.3f} A"


def _encoder_offset(target: FaultTarget, arguments: dict[str, Any]) -> str:
    offset = np.zeros(target.settings.arm.joints)
    offset[arguments["joint"] - 1] = arguments["value"]
    _shift_encoders(target, offset)
    return f"the encoder of joint {arguments['joint']} has moved by {arguments['value']:g} rad"


def _shift_encoders(target: FaultTarget, offset_rad: np.ndarray) -> None:
    """Shift what the encoders show, and the reference with it: the arm stays, and the controller reports another position."""
    target.measurements.shift_encoders(offset_rad)
    reference = target.reference
    reference.put(reference.q + offset_rad, reference.qd, reference.qdd)


def _current_noise(target: FaultTarget, arguments: dict[str, Any]) -> str:
    target.measurements.sensors.set_current_noise(arguments["factor"])
    return f"currents with {arguments['factor']:g} times their noise"


def _obstacle(target: FaultTarget, arguments: dict[str, Any]) -> str:
    joint, torque_nm, stiffness = arguments["joint"] - 1, arguments["torque"], arguments["stiffness"]
    arm = target.arm
    way = 1.0 if arm.qd[joint] >= 0.0 else -1.0
    arm.contact = Contact(
        joint=joint,
        left_s=arguments["seconds"] or math.inf,
        torque_nm_on_joint=-way * torque_nm,
        stiffness_nm_per_rad=stiffness,
        wall_rad=float(arm.q[joint]),
        side=way,
    )
    return f"joint {joint + 1} is pushed with {torque_nm:g} N·m against its motion; a wall before it has {stiffness:g} N·m/rad"


def _clear(target: FaultTarget, _: dict[str, Any]) -> str:
    if target.wire is not None:
        target.wire.clear()
    target.clear()
    target.registers.inputs.release(NOBODY)
    target.identity.restore()
    target.registers.digital_inputs = 0
    target.arm.contact = None
    measurements = target.measurements
    measurements.sensors.set_current_noise(target.settings.current_noise)
    offset = measurements.sensors.faults.encoder_offset_rad
    measurements.sensors.faults = SensorFaults(noise_factor=target.settings.current_noise)
    if offset is not None:
        _shift_encoders(target, -offset)
    return "every lasting fault is over"


ACTIONS: dict[str, Callable[[FaultTarget, dict[str, Any]], str]] = {  # the other faults are those of the wire
    "registers_in_use": _registers_in_use,
    "version": _version,
    "not_found": _not_found,
    "remote": _remote,
    "manual_mode": _manual_mode,
    "digital_input": _digital_input,
    "program_stop": _program_stop,
    "protective_stop": _protective_stop,
    "safeguard_stop": _safeguard_stop,
    "emergency_stop": _emergency_stop,
    "emergency_release": _emergency_release,
    "temperatures_frozen": _temperatures_frozen,
    "temperature_glitch": _temperature_glitch,
    "current_stuck": _current_stuck,
    "encoder_offset": _encoder_offset,
    "current_noise": _current_noise,
    "obstacle": _obstacle,
    "clear": _clear,
    **INTERFERENCE,
}
