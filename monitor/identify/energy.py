"""Kinetic energy along a motion, of an arm that is identified from recordings: the document of `joint-monitor energy`."""

from collections.abc import Sequence
from typing import NamedTuple

from monitor.errors import BadInput
from monitor.identify.identify import identify
from monitor.identify.signals.arm import motion_of
from monitor.model.energy import BodyRegion, energy_document, flange_speed, kinetic_energy
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, Recording


class EnergyPath(NamedTuple):
    """The motion along which energy is computed, with N samples of J joints."""

    name: str
    t_s: Array  # (N,) [s]
    q: Array  # (N, J) [rad]
    qd: Array  # (N, J) [rad/s]
    payload_kg: float | None  # carried during this motion; None: the source does not say


def path_of_recording(recording: Recording, robot: Robot) -> EnergyPath:
    """The measured motion of a recording. Raises BadInput where the recording is of another arm."""
    moved = motion_of(recording, robot)
    q, qd = robot.joints_of(moved.q), robot.joints_of(moved.qd)
    return EnergyPath(recording.source, moved.t_s - moved.t_s[0], q, qd, recording.context.payload_kg)


def path_of_excitation(name: str, excitation: Excitation, robot: Robot) -> EnergyPath:
    """The planned motion of an excitation, sampled at the robot's rate. Raises BadInput where it is for another arm."""
    if excitation.robot != robot.name:
        raise BadInput(f"--along {name}: is for a {excitation.robot}; the robot is {robot.name}")
    t_s, (q, qd, _) = excitation.sampled(robot.rate_hz)
    return EnergyPath(name, t_s, q, qd, None)


def energy_along(
    path: EnergyPath,
    recordings: Sequence[Recording],
    *,
    robot: Robot,
    mounting: Mounting,
    gains: Array | None,
    regions: Sequence[BodyRegion],
    payload_kg: float | None,
) -> dict[str, object]:
    """Energy along `path` of the arm identified from `recordings`, as plain JSON.

    gains : (J,) [N·m/A] or None for the published torque constants. payload_kg : in the hand along the path [kg]; None: as the path
    says, else as the recordings say. Raises BadInput (of which Unidentifiable is a kind) as `identify` does.
    """
    identified_with_kg = max(recording.context.payload_kg or 0.0 for recording in recordings)
    carried_kg = identified_with_kg if path.payload_kg is None else path.payload_kg
    mass_kg = carried_kg if payload_kg is None else payload_kg
    found = identify(recordings, robot, mounting, gains=gains)
    speed = flange_speed(robot, path.q, path.qd)
    covariance = found.covariance if found.total_covariance is None else found.total_covariance
    energies = kinetic_energy(robot, robot.motors_of(path.q), robot.motors_of(path.qd), found.columns, found.values, covariance)
    # the last link as identified contains what was in the hand then; only the mass beyond that is added
    energies = energies.with_payload(max(mass_kg - identified_with_kg, 0.0) if mass_kg >= 0.0 else mass_kg, speed)
    return {
        "robot": robot.name,
        "along": path.name,
        "samples": len(path.t_s),
        "duration_s": float(path.t_s[-1] - path.t_s[0]),
        "payload_kg": mass_kg,
        **energy_document(robot, path.t_s, energies, speed, regions, mass_kg),
        "warnings": [warning.document() for warning in found.warnings],
    }
