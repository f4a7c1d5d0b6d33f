"""The truth about an arm and its controller: what tests compare with, and the terminal view shows."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller


def truth(c: "Controller") -> dict[str, Any]:
    """Nothing of it is on the robot's own wire, but where that tells the same."""
    arm, law = c.arm, c.arm.law
    return {
        "robot": c.robot.name,
        "clock_s": c.clock_s,
        "q": arm.q.tolist(),
        "qd": arm.qd.tolist(),
        "torque_nm": arm.torque_nm.tolist(),
        "motor_temperature_c": arm.temperatures.motor_c.tolist(),
        "grease_temperature_c": arm.temperatures.grease_c.tolist(),
        "ambient_c": arm.ambient_c,
        "lived_days": c.life.lived_s / 86_400.0,
        "scenario": c.life.scenario.name,
        "happened": c.life.happened[-50:],
        "joint_serials": c.joint_serials,
        "mounting_rad": list(arm.mounting.angles_rad),
        "declared_payload_kg": c.declared_payload[0],
        "wear_coulomb": arm.wear.coulomb.tolist(),
        "wear_viscous": arm.wear.viscous.tolist(),
        "wear_per_revolution": arm.wear.per_revolution.tolist(),
        "revolutions": arm.wear.revolutions.tolist(),
        "payload_kg": arm.payload_kg,
        "drive_gain_nm_per_a": arm.gain_nm_per_a.tolist(),
        "rotor_kg_m2": arm.rotor_kg_m2.tolist(),
        "friction_law": {name: getattr(law, name).tolist() for name in law.__dataclass_fields__},
        "robot_mode": int(c.robot_mode),
        "safety_mode": int(c.safety_mode),
        "runtime_state": int(c.runtime),
        "reference_mode": c.reference.mode,
        "standing": c.standing,
        "program": type(c.program).__name__ if c.program else None,
        "scripts_started": c.scripts_started,
        "stops": [asdict(stop) for stop in c.stops],
        "watchdog_trips": c.watchdog_trips,
        "watchdog_s": c.watchdog_s,
        "refused_commands": list(c.refused_commands),
        "refused_scripts": list(c.refused_scripts),
        "odd_inputs": c.odd_inputs,
    }
