"""The true state of an arm and its controller. Tests compare with it, and the terminal view shows it."""

from dataclasses import asdict
from typing import Any

from monitor.simulate.controller.controller import Controller


def truth(controller: Controller) -> dict[str, Any]:
    """The true state as JSON values. The robot's own wire publishes only a part of it, with noise."""
    arm, law, modes, journal = controller.arm, controller.arm.law, controller.modes, controller.journal
    program, watchdog = controller.programs.current, controller.machine.watchdog
    return {
        "robot": controller.robot.name,
        "clock_s": controller.clock.now_s,
        "q": arm.q.tolist(),
        "qd": arm.qd.tolist(),
        "torque_nm": arm.torque_nm.tolist(),
        "motor_temperature_c": arm.temperatures.motor_c.tolist(),
        "grease_temperature_c": arm.temperatures.grease_c.tolist(),
        "ambient_c": arm.ambient_c,
        "lived_days": controller.scenario.lived_s / 86_400.0,
        "scenario": controller.scenario.scenario.name,
        "happened": controller.scenario.happened[-50:],
        "joint_serials": controller.identity.joint_serials,
        "mounting_rad": list(arm.mounting.angles_rad),
        "declared_payload_kg": controller.installation.payload[0],
        "wear_coulomb": arm.wear.coulomb.tolist(),
        "wear_viscous": arm.wear.viscous.tolist(),
        "wear_per_revolution": arm.wear.per_revolution.tolist(),
        "revolutions": arm.wear.revolutions.tolist(),
        "run_in_factor": arm.run_in.factor.tolist(),
        "payload_kg": arm.payload_kg,
        "drive_gain_nm_per_a": arm.gain_nm_per_a.tolist(),
        "rotor_kg_m2": arm.rotor_kg_m2.tolist(),
        "friction_law": {name: getattr(law, name).tolist() for name in law.__dataclass_fields__},
        "robot_mode": int(modes.robot),
        "safety_mode": int(modes.safety),
        "runtime_state": int(modes.runtime),
        "reference_mode": controller.reference.mode,
        "standing": controller.machine.standing,
        "program": type(program).__name__ if program else None,
        "popup": modes.popup,
        "scripts_started": journal.scripts_started,
        "stops": [asdict(stop) for stop in journal.stops],
        **journal.logbook.document(),
        "watchdog_trips": journal.watchdog_trips,
        "watchdog_s": None if watchdog.variable is None else watchdog.limit_s,
        "refused_commands": list(journal.refused_commands),
        "refused_scripts": list(journal.refused_scripts),
        "output_integers": controller.registers.output_ints[:24],
        "odd_inputs": controller.registers.odd_inputs,
    }
