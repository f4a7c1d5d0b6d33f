"""Identification: the parameters that explain a recording, and how sure we are of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.errors import BadInput
from monitor.identify import warnings as told
from monitor.identify.fit.fit import Equations, Fit, Layout, fit, layout_of, refit, robust_inflation, with_causes
from monitor.identify.fit.least_squares import WINDOW_STEPS, Solution, condition_number, jackknife_covariances
from monitor.identify.fit.physically_consistent import PhysicallyConsistentArm, physically_consistent
from monitor.identify.fit.projection import mapped, mean_load, positive, projection
from monitor.identify.fit.selection import choose_law
from monitor.identify.identification import FrictionFit, Identification, IdentifySettings, ResidualFrictionFit, Source
from monitor.identify.mounting import mounting_check
from monitor.identify.signals.motion import Mask, Motion, motion
from monitor.identify.signals.torque import joint_torque
from monitor.identify.validate import errors_of, refuse_other_arm
from monitor.identify.warnings import DataWarning
from monitor.model.base import Base, base_parameters
from monitor.model.friction import AUTO, PAPER, friction_law, residual_law
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, Recording

METHODS = ("ls", "wls", "robust", "consistent")


def identify(
    recordings: Sequence[Recording],
    robot: Robot,
    mounting: Mounting,
    *,
    method: str = "wls",
    friction: str = "paper",
    gains: Array | None = None,
    rigid_from: Identification | None = None,
    settings: IdentifySettings | None = None,
    residual_friction: bool = False,
) -> Identification:
    """The base parameters that explain the recordings together.

    `ls` is the paper's: all samples, all joints alike. `wls` scales each joint's rows by its residual and leaves out the samples where
    that joint stands still. `robust` gives rows little weight that do not fit the rest, and repairs spikes before the filter smears them.
    `consistent` is `wls` over arms that can exist; its covariance is that of `wls`, which the bounds can only narrow.
    friction : the name of a law, or `auto`: the simplest of the laws that predicts data left out as well as the best.
    rigid_from : an earlier identification whose rigid parameters are taken as known; covariances are then under that condition.
    residual_friction : beside the law `paper`, fit the law of the residual friction for the prediction of torque.
    gains : (J,) [N·m/A] or None for the published torque constants. Raises Unidentifiable where a recording holds too little motion,
    BadInput where it does not fit the robot.
    """
    settings = settings or IdentifySettings()
    for recording in recordings:
        refuse_other_arm(recording, robot)
    _refuse_twice(recordings)
    if method == "robust":
        settings = replace(settings, signals=replace(settings.signals, despike=True))
    motions = [motion(recording, settings.signals) for recording in recordings]
    torques = [joint_torque(moved, robot, gains) for moved in motions]
    remarks = list(told.of_recordings(recordings))
    for moved, recording in zip(motions, recordings, strict=True):
        remarks += told.of_motion(moved, recording.context.payload_kg)
    contradiction = mounting_check(motions, torques, robot, mounting)
    if contradiction is not None:
        remarks.append(contradiction)
    found = identify_motions(
        motions,
        torques,
        robot,
        mounting,
        method=method,
        friction=friction,
        rigid_from=rigid_from,
        settings=settings,
        warnings=remarks,
        residual_friction=residual_friction,
    )
    return replace(found, warming_k_per_min=_warming(recordings))


def identify_motions(
    motions: Sequence[Motion],
    torques: Sequence[Array],
    robot: Robot,
    mounting: Mounting,
    *,
    method: str = "wls",
    friction: str = "paper",
    rigid_from: Identification | None = None,
    settings: IdentifySettings | None = None,
    warnings: Sequence[DataWarning] = (),
    residual_friction: bool = False,
) -> Identification:
    """`identify` from prepared signals on: torques are (N, J) [N·m] of each motion."""
    settings = settings or IdentifySettings()
    if method not in METHODS:
        raise BadInput(f"method {method!r} is not known; known are {', '.join(METHODS)}")
    law = None if friction == AUTO else friction_law(friction)
    if not motions:
        raise BadInput("identify: no recording was given; expected one or more")
    base = base_parameters(robot, mounting)
    prior = base.combination @ robot.nominal_parameters()  # (B,) only where the motion says nothing
    if rigid_from is not None:
        if rigid_from.robot != robot.name or rigid_from.columns != base.columns:
            raise BadInput(
                f"rigid_from: the parameters are of {rigid_from.robot} with {len(rigid_from.columns)} base parameters; "
                f"expected those of {robot.name} on the same kind of mounting, with {base.count}"
            )
        if method == "consistent":
            raise BadInput("method 'consistent' finds rigid parameters, and those of rigid_from are to stay; expected one or the other")
        prior = rigid_from.values
    equations = [_equations(moved, torque, robot, mounting, base, method, settings) for moved, torque in zip(motions, torques, strict=True)]
    layout = layout_of(base.columns, robot.joints, frozen=rigid_from is not None)
    held_out = None
    if law is None:
        law, held_out = choose_law(equations, layout, prior, "wls" if method == "consistent" else method)
    found = fit(equations, law, layout, prior, method="wls" if method == "consistent" else method)
    physical, free = None, found.solution
    if method == "consistent":
        found, physical = _physical(found, base, robot)
    covariance, with_misfit = _covariances(equations, found, free, layout, prior)
    unknown = ~found.solution.excited
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan

    loads = [eq.load(found.solution.values[: base.count], layout) for eq in equations]
    M, places = projection(equations, loads, found, layout), layout.of_law(law)  # (B, X): the paper's base parameters, (J, K)
    values, base_covariance = M @ found.solution.values, mapped(M, covariance)
    total = mapped(M, with_misfit)
    misfit = total - mapped(M, np.nan_to_num(covariance))
    total[np.isnan(base_covariance)] = np.nan
    if rigid_from is not None:
        values[layout.rigid] = rigid_from.values[layout.rigid]
        rigid = np.ix_(layout.rigid, layout.rigid)
        base_covariance[rigid] = total[rigid] = rigid_from.covariance[rigid]
    known = np.all(found.solution.excited[places], axis=1)  # (J,)
    pair = layout.friction[:, :, None], layout.friction[:, None, :]
    coulomb, viscous = np.where(known[:, None], values[layout.friction], np.nan).T  # (J,), (J,)

    condition = condition_number(found.joints, np.flatnonzero(~layout.rigid) if layout.frozen else np.arange(base.count))
    speeds, measured = np.concatenate([moved.qd for moved in motions]), np.concatenate(list(torques))
    predicted = measured - np.concatenate(found.residuals)
    moving = np.abs(speeds) > settings.moving_rad_s
    errors = errors_of(measured, predicted, moving)
    remarks = [*warnings, *told.of_joints(robot, speeds, moving), *told.of_robust_weights(found.rows)]
    excited = found.solution.excited[: base.count] | (layout.rigid & layout.frozen)
    remarks += told.of_solution(base.names, excited, condition, len(measured), coulomb, viscous)
    if physical is not None and physical.residual_ratio > told.FAR_FROM_PHYSICAL:
        remarks.append(told.far_from_physical(physical.residual_ratio))
    richer = None
    if law != PAPER:
        richer = FrictionFit(
            law=law,
            values=found.solution.values[places],
            covariance=covariance[places[:, :, None], places[:, None, :]],
            load_nm=mean_load(equations, loads),
        )
    return Identification(
        robot=robot.name,
        mounting=mounting,
        method=method,
        names=base.names,
        combination=base.combination,
        columns=base.columns,
        values=values,
        covariance=base_covariance,
        condition_number=condition,
        coulomb_nm=coulomb,
        viscous_nm_s_per_rad=viscous,
        friction_cov=base_covariance[pair],
        temperature_c=_mean_temperature(motions),
        max_speed_rad_s=np.max(np.abs(speeds), axis=0),
        mean_speed_rad_s=np.mean(np.abs(speeds), axis=0),
        rms_nm=errors.rms_nm,
        relative_rms=errors.relative_rms,
        rms_all_nm=errors.rms_all_nm,
        normalised_error_nm=errors.normalised_error_nm,
        samples=len(measured),
        warnings=tuple(remarks),
        sources=tuple(
            Source(m.source, m.recorded_samples, m.rate_hz, m.duration_s, m.rejected_samples, dict(m.rejected_why)) for m in motions
        ),
        friction=richer,
        total_covariance=total,
        misfit_cov=np.where(known[:, None, None], [positive(part) for part in misfit[pair]], np.nan),
        held_out=held_out,
        paper_d=np.linalg.norm((M @ found.solution.directions), axis=1),
        physical=physical,
        residual_friction=_residual_friction(equations, found, layout, prior, moving) if residual_friction and law == PAPER else None,
    )


def _refuse_twice(recordings: Sequence[Recording]) -> None:
    """Raises BadInput where one recording is given twice: it would be believed twice."""
    for number, one in enumerate(recordings):
        for other in recordings[:number]:
            if one.samples == other.samples and np.array_equal(one.t_s, other.t_s) and np.array_equal(one.q, other.q):
                raise BadInput(f"{one.source or 'recording'} is {other.source or 'recording'} once more: it says nothing new; give it once")


def _residual_friction(equations: Sequence[Equations], paper: Fit, layout: Layout, prior: Array, errors_over: Mask) -> ResidualFrictionFit:
    """The law of the residual friction on the same equations."""
    law, B = residual_law(), len(prior)
    solution, residuals = refit(equations, paper, law, layout, prior)
    values, places = solution.values, layout.of_law(law)
    loads = [np.where(eq.used, np.abs(eq.load(values[:B], layout)), 0.0) for eq in equations]
    left = np.concatenate(residuals)
    return ResidualFrictionFit(
        law=law,
        rigid=values[:B],
        friction=np.where(np.all(solution.excited[places], axis=1)[:, None], values[places], np.nan),
        load_nm=np.max(np.concatenate(loads), axis=0),
        rms_nm=errors_of(left, np.zeros_like(left), errors_over).rms_nm,
    )


def _physical(found: Fit, base: Base, robot: Robot) -> tuple[Fit, PhysicallyConsistentArm]:
    """The nearest arm that can exist, on the factors of the fit."""
    extra = found.joints[0].R.shape[1] - 1 - base.count
    combination = np.zeros((base.count + extra, base.combination.shape[1] + extra))
    combination[: base.count, : base.combination.shape[1]] = base.combination
    combination[base.count :, base.combination.shape[1] :] = np.eye(extra)
    physical = physically_consistent(found.joints, found.weights, combination, robot)
    return replace(found, solution=replace(found.solution, values=physical.values)), physical


def _equations(
    moved: Motion, torque: Array, robot: Robot, mounting: Mounting, base: Base, method: str, settings: IdentifySettings
) -> Equations:
    """The equations of one motion.

    A step of Coulomb friction beside a filtered torque would make fc too small by several of its standard deviations, and fv too large:
    the torque's filter rounds the column too.
    """
    Y = regressor(robot, mounting, moved.q, moved.qd, moved.qdd)  # (N, J, P)
    joints = np.arange(robot.joints)
    Y[:, joints, friction_columns(robot.joints)[0]] = moved.direction
    Y = Y[:, :, list(base.columns)]  # (N, J, B)
    used = np.ones(torque.shape, dtype=bool) if method == "ls" else moved.moving(settings.moving_rad_s)
    return Equations(motion=moved, Y=Y, torque_nm=torque, used=used, steps=moved.blocks(settings.block_s / WINDOW_STEPS))


def _covariances(equations: Sequence[Equations], found: Fit, free: Solution, layout: Layout, prior: Array) -> tuple[Array, Array]:
    """Covariance of the unknowns (X, X) by noise alone, and by noise and misfit together; `free` knows nothing of arms that can exist."""
    upright, noise = with_causes(equations, found, layout, prior)
    alone, together = jackknife_covariances(found.rows, found.weights, found.solution, [noise, found.residuals])
    inflation = robust_inflation(found) ** 2
    # a law that lacks something leans on the masses, the same way at every replay; friction's own parameters are what this law makes of it
    leaning, B = np.zeros(len(free.values)), len(prior)
    leaning[:B] = np.where(layout.rigid & upright.excited[:B], free.values[:B] - upright.values[:B], 0.0)
    return alone * inflation, together * inflation + np.outer(leaning, leaning)


def _warming(recordings: Sequence[Recording]) -> Array | None:
    """(J,) slope of temperature over time [K/min], the recordings' mean; None where one of them does not tell it."""
    slopes = []
    for recording in recordings:
        if recording.temperature_c is None:
            return None
        good = np.isfinite(recording.t_s) & np.all(np.isfinite(recording.temperature_c), axis=1)
        t = recording.t_s[good] - np.mean(recording.t_s[good]) if good.any() else np.zeros(0)
        if len(t) < 2 or not np.ptp(t) > 0:
            return None
        slopes.append(60.0 * (t @ recording.temperature_c[good]) / (t @ t))
    mean: Array = np.mean(slopes, axis=0)
    return mean


def _mean_temperature(motions: Sequence[Motion]) -> Array | None:
    """(J,) over all samples of all motions, or None where one of them did not measure it."""
    measured = [moved.temperature_c for moved in motions if moved.temperature_c is not None]
    if len(measured) < len(motions):
        return None
    mean: Array = np.mean(np.concatenate(measured), axis=0)
    return mean
