"""Identification: the parameters that explain a recording, and how sure we are of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify import caveats as told
from monitor.identify.caveats import Caveat
from monitor.identify.least_squares import WINDOW_STEPS, Rows, condition_number, factors, jackknife_covariance, residual_rms, solve
from monitor.identify.mounting import mounting_check
from monitor.identify.signals import STANDSTILL_SPEED_RAD_S, Mask, Motion, SignalSettings, motion
from monitor.identify.torque import joint_torque
from monitor.model.base import Base, base_parameters
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, Recording

__all__ = [
    "Caveat", "Identification", "IdentifySettings", "Source", "TorqueParts", "Validation",
    "identify", "identify_motions", "predict_torque", "validate",
]  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifySettings:
    """How a motion becomes parameters."""

    signals: SignalSettings = field(default_factory=SignalSettings)
    moving_rad_s: float = STANDSTILL_SPEED_RAD_S  # slower samples of a joint are not fitted by WLS, nor counted in the RMS
    block_s: float = 0.8  # residuals stay correlated for 0.4–0.55 s: blocks must be longer, and still be many
    reweightings: int = 3  # the scales of the joints settle to 1 % in two


class Source(NamedTuple):
    """What went into an identification from one recording."""

    file: str
    samples: int
    rate_hz: float
    duration_s: float
    rejected_samples: int
    rejected_why: Mapping[str, int]


class TorqueParts(NamedTuple):
    """Predicted joint torque and what it is made of, each (N, J) [N·m]; torque = rigid + friction."""

    torque: Array
    rigid: Array
    friction: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """What one recording, or several together, say about one arm."""

    robot: str
    mounting: Mounting
    method: str  # "ls" | "wls"
    names: tuple[str, ...]  # (B,) of the base parameters
    combination: Array  # (B, P): base = combination · standard parameters
    columns: tuple[int, ...]  # (B,) columns of the regressor that were kept
    values: Array  # (B,)
    covariance: Array  # (B, B) honest: accounts for correlated residuals; NaN for what the motion did not excite
    condition_number: float
    coulomb_nm: Array  # (J,) NaN where the motion did not excite it
    viscous_nm_s_per_rad: Array  # (J,)
    friction_cov: Array  # (J, 2, 2) of (fc, fv) of each joint
    temperature_c: Array | None  # (J,) mean during the recording
    max_speed_rad_s: Array  # (J,) fastest each joint moved
    rms_nm: Array  # (J,) residual over moving samples
    relative_rms: Array  # (J,) fraction of the torque's RMS over the same samples
    rms_all_nm: Array  # (J,) over all samples
    normalised_error_nm: float  # e_N = √(eᵀe)/N, Raviola et al. (2021)
    samples: int
    caveats: tuple[Caveat, ...] = ()
    sources: tuple[Source, ...] = ()

    @property
    def std(self) -> Array:
        """(B,) standard deviation of each base parameter; NaN where the motion did not excite it."""
        deviation: Array = np.sqrt(np.diag(self.covariance))
        return deviation

    def friction_at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """Friction torque fc + fv·v at a positive speed, and its standard deviation, each (J,) [N·m]."""
        x = np.array([1.0, speed_rad_s])
        torque: Array = self.coulomb_nm + self.viscous_nm_s_per_rad * speed_rad_s
        return torque, np.sqrt(np.einsum("i,jik,k->j", x, self.friction_cov, x))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Validation:
    """How well an identification predicts a recording, each (J,) where not said otherwise."""

    file: str
    samples: int
    rms_nm: Array  # over samples with |q̇ⱼ| > 0.02 rad/s, as are relative_rms, r2 and nominal_rms_nm
    relative_rms: Array  # RMS(residual) / RMS(torque)
    r2: Array  # 1 − residual variance / torque variance
    rms_all_nm: Array  # over all samples
    normalised_error_nm: float  # e_N over all joints and samples
    nominal_rms_nm: Array  # of the manufacturer's masses and centres of mass alone


def identify(
    recordings: Sequence[Recording],
    robot: Robot,
    mounting: Mounting,
    *,
    method: str = "wls",
    gains: Array | None = None,
    settings: IdentifySettings | None = None,
) -> Identification:
    """The base parameters that explain the recordings together.

    `ls` is the paper's: all samples, all joints alike. `wls` scales each joint's rows by its residual and leaves out the samples where
    that joint stands still. gains : (J,) [N·m/A] or None for the published torque constants. Raises Unidentifiable where a recording
    holds too little motion, BadInput where it does not fit the robot.
    """
    settings = settings or IdentifySettings()
    for recording in recordings:
        _refuse_other_arm(recording, robot)
    motions = [motion(recording, settings.signals) for recording in recordings]
    torques = [joint_torque(moved, robot, gains) for moved in motions]
    remarks = list(told.of_recordings(recordings))
    for moved, recording in zip(motions, recordings, strict=True):
        remarks += told.of_motion(moved, recording.context.payload_kg)
    contradiction = mounting_check(motions, torques, robot, mounting)
    if contradiction is not None:
        remarks.append(contradiction)
    return identify_motions(motions, torques, robot, mounting, method=method, settings=settings, caveats=remarks)


def identify_motions(
    motions: Sequence[Motion],
    torques: Sequence[Array],
    robot: Robot,
    mounting: Mounting,
    *,
    method: str = "wls",
    settings: IdentifySettings | None = None,
    caveats: Sequence[Caveat] = (),
) -> Identification:
    """`identify` from prepared signals on: torques are (N, J) [N·m] of each motion."""
    settings = settings or IdentifySettings()
    if method not in {"ls", "wls"}:
        raise BadInput(f"method {method!r} is not known; known are ls, wls")
    if not motions:
        raise BadInput("identify: no recording was given; expected one or more")
    base = base_parameters(robot, mounting)
    recordings = [_rows(moved, torque, robot, mounting, base, method, settings) for moved, torque in zip(motions, torques, strict=True)]
    prior = base.combination @ robot.nominal_parameters()  # (B,) only where the motion says nothing
    joints = factors(recordings)
    size = np.array([np.linalg.norm(factor.R[:, -1]) / np.sqrt(max(factor.samples, 1)) for factor in joints])  # (J,) RMS of the torque
    weights = np.ones(robot.joints)
    solution = solve(joints, weights, prior)
    if method == "wls":
        for _ in range(settings.reweightings):
            weights = 1.0 / np.maximum(residual_rms(joints, solution.values), 1e-9 * size + 1e-12)  # a perfect fit is no infinite weight
            solution = solve(joints, weights, prior)
    covariance = jackknife_covariance(recordings, weights, solution)
    covariance[~solution.excited] = np.nan
    covariance[:, ~solution.excited] = np.nan

    friction = np.searchsorted(base.columns, np.stack(friction_columns(robot.joints), axis=1))  # (J, 2) places of fc, fv
    coulomb, viscous = np.where(solution.excited[friction], solution.values[friction], np.nan).T  # (J,), (J,)
    condition = condition_number(joints)
    speeds, measured = np.concatenate([moved.qd for moved in motions]), np.concatenate(list(torques))
    predicted = np.concatenate([rec.Y @ solution.values for rec in recordings])
    moving = np.abs(speeds) > settings.moving_rad_s
    fit = _errors(measured, predicted, moving)
    remarks = [*caveats, *told.of_joints(robot, speeds, moving)]
    remarks += told.of_solution(base.names, solution.excited, condition, len(measured), coulomb, viscous)
    return Identification(
        robot=robot.name,
        mounting=mounting,
        method=method,
        names=base.names,
        combination=base.combination,
        columns=base.columns,
        values=solution.values,
        covariance=covariance,
        condition_number=condition,
        coulomb_nm=coulomb,
        viscous_nm_s_per_rad=viscous,
        friction_cov=covariance[friction[:, :, None], friction[:, None, :]],
        temperature_c=_mean_temperature(motions),
        max_speed_rad_s=np.max(np.abs(speeds), axis=0),
        rms_nm=fit.rms_nm,
        relative_rms=fit.relative_rms,
        rms_all_nm=fit.rms_all_nm,
        normalised_error_nm=fit.normalised_error_nm,
        samples=len(measured),
        caveats=tuple(remarks),
        sources=tuple(
            Source(m.source, m.recorded_samples, m.rate_hz, m.duration_s, m.rejected_samples, dict(m.rejected_why)) for m in motions
        ),
    )


def predict_torque(identification: Identification, robot: Robot, q: Array, qd: Array, qdd: Array) -> TorqueParts:
    """Torque that the identified model expects at states q, q̇, q̈ (N, J) [rad, rad/s, rad/s²]."""
    if robot.name != identification.robot:
        raise BadInput(f"the parameters are of {identification.robot}, the robot is {robot.name}")
    Y = regressor(robot, identification.mounting, q, qd, qdd)[:, :, list(identification.columns)]  # (N, J, B)
    torque = Y @ identification.values
    of_friction = np.isin(identification.columns, np.concatenate(friction_columns(robot.joints)))  # (B,)
    friction = Y @ np.where(of_friction, identification.values, 0.0)
    return TorqueParts(torque, torque - friction, friction)


def validate(
    identification: Identification,
    recording: Recording,
    robot: Robot,
    gains: Array | None = None,
    settings: IdentifySettings | None = None,
) -> Validation:
    """The prediction beside a recording that was not fitted, and beside the manufacturer's parameters.

    Torque and prediction both come from signals filtered as for the fit. Raises as `identify` does.
    """
    settings = settings or IdentifySettings()
    _refuse_other_arm(recording, robot)
    moved = motion(recording, settings.signals)
    measured = joint_torque(moved, robot, gains)
    predicted = predict_torque(identification, robot, moved.q, moved.qd, moved.qdd).torque
    moving = moved.moving(settings.moving_rad_s)
    found = _errors(measured, predicted, moving)
    nominal = regressor(robot, identification.mounting, moved.q, moved.qd, moved.qdd) @ robot.nominal_parameters()
    return Validation(
        file=recording.source,
        samples=moved.samples,
        rms_nm=found.rms_nm,
        relative_rms=found.relative_rms,
        r2=found.r2,
        rms_all_nm=found.rms_all_nm,
        normalised_error_nm=found.normalised_error_nm,
        nominal_rms_nm=_errors(measured, nominal, moving).rms_nm,
    )


def _refuse_other_arm(recording: Recording, robot: Robot) -> None:
    """Raises BadInput where the recording itself says that another model made it."""
    made_by = recording.context.robot
    if made_by is not None and made_by != robot.name:
        raise BadInput(f"{recording.source or 'recording'}: recorded on a {made_by}; the robot given is {robot.name}")


class _Errors(NamedTuple):
    rms_nm: Array
    relative_rms: Array
    r2: Array
    rms_all_nm: Array
    normalised_error_nm: float


def _errors(measured: Array, predicted: Array, moving: Mask) -> _Errors:
    """Figures of the residual; (J,) are NaN for a joint that never moves. measured, predicted : (N, J) [N·m]."""
    residual = measured - predicted
    count = np.where(moving.any(axis=0), moving.sum(axis=0), np.nan)  # (J,)

    def mean(x: Array) -> Array:
        average: Array = np.sum(np.where(moving, x, 0.0), axis=0) / count
        return average

    rms, size = np.sqrt(mean(residual**2)), np.sqrt(mean(measured**2))
    variance = mean((measured - mean(measured)) ** 2)
    return _Errors(
        rms_nm=rms,
        relative_rms=np.divide(rms, size, out=np.full_like(rms, np.nan), where=size > 0.0),
        r2=1.0 - np.divide(rms**2, variance, out=np.full_like(rms, np.nan), where=variance > 0.0),
        rms_all_nm=np.sqrt(np.mean(residual**2, axis=0)),
        normalised_error_nm=float(np.linalg.norm(residual) / len(residual)),
    )


def _rows(moved: Motion, torque: Array, robot: Robot, mounting: Mounting, base: Base, method: str, settings: IdentifySettings) -> Rows:
    """The equations of one motion.

    A step of Coulomb friction beside a filtered torque would make fc too small by several of its standard deviations, and fv too large:
    the torque's filter rounds the column too.
    """
    Y = regressor(robot, mounting, moved.q, moved.qd, moved.qdd)  # (N, J, P)
    joints = np.arange(robot.joints)
    Y[:, joints, friction_columns(robot.joints)[0]] = moved.direction
    Y = Y[:, :, list(base.columns)]  # (N, J, B)
    used = moved.moving(settings.moving_rad_s) if method == "wls" else np.ones(torque.shape, dtype=bool)
    return Rows(Y, torque, used, moved.blocks(settings.block_s / WINDOW_STEPS), moved.segments)


def _mean_temperature(motions: Sequence[Motion]) -> Array | None:
    """(J,) over all samples of all motions, or None where one of them did not measure it."""
    measured = [moved.temperature_c for moved in motions if moved.temperature_c is not None]
    if len(measured) < len(motions):
        return None
    mean: Array = np.mean(np.concatenate(measured), axis=0)
    return mean
