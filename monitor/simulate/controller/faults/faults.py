"""Faults of a controller and its sensors: what each of them does."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.simulate.arm.contact import Contact
from monitor.simulate.arm.sensors import SensorFaults
from monitor.simulate.controller.faults import interference
from monitor.simulate.controller.faults.fault_target import FaultTarget
from monitor.simulate.controller.logbook import SOMEBODY_ELSE
from monitor.simulate.controller.registers import INPUT_TYPES
from monitor.simulate.faults import checked, parsed_version

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
    **interference.ACTIONS,
}
