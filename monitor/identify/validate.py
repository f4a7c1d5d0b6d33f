"""Validation: predicted torque beside the measured torque of a recording that was not fitted."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.fit.fit import layout_of
from monitor.identify.identification import Identification
from monitor.identify.settings import PLACE_RAD, IdentifySettings
from monitor.identify.signals.arm import joint_torque, motion_of
from monitor.identify.signals.motion import Motion
from monitor.model.regressor import regressor
from monitor.model.robot import Robot
from monitor.recording import Array, Mask, Recording

LEAST_SAMPLES = 10  # at a place; fewer are chance


def residual_peak(q: Array, residual: Array, moving: Mask) -> Array:
    """(J,) middle of the place, `PLACE_RAD` wide, with the largest RMS residual [rad]; NaN where the joint did not move.

    q, residual, moving : (N, J).
    """
    peaks = np.full(q.shape[1], np.nan)
    for j in range(q.shape[1]):
        on = np.flatnonzero(moving[:, j])
        if not len(on):
            continue
        place = np.floor(q[on, j] / PLACE_RAD).astype(np.intp)
        first = int(place.min())
        place -= first
        samples, squares = np.bincount(place), np.bincount(place, residual[on, j] ** 2)
        mean = np.where(samples >= LEAST_SAMPLES, squares / np.maximum(samples, 1), -1.0)
        peaks[j] = (first + int(np.argmax(mean)) + 0.5) * PLACE_RAD if mean.max() >= 0 else np.nan
    return peaks


class TorqueParts(NamedTuple):
    """Predicted joint torque and its parts, each (N, J) [N·m]; torque = rigid + friction."""

    torque: Array
    rigid: Array
    friction: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Validation:
    """The error of an identification's prediction on one recording; (J,) each where nothing else is said."""

    file: str
    samples: int
    rms_nm: Array  # over samples with |q̇ⱼ| > 0.02 rad/s, as are relative_rms, r2 and nominal_rms_nm
    relative_rms: Array  # RMS(residual) / RMS(torque)
    r2: Array  # 1 − residual variance / torque variance
    rms_all_nm: Array  # over all samples …
    relative_rms_all: Array  # … over RMS(torque) of all samples
    normalised_error_nm: float  # e_N = √(eᵀe)/N over all joints, Raviola et al. (2021)
    nominal_rms_nm: Array  # RMS error of the manufacturer's masses and centres of mass
    nominal_normalised_error_nm: float  # their e_N: "before" in the paper, beside "after"


def predict_torque(identification: Identification, robot: Robot, q: Array, qd: Array, qdd: Array) -> TorqueParts:
    """Torque of the identified model at states q, qd, qdd (N, J) [rad, rad/s, rad/s²]. Raises BadInput for another robot."""
    if robot.name != identification.robot:
        raise BadInput(f"the parameters are of {identification.robot}, the robot is {robot.name}")
    Y = regressor(robot, identification.mounting, q, qd, qdd)[:, :, list(identification.columns)]  # (N, J, B)
    layout = layout_of(identification.columns, robot.joints)
    rigid = Y @ np.where(layout.rigid, identification.values, 0.0)
    if identification.friction:
        load_nm = Y @ np.where(layout.load, identification.values, 0.0)  # (N, J)
        friction = identification.law.torque(identification.friction.values, qd, load_nm)
    else:
        friction = Y @ np.where(layout.rigid, 0.0, identification.values)
    return TorqueParts(rigid + friction, rigid, friction)


def held_out_settings(settings: IdentifySettings | None = None) -> IdentifySettings:
    """The settings for a recording that is predicted and not fitted: one joint that moves is enough."""
    settings = settings or IdentifySettings()
    return replace(settings, signals=replace(settings.signals, min_moving_share=0.0))


