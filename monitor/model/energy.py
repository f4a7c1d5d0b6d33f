"""Kinetic energy of the arm along a trajectory, and the energy of a collision with a person as ISO/TS 15066 computes it.

T = ½ q̇ᵀM(q)q̇, and M(q)·q̇ is the torque at rest with q̈ := q̇. So T is linear in the base parameters and has their uncertainty. A parameter
without effect on torque has no part in T either. Rotors are included; they are most of a wrist's inertia as seen from the joint.

All figures are estimates for a risk assessment. They supervise nothing and stop nothing: this is not a safety function.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.model.regressor import regressor
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, known_or_none

ONE_SIDED_95 = 1.645  # standard deviations above the mean, for a one-sided bound of 95 %
SERIES_POINTS = 500  # of the series in a document; its other figures are of all samples
STATEMENT = "an estimate for a risk assessment, not a safety function"


class Energy(NamedTuple):
    """Kinetic energy of the whole arm with its rotors, and of a payload added by `with_payload`, each (N,) [J]."""

    mean: Array
    std: Array  # standard deviation; NaN where parameters count that the identification did not excite

    @property
    def upper(self) -> Array:
        """(N,) upper bound with 95 % probability, one-sided."""
        bound: Array = self.mean + ONE_SIDED_95 * self.std
        return bound

    def with_payload(self, payload_kg: float, speed_m_s: Array) -> "Energy":
        """The energy with another ½·m·v² of a mass at the flange, which was not in the hand when the arm was identified.

        speed_m_s : (N,) of the flange. Raises BadInput for a mass that is negative or not finite.
        """
        if not 0.0 <= payload_kg < math.inf:
            raise BadInput(f"energy: a payload of {payload_kg:g} kg; expected 0 or more")
        return Energy(self.mean + 0.5 * payload_kg * speed_m_s**2, self.std)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyRegion:
    """The limit that the user's risk assessment gives for one region of the body."""

    name: str
    limit_j: float
    mass_kg: float = math.inf  # effective mass of the region; infinite where it cannot move away, since it is clamped

    @classmethod
    def parse(cls, text: str) -> "BodyRegion":
        """The region in `NAME=JOULES` or `NAME=JOULES@KILOGRAMS`.

        Raises BadInput for another form, and for figures that are not positive.
        """
        name, equals, figures = text.partition("=")
        limit, at, mass = figures.partition("@")
        try:
            region = cls(name=name.strip(), limit_j=float(limit), mass_kg=float(mass) if at else math.inf)
        except ValueError:
            region = None
        positive = region is not None and 0.0 < region.limit_j < math.inf and region.mass_kg > 0.0
        if region is None or not positive or not equals or not region.name:
            raise BadInput(f"limit {text!r}: expected REGION=JOULES or REGION=JOULES@KILOGRAMS, e.g. hand=0.49@0.6")
        return region


class Comparison(NamedTuple):
    """One region's limit beside the energies along the trajectory."""

    region: BodyRegion
    reduced_mass_kg: float
    transfer_j: Array  # (N,) energy of a collision
    worst_sample: int
    share_above: float  # fraction of the samples whose transfer energy exceeds the limit
    transfer_below: bool  # the transfer energy never exceeds the limit
    arm_below: bool | None  # the upper 95 % bound of the whole arm's energy never exceeds the limit; None where the bound is unknown


def kinetic_energy(robot: Robot, q: Array, qd: Array, columns: Sequence[int], values: Array, covariance: Array) -> Energy:
    """Kinetic energy at states q, qd (N, J) [rad, rad/s] from base parameters.

    columns, values, covariance : (B,), (B,), (B, B) as in `identify.identification.Identification`.
    Raises BadInput where their shapes do not fit.
    """
    if values.shape != (len(columns),) or covariance.shape != (len(columns), len(columns)):
        raise BadInput(f"energy: values are {values.shape} and covariance {covariance.shape}; expected those of {len(columns)} columns")
    rest, level = np.zeros_like(qd), Mounting()
    # at rest the torque is M·q̈ + weight; the difference takes the weight out, so any mounting serves
    momentum = regressor(robot, level, q, rest, qd) - regressor(robot, level, q, rest, rest)  # (N, J, P)
    T = 0.5 * np.einsum("nj,njb->nb", qd, momentum[:, :, list(columns)])  # (N, B)
    unknown = np.isnan(np.diag(covariance))  # (B,)
    known = np.where(unknown[:, None] | unknown, 0.0, covariance)
    variance = np.einsum("nb,bc,nc->n", T, known, T)
    # friction has exact zeros here; for a rigid parameter, a millionth of the energy counts as none
    size = np.abs(T @ values) + 1e-12
    rests_on_unknown = np.any(np.abs(T[:, unknown] * values[unknown]) > 1e-6 * size[:, None], axis=1)
    return Energy(T @ values, np.where(rests_on_unknown, np.nan, np.sqrt(np.maximum(variance, 0.0))))


