"""A payload at the flange: its ten inertial parameters alone, arm and friction known from a run without it.

A heavier tool raises the friction of loaded gears as well; with the load term known that is no wear, and is not mistaken for mass.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.errors import BadInput
from monitor.identify.fit.equations import layout_of
from monitor.identify.fit.jackknife import block_steps, jackknife_covariance
from monitor.identify.fit.least_squares import Rows, factors, residual_rms, solve
from monitor.identify.identification import Identification, IdentifySettings
from monitor.identify.signals.checks import refuse_other_arm
from monitor.identify.signals.motion import motion
from monitor.identify.signals.torque import joint_torque
from monitor.identify.warnings import DataWarning
from monitor.model.regressor import regressor
from monitor.model.robot import INERTIAL, PER_JOINT, Robot
from monitor.recording import Array, Recording

TELLING_STD = 3.0
ROUNDS = 4  # payload → load → friction → payload: each gains more than a digit
NAMES = ("m", "mx", "my", "mz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Payload:
    """What hangs on the flange, in the last DH frame, moments about its origin."""

    parameters: Array  # (10,) m [kg], mx my mz [kg·m], Jxx Jxy Jxz Jyy Jyz Jzz [kg·m²]
    covariance: Array  # (10, 10) by noise of the loaded run; arm and friction count as known
    rms_nm: Array  # (J,) residual over moving samples; NaN for a joint that never moves
    relative_rms: Array  # (J,)
    samples: int

    @property
    def mass_kg(self) -> float:
        """The parameter m."""
        return float(self.parameters[0])

    @property
    def mass_std_kg(self) -> float:
        """Standard deviation of m."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def com_m(self) -> Array:
        """(3,) centre of mass in the last DH frame; NaN where no mass shows."""
        com: Array = self.parameters[1:4] / self.mass_kg if self.telling else np.full(3, np.nan)
        return com

    @property
    def telling(self) -> bool:
        """Whether there is a mass beyond doubt: of none there is no centre."""
        return self.mass_kg > TELLING_STD * self.mass_std_kg

    @property
    def warnings(self) -> tuple[DataWarning, ...]:
        """What the reader must know."""
        mass = f"{self.mass_kg:.3g} ± {self.mass_std_kg:.2g} kg"
        if self.mass_kg < -TELLING_STD * self.mass_std_kg:
            text = f"the payload comes out at {mass}: the arm was heavier when it was identified, or gains, mounting or robot are others"
            return (DataWarning("unphysical_payload", text),)
        if not self.telling:
            return (DataWarning("no_payload", f"no payload shows: {mass}; its centre means nothing"),)
        return ()


def identify_payload(
    recordings: Sequence[Recording],
    unloaded: Identification,
    robot: Robot,
    *,
    gains: Array | None = None,
    settings: IdentifySettings | None = None,
) -> Payload:
    """The ten inertial parameters that explain what the arm alone does not.

    The rows are weighted with the residuals of the unloaded fit. Raises BadInput where the identification is of another robot or nothing
    was given, Unidentifiable as `identify` does.
    """
    settings = settings or IdentifySettings()
    if robot.name != unloaded.robot:
        raise BadInput(f"payload: the parameters are of {unloaded.robot}, the robot is {robot.name}")
    if not recordings:
        raise BadInput("payload: no recording was given; expected one or more with the payload")
    layout = layout_of(unloaded.columns, robot.joints)
    last = slice(PER_JOINT * (robot.joints - 1), PER_JOINT * (robot.joints - 1) + INERTIAL)
    law = unloaded.law
    friction = np.stack([unloaded.coulomb_nm, unloaded.viscous_nm_s_per_rad], axis=1)  # (J, K)
    friction = unloaded.friction.values if unloaded.friction else np.nan_to_num(friction)
    prepared = []
    for recording in recordings:
        refuse_other_arm(recording, robot)
        moved = motion(recording, settings.signals)
        torque = joint_torque(moved, robot, gains)
        Y = regressor(robot, unloaded.mounting, moved.q, moved.qd, moved.qdd)  # (N, J, P)
        base = Y[:, :, list(unloaded.columns)]
        rigid, load = (base @ np.where(mask, unloaded.values, 0.0) for mask in (layout.rigid, layout.load))
        prepared.append((moved, Y[:, :, last], torque - rigid, load, torque))
    parameters = np.zeros(INERTIAL)
    weights = 1.0 / np.where(unloaded.rms_nm > 0.0, unloaded.rms_nm, np.inf)
    weights = np.where(np.isfinite(unloaded.rms_nm), weights, 0.0)
    for _ in range(ROUNDS):
        rows = []
        for moved, Y, rest, load, _ in prepared:
            columns = moved.rounded(law.columns(moved.qd, load + Y @ parameters))  # (N, J, K)
            columns[:, :, 0] = moved.direction
            target = rest - np.einsum("njk,jk->nj", columns, friction)
            used = moved.moving(settings.moving_rad_s)
            rows.append(Rows(Y, target, used, block_steps(moved, settings.block_s), moved.segments))
        solution = solve(factors(rows), weights, np.zeros(INERTIAL))
        parameters = solution.values
    joints = factors(rows)
    rms = np.where([factor.samples > 0 for factor in joints], residual_rms(joints, parameters), np.nan)
    size = np.concatenate([np.where(rec.used, torque, 0.0) for rec, (*_, torque) in zip(rows, prepared, strict=True)])
    count = np.array([factor.samples for factor in joints])
    return Payload(
        parameters=parameters,
        covariance=jackknife_covariance(rows, weights, solution),
        rms_nm=rms,
        relative_rms=rms / np.sqrt(np.sum(size**2, axis=0) / np.where(count > 0, count, np.nan)),
        samples=len(size),
    )
