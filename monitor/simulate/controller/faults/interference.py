"""Faults that people, other machines and mechanics make: what each of them does."""

from collections.abc import Callable
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.simulate.controller.faults.fault_target import FaultTarget
from monitor.simulate.controller.modes import SafetyMode


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


ACTIONS: dict[str, Callable[[FaultTarget, dict[str, Any]], str]] = {
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