def predict_motion(identification: Identification, robot: Robot, moved: Motion) -> TorqueParts:
    """Torque of the identified model along a motion, with friction's steps rounded as the filter rounds those of the measured torque.

    Raises BadInput for another robot.
    """
    sharp = predict_torque(identification, robot, moved.q, moved.qd, moved.qdd)
    law = identification.law
    if identification.friction:
        Y = regressor(robot, identification.mounting, moved.q, moved.qd, moved.qdd)[:, :, list(identification.columns)]
        load_nm = Y @ np.where(layout_of(identification.columns, robot.joints).load, identification.values, 0.0)  # (N, J)
        parameters = identification.friction.values
    else:
        load_nm = np.zeros_like(moved.qd)
        parameters = np.stack([identification.coulomb_nm, identification.viscous_nm_s_per_rad], axis=1)
    columns = law.columns(moved.qd, load_nm)  # (N, J, K)
    columns = np.concatenate([moved.direction[:, :, None], columns[:, :, 1:2], moved.rounded(columns[:, :, 2:])], axis=2)
    friction = np.einsum("njk,jk->nj", columns, np.nan_to_num(parameters))
    return TorqueParts(sharp.rigid + friction, sharp.rigid, friction)


def validate(
    identification: Identification,
    recording: Recording,
    robot: Robot,
    gains: Array | None = None,
    settings: IdentifySettings | None = None,
) -> Validation:
    """The errors of the identification, and of the manufacturer's parameters, on a recording that was not fitted.

    Measured torque and prediction both come from signals filtered as for the fit. gains : (J,) [N·m/A] as for `identify`.
    Raises BadInput and Unidentifiable as `identify` does, but one joint that moves is enough.
    """
    settings = held_out_settings(settings)
    moved = motion_of(recording, robot, settings.signals)
    measured = joint_torque(moved, robot, gains)
    predicted = predict_motion(identification, robot, moved).torque
    moving = moved.moving(settings.moving_rad_s)
    found = errors_of(measured, predicted, moving)
    nominal_torque = regressor(robot, identification.mounting, moved.q, moved.qd, moved.qdd) @ robot.nominal_parameters()
    nominal = errors_of(measured, nominal_torque, moving)
    return Validation(
        file=recording.source,
        samples=moved.samples,
        rms_nm=found.rms_nm,
        relative_rms=found.relative_rms,
        r2=found.r2,
        rms_all_nm=found.rms_all_nm,
        relative_rms_all=found.relative_rms_all,
        normalised_error_nm=found.normalised_error_nm,
        nominal_rms_nm=nominal.rms_nm,
        nominal_normalised_error_nm=nominal.normalised_error_nm,
    )


class Errors(NamedTuple):
    """Figures of a residual; the fields are those of `Validation`."""

    rms_nm: Array
    relative_rms: Array
    r2: Array
    rms_all_nm: Array
    relative_rms_all: Array
    normalised_error_nm: float


def errors_of(measured: Array, predicted: Array, moving: Mask) -> Errors:
    """Figures of the residual; (J,) entries are NaN for a joint that never moves.

    measured, predicted : (N, J) [N·m]. moving : (N, J) the samples that count.
    """
    residual = measured - predicted
    some = np.count_nonzero(moving, axis=0)
    count = np.where(some > 0, some, np.nan)  # (J,)

    def mean_square(x: Array) -> Array:
        counted = np.where(moving, x, 0.0)
        square: Array = np.einsum("nj,nj->j", counted, counted) / count
        return square

    rms, size = np.sqrt(mean_square(residual)), np.sqrt(mean_square(measured))
    rms_all, size_all = (np.sqrt(np.mean(each**2, axis=0)) for each in (residual, measured))
    variance = mean_square(measured - np.sum(np.where(moving, measured, 0.0), axis=0) / count)
    return Errors(
        rms_nm=rms,
        relative_rms=np.divide(rms, size, out=np.full_like(rms, np.nan), where=size > 0.0),
        r2=1.0 - np.divide(rms**2, variance, out=np.full_like(rms, np.nan), where=variance > 0.0),
        rms_all_nm=rms_all,
        relative_rms_all=np.divide(rms_all, size_all, out=np.full_like(rms_all, np.nan), where=size_all > 0.0),
        normalised_error_nm=float(np.linalg.norm(residual) / len(residual)),
    )
