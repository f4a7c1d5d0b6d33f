"""The ten inertial parameters of a payload at the flange; the arm and its friction are known from a run without the payload.

A heavier tool also increases the friction of loaded gears. With the load term of the friction law, this is counted as friction and not as
mass.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.fit.fit import layout_of
from monitor.identify.fit.jackknife import block_steps, jackknife_covariance
from monitor.identify.fit.least_squares import Rows, factors, residual_rms, solve
from monitor.identify.identification import Identification
from monitor.identify.settings import IdentifySettings
from monitor.identify.signals.arm import joint_torque, motion_of
from monitor.identify.signals.motion import Motion
from monitor.model.regressor import regressor
from monitor.model.robot import INERTIAL, PER_JOINT, Robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Recording

SIGNIFICANT_STD = 3.0  # standard deviations from 0 at which a mass is certain
ROUNDS = 4  # payload → load → friction → payload; each round gains more than a digit
NAMES = ("m", "mx", "my", "mz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")  # of the parameters, in the last DH frame

UNPHYSICAL_PAYLOAD = Sentence(
    "unphysical_payload",
    "the payload comes out at {mass_kg:.3g} ± {mass_std_kg:.2g} kg: the arm was heavier when it was identified, "
    "or gains, mounting or robot are others",
)
NO_PAYLOAD = Sentence("no_payload", "no payload shows: {mass_kg:.3g} ± {mass_std_kg:.2g} kg; its centre means nothing")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Payload:
    """Inertial parameters of the payload in the last DH frame, moments about its origin."""

    parameters: Array  # (10,) m [kg], mx my mz [kg·m], Jxx Jxy Jxz Jyy Jyz Jzz [kg·m²]
    covariance: Array  # (10, 10) by the noise of the loaded run; arm and friction count as exactly known
    rms_nm: Array  # (J,) residual over moving samples; NaN for a joint that never moves
    relative_rms: Array  # (J,) fraction of the torque's RMS over the same samples
    samples: int

    @property
    def mass_kg(self) -> float:
        """The mass m."""
        return float(self.parameters[0])

    @property
    def mass_std_kg(self) -> float:
        """Standard deviation of the mass."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def com_m(self) -> Array:
        """(3,) centre of mass in the last DH frame [m]; NaN where the mass is not certain."""
        com: Array = self.parameters[1:4] / self.mass_kg if self.significant else np.full(3, np.nan)
        return com

    @property
    def significant(self) -> bool:
        """Whether the mass differs from 0 by more than `SIGNIFICANT_STD` standard deviations."""
        return self.mass_kg > SIGNIFICANT_STD * self.mass_std_kg

    @property
    def warnings(self) -> tuple[Reason, ...]:
        """What the reader of the result must know."""
        mass = {"mass_kg": self.mass_kg, "mass_std_kg": self.mass_std_kg}
        if self.mass_kg < -SIGNIFICANT_STD * self.mass_std_kg:
            return (UNPHYSICAL_PAYLOAD(**mass),)
        if not self.significant:
            return (NO_PAYLOAD(**mass),)
        return ()


def identify_payload(
    recordings: Sequence[Recording],
    unloaded: Identification,
    robot: Robot,
    *,
    gains: Array | None = None,
) -> Payload:
    """The payload that explains the torque beyond that of the arm alone.

    gains : as for `identify`. The rows are weighted with the residuals of the unloaded fit. Raises BadInput where the identification is
    of another robot or no recording was given, Unidentifiable as `identify` does.
    """
    settings = IdentifySettings()
    if robot.name != unloaded.robot:
        raise BadInput(f"payload: the parameters are of {unloaded.robot}, the robot is {robot.name}")
    if not recordings:
        raise BadInput("payload: no recording was given; expected one or more with the payload")
    runs = [_loaded_run(recording, unloaded, robot, gains, settings) for recording in recordings]
    parameters = np.zeros(INERTIAL)
    weights = 1.0 / np.where(unloaded.rms_nm > 0.0, unloaded.rms_nm, np.inf)
    weights = np.where(np.isfinite(unloaded.rms_nm), weights, 0.0)
    for _ in range(ROUNDS):
        rows = [_rows(run, unloaded, parameters, settings) for run in runs]
        solution = solve(factors(rows), weights, np.zeros(INERTIAL))
        parameters = solution.values
    joints = factors(rows)
    rms = np.where([factor.samples > 0 for factor in joints], residual_rms(joints, parameters), np.nan)
    size = np.concatenate([np.where(rec.used, run.torque_nm, 0.0) for rec, run in zip(rows, runs, strict=True)])
    count = np.array([factor.samples for factor in joints])
    return Payload(
        parameters=parameters,
        covariance=jackknife_covariance(rows, weights, solution),
        rms_nm=rms,
        relative_rms=rms / np.sqrt(np.sum(size**2, axis=0) / np.where(count > 0, count, np.nan)),
        samples=len(size),
    )


class _LoadedRun(NamedTuple):
    """One run with the payload, (N, J) each where not said otherwise."""

    moved: Motion
    Y: Array  # (N, J, 10) columns of the payload's parameters
    torque_nm: Array  # measured
    without_rigid_nm: Array  # measured, less the rigid arm
    load_nm: Array  # torque of the arm alone through the gears


def _loaded_run(
    recording: Recording, unloaded: Identification, robot: Robot, gains: Array | None, settings: IdentifySettings
) -> _LoadedRun:
    """The recording as equations of the payload. Raises BadInput and Unidentifiable as `identify_payload`."""
    moved = motion_of(recording, robot, settings.signals)
    torque = joint_torque(moved, robot, gains)
    layout = layout_of(unloaded.columns, robot.joints)
    Y = regressor(robot, unloaded.mounting, moved.q, moved.qd, moved.qdd)  # (N, J, P)
    base = Y[:, :, list(unloaded.columns)]
    rigid, load = (base @ np.where(mask, unloaded.values, 0.0) for mask in (layout.rigid, layout.load))
    last = slice(PER_JOINT * (robot.joints - 1), PER_JOINT * (robot.joints - 1) + INERTIAL)
    return _LoadedRun(moved, Y[:, :, last], torque, torque - rigid, load)


def _rows(run: _LoadedRun, unloaded: Identification, parameters: Array, settings: IdentifySettings) -> Rows:
    """The equations with the friction that the arm has under the load of the payload `parameters` (10,)."""
    moved = run.moved
    paper = np.stack([unloaded.coulomb_nm, unloaded.viscous_nm_s_per_rad], axis=1)  # (J, 2)
    friction = unloaded.friction.values if unloaded.friction else np.nan_to_num(paper)  # (J, K)
    columns = moved.rounded(unloaded.law.columns(moved.qd, run.load_nm + run.Y @ parameters))  # (N, J, K)
    columns[:, :, 0] = moved.direction
    target = run.without_rigid_nm - np.einsum("njk,jk->nj", columns, friction)
    return Rows(run.Y, target, moved.moving(settings.moving_rad_s), block_steps(moved, settings.block_s), moved.segments)