def flange_speed(robot: Robot, q: Array, qd: Array) -> Array:
    """(N,) speed of the origin of the last DH frame [m/s]."""
    N = len(q)
    turn = np.broadcast_to(np.eye(3), (N, 3, 3))
    origin, velocity, spin = (np.zeros((N, 3)) for _ in range(3))
    for i in range(robot.joints):
        spin = spin + qd[:, i, None] * turn[:, :, 2]
        angle = q[:, i] + robot.zero_rad[i]
        c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(N), np.ones(N)
        turn = turn @ np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], 1)
        step = turn @ np.array([robot.a_m[i], robot.y_m[i], robot.d_m[i]])  # (N, 3)
        origin, velocity = origin + step, velocity + np.cross(spin, step)
        ca, sa = math.cos(robot.alpha_rad[i]), math.sin(robot.alpha_rad[i])
        turn = turn @ np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    speed: Array = np.linalg.norm(velocity, axis=1)
    return speed


def effective_mass_kg(robot: Robot, payload_kg: float) -> float:
    """m_R = M/2 + m_L: half of the moving mass and the payload, by the two-body model of ISO/TS 15066:2016, A.3.4.

    M is the manufacturer's, since torque does not reveal it: the mass of link 1, for instance, has no effect on any torque.
    Raises BadInput where the masses are not published, or the payload is negative or not finite.
    """
    if not 0.0 <= payload_kg < math.inf:
        raise BadInput(f"energy: a payload of {payload_kg:g} kg; expected 0 or more")
    moving = float(np.sum(robot.mass_kg))
    if not math.isfinite(moving):
        raise BadInput(f"{robot.name}: the masses of this model are not published, so its effective mass is not known")
    return 0.5 * moving + payload_kg


def compare(region: BodyRegion, speed_m_s: Array, robot_mass_kg: float, energy: Energy) -> Comparison:
    """The limit beside the transfer energy E = ½·μ·v² with 1/μ = 1/m_H + 1/m_R, and beside the whole arm's kinetic energy.

    ISO/TS 15066 compares the transfer energy: a collision at the flange's speed with a region that can move away. The whole arm's energy
    is a bound for contact anywhere on the arm: without work of the motors, a collision cannot transfer more.
    speed_m_s : (N,) of the flange.
    """
    reduced = 1.0 / (1.0 / region.mass_kg + 1.0 / robot_mass_kg)
    transfer = 0.5 * reduced * speed_m_s**2
    upper = energy.upper
    return Comparison(
        region=region,
        reduced_mass_kg=reduced,
        transfer_j=transfer,
        worst_sample=int(np.argmax(transfer)),
        share_above=float(np.mean(transfer > region.limit_j)),
        transfer_below=bool(np.all(transfer <= region.limit_j)),
        arm_below=None if np.any(np.isnan(upper)) else bool(np.all(upper <= region.limit_j)),
    )


def energy_document(
    robot: Robot, t_s: Array, energy: Energy, speed_m_s: Array, regions: Sequence[BodyRegion], payload_kg: float
) -> dict[str, object]:
    """The JSON object of `energy --json` for one trajectory with times t_s (N,) and flange speeds (N,); null for unknown."""
    worst, fastest = int(np.argmax(energy.mean)), int(np.argmax(speed_m_s))
    every = max(1, -(-len(t_s) // SERIES_POINTS))
    document: dict[str, object] = {
        "kinetic_energy_j": {
            "max": float(energy.mean[worst]),
            "std_at_max": known_or_none(energy.std[worst]),
            "upper95_at_max": known_or_none(energy.upper[worst]),
            "at_s": float(t_s[worst]),
            "mean": float(np.mean(energy.mean)),
            "min": float(np.min(energy.mean)),
        },
        "flange_speed_m_s": {"max": float(speed_m_s[fastest]), "at_s": float(t_s[fastest])},
        "series": {
            "time_s": t_s[::every].tolist(),
            "kinetic_energy_j": energy.mean[::every].tolist(),
            "std_j": [known_or_none(value) for value in energy.std[::every]],
            "flange_speed_m_s": speed_m_s[::every].tolist(),
        },
        "statement": STATEMENT,
    }
    if regions:
        m_R = effective_mass_kg(robot, payload_kg)
        document["effective_mass"] = {
            "robot_kg": m_R,
            "payload_kg": payload_kg,
            "formula": "m_R = M/2 + m_L; E = ½·μ·v², 1/μ = 1/m_H + 1/m_R",
        }
        document["regions"] = [_comparison_document(compare(region, speed_m_s, m_R, energy), t_s) for region in regions]
    return document


def _comparison_document(found: Comparison, t_s: Array) -> dict[str, object]:
    """One region's comparison as a JSON object."""
    region = found.region
    return {
        "region": region.name,
        "limit_j": region.limit_j,
        "body_mass_kg": region.mass_kg if math.isfinite(region.mass_kg) else None,
        "reduced_mass_kg": found.reduced_mass_kg,
        "transfer_energy_max_j": float(found.transfer_j[found.worst_sample]),
        "at_s": float(t_s[found.worst_sample]),
        "share_of_time_above": found.share_above,
        "transfer_energy_below_limit": found.transfer_below,
        "whole_arm_below_limit": found.arm_below,
    }
