"""Identification: the parameters that explain recordings, and how sure they are. It joins the steps of the sub-rooms."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify import warnings as remarks_on
from monitor.identify.diagnosis import REFERENCE_RAD_S, diagnose
from monitor.identify.fit.covariance import Causes, covariances, law_doubt, mapped, positive
from monitor.identify.fit.fit import Fit, FitProblem, choose_law, equations_of, first_fit, fit, layout_of, mean_load, projection, refit
from monitor.identify.fit.least_squares import Solution, best_condition, condition_number, together
from monitor.identify.fit.physically_consistent import PhysicallyConsistentArm, physically_consistent
from monitor.identify.gain_check import gain_warnings
from monitor.identify.identification import QUOTED_SPEEDS_RAD_S, FrictionFit, Identification, ResidualFrictionFit, Source
from monitor.identify.mounting import mounting_check
from monitor.identify.settings import IdentifySettings
from monitor.identify.signals.motion import Motion, at_motors, joint_torque, mean_temperature, refuse_other_arm, refuse_twice, warming
from monitor.identify.signals.ripple import combined, gear_ripple
from monitor.identify.signals.rows import along_samples
from monitor.identify.signals.same_motion import motions_of
from monitor.identify.validate import errors_of, residual_peak
from monitor.model.base import Base, base_parameters
from monitor.model.friction import AUTO, PAPER, friction_law, residual_law
from monitor.model.robot import Mounting, Robot
from monitor.reason import Reason
from monitor.recording import Array, Mask, Recording

METHODS = ("ls", "wls", "robust", "consistent")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentifyOptions:
    """What is fitted, and how; each as `identify` describes it."""

    method: str = "wls"
    friction: str = PAPER.name
    rigid_from: Identification | None = None
    settings: IdentifySettings = field(default_factory=IdentifySettings)
    residual_friction: bool = False

    @property
    def least_squares(self) -> str:
        """The method by which equations are solved: `consistent` is `wls`, moved to a physically consistent arm afterwards."""
        return "wls" if self.method == "consistent" else self.method


def identify(
    recordings: Sequence[Recording],
    robot: Robot,
    mounting: Mounting,
    *,
    method: str = "wls",
    friction: str = PAPER.name,
    gains: Array | None = None,
    rigid_from: Identification | None = None,
    settings: IdentifySettings | None = None,
    residual_friction: bool = False,
) -> Identification:
    """The base parameters that explain the recordings together.

    method : `ls` is the paper's: all samples, all joints with one weight. `wls` divides each joint's rows by its residual and leaves out
    the samples in which that joint stands still. `robust` gives little weight to rows that do not fit the rest, and repairs single spikes
    before the filter. `consistent` is `wls` over physically consistent arms; its covariance is that of `wls`, which the bounds could only
    make smaller.
    friction : the name of a law in `model.friction`, or `auto`: the simplest of the laws that predicts data left out as well as the best.
    gains : (J,) torque per ampere [N·m/A]; None for the published torque constants.
    rigid_from : an earlier identification whose rigid parameters are taken as known; covariances are then conditional on them.
    residual_friction : with the law `paper`, also fit the law of the residual friction, for the prediction of torque.
    Raises BadInput where an argument is wrong or a recording does not fit the robot, Unidentifiable where it holds too little motion.
    """
    settings = settings or IdentifySettings()
    for recording in recordings:
        refuse_other_arm(recording, robot)
    refuse_twice(recordings)
    if method == "robust":
        settings = replace(settings, signals=replace(settings.signals, despike=True))
    recordings = [along_samples(at_motors(recording, robot)) for recording in recordings]
    motions = motions_of(recordings, settings.signals)
    torques = [joint_torque(moved, robot, gains) for moved in motions]
    warnings = list(remarks_on.of_recordings(recordings))
    for moved, recording in zip(motions, recordings, strict=True):
        warnings += remarks_on.of_motion(moved, recording.context.payload_kg)
    contradiction = mounting_check(motions, torques, robot, mounting)
    if contradiction is not None:
        warnings.append(contradiction)
    options = IdentifyOptions(
        method=method, friction=friction, rigid_from=rigid_from, settings=settings, residual_friction=residual_friction
    )
    found = identify_motions(motions, torques, robot, mounting, options, warnings)
    ripples = [gear_ripple(moved.unfiltered, robot.gear_ratio, moved.rate_hz) for moved in motions]
    return replace(found, warming_k_per_min=warming(recordings), ripple=combined(ripples))


def identify_motions(
    motions: Sequence[Motion],
    torques: Sequence[Array],
    robot: Robot,
    mounting: Mounting,
    options: IdentifyOptions | None = None,
    warnings: Sequence[Reason] = (),
) -> Identification:
    """`identify` from prepared signals on.

    torques : (N, J) [N·m] of each motion. warnings : what is already known; the result repeats them before its own.
    """
    options = options or IdentifyOptions()
    _refuse_unknown_names(options)
    if not motions:
        raise BadInput("identify: no recording was given; expected one or more")
    base = base_parameters(robot, mounting)
    problem = _problem(motions, torques, robot, mounting, base, options)
    held_out, start = None, first_fit(problem, options.least_squares)
    if options.friction == AUTO:
        law, held_out = choose_law(problem, options.least_squares, start)
    else:
        law = friction_law(options.friction)
    found = fit(problem, law, method=options.least_squares, start=start)
    physical, free = None, found.solution
    if options.method == "consistent":
        found, physical = _physical(found, base, robot)
    causes = Causes(problem, found, problem.redundancy)
    paper = _paper_parameters(problem, found, free, causes, options.rigid_from)
    speeds, measured = np.concatenate([moved.qd for moved in motions]), np.concatenate(list(torques))
    moves = [moved.moving(options.settings.moving_rad_s) for moved in motions]
    moving = np.concatenate(moves)
    errors = errors_of(measured, measured - np.concatenate(found.residuals), moving)
    fitted = np.flatnonzero(~problem.layout.rigid) if problem.layout.frozen else np.arange(base.count)
    Y = together(found.joints)
    own_warnings = [*remarks_on.of_joints([moved.qd for moved in motions], moves), *remarks_on.of_robust_weights(found.rows)]
    excited = found.solution.excited[: base.count] | (problem.layout.rigid & problem.layout.frozen)
    own_warnings += remarks_on.of_solution(
        base.names,
        excited,
        best_condition(Y, base.combination, fitted),
        len(measured),
        paper.coulomb_nm,
        paper.viscous_nm_s_per_rad,
    )
    own_warnings += diagnose(
        problem,
        found,
        causes,
        robot,
        nominal=base.combination @ robot.nominal_parameters(),
        friction_nm=paper.coulomb_nm + REFERENCE_RAD_S * paper.viscous_nm_s_per_rad,
        relative_rms=errors.relative_rms,
    )
    if not any(warning.code in ("poor_fit", "gain_doubtful") for warning in own_warnings):
        own_warnings += gain_warnings(problem, found, causes, robot, mounting, base)
    if physical is not None and physical.residual_ratio > remarks_on.FAR_FROM_PHYSICAL:
        own_warnings.append(remarks_on.far_from_physical(physical.residual_ratio))
    return Identification(
        robot=robot.name,
        mounting=mounting,
        method=options.method,
        names=base.names,
        combination=base.combination,
        columns=base.columns,
        condition_number=condition_number(Y, fitted),
        temperature_c=mean_temperature(motions),
        max_speed_rad_s=np.max(np.abs(speeds), axis=0),
        mean_speed_rad_s=np.mean(np.abs(speeds), axis=0),
        residual_peak_rad=residual_peak(np.concatenate([moved.q for moved in motions]), np.concatenate(found.residuals), moving),
        rms_nm=errors.rms_nm,
        relative_rms=errors.relative_rms,
        rms_all_nm=errors.rms_all_nm,
        normalised_error_nm=errors.normalised_error_nm,
        samples=len(measured),
        warnings=(*warnings, *own_warnings),
        sources=tuple(_source(moved) for moved in motions),
        held_out=held_out,
        physical=physical,
        residual_friction=_residual_friction(problem, found, moving) if options.residual_friction and law == PAPER else None,
        **paper._asdict(),
    )


def _refuse_unknown_names(options: IdentifyOptions) -> None:
    """Raises BadInput where the method or the friction law is not known."""
    if options.method not in METHODS:
        raise BadInput(f"method {options.method!r} is not known; known are {', '.join(METHODS)}")
    if options.friction != AUTO:
        friction_law(options.friction)


def _problem(
    motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, mounting: Mounting, base: Base, options: IdentifyOptions
) -> FitProblem:
    """The equations of all motions with their prior.

    The prior is the manufacturer's masses, which count only where the motion reveals nothing, or the rigid parameters of `rigid_from`.
    Raises BadInput where those are of another robot or kind of mounting, or are to be fitted as well.
    """
    known = options.rigid_from
    if known is not None:
        if known.robot != robot.name or known.columns != base.columns:
            raise BadInput(
                f"rigid_from: the parameters are of {known.robot} with {len(known.columns)} base parameters; "
                f"expected those of {robot.name} on the same kind of mounting, with {base.count}"
            )
        if options.method == "consistent":
            raise BadInput("method 'consistent' finds rigid parameters, and those of rigid_from are to stay; expected one or the other")
    settings, all_rows = options.settings, options.method == "ls"
    return FitProblem(
        equations=[
            equations_of(
                moved, torque, robot, mounting, base, all_rows=all_rows, moving_rad_s=settings.moving_rad_s, block_s=settings.block_s
            )
            for moved, torque in zip(motions, torques, strict=True)
        ],
        layout=layout_of(base.columns, robot.joints, frozen=known is not None),
        prior=base.combination @ robot.nominal_parameters() if known is None else known.values,
    )


def _physical(found: Fit, base: Base, robot: Robot) -> tuple[Fit, PhysicallyConsistentArm]:
    """The physically consistent arm nearest to the fit, and the fit with its parameters."""
    extra = found.joints[0].R.shape[1] - 1 - base.count
    combination = np.zeros((base.count + extra, base.combination.shape[1] + extra))
    combination[: base.count, : base.combination.shape[1]] = base.combination
    combination[base.count :, base.combination.shape[1] :] = np.eye(extra)
    physical = physically_consistent(found.joints, found.weights, combination, robot)
    return replace(found, solution=replace(found.solution, values=physical.values)), physical


class _PaperParameters(NamedTuple):
    """The fit in the base parameters of the paper; the fields are those of `Identification`."""

    values: Array
    covariance: Array
    coulomb_nm: Array
    viscous_nm_s_per_rad: Array
    friction_cov: Array
    friction: FrictionFit | None
    total_covariance: Array
    misfit_cov: Array
    paper_d: Array


def _paper_parameters(
    problem: FitProblem, found: Fit, free: Solution, causes: Causes, rigid_from: Identification | None
) -> _PaperParameters:
    """The paper's base parameters and their covariances, whatever the friction law. free, causes : as in `covariances`."""
    layout, solution = problem.layout, found.solution
    sure = covariances(problem, found, free, causes)
    covariance = sure.noise
    unknown = ~solution.excited
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan
    richer_law = found.law != PAPER  # a line needs no load
    loads = [eq.load(solution.values[: len(problem.prior)], layout) for eq in problem.equations] if richer_law else []
    M, places = projection(problem, loads, found), layout.of_law(found.law)  # (B, X), (J, K)
    values, base_covariance, total = M @ solution.values, mapped(M, covariance), mapped(M, sure.with_misfit)
    misfit = mapped(M, sure.lasting) - mapped(M, np.nan_to_num(covariance))
    total[np.isnan(base_covariance)] = np.nan
    if rigid_from is not None:
        values[layout.rigid] = rigid_from.values[layout.rigid]
        rigid = np.ix_(layout.rigid, layout.rigid)
        base_covariance[rigid] = total[rigid] = rigid_from.covariance[rigid]
    known = np.all(solution.excited[places], axis=1)  # (J,)
    pair = layout.friction[:, :, None], layout.friction[:, None, :]
    coulomb, viscous = np.where(known[:, None], values[layout.friction], np.nan).T  # (J,), (J,)
    speeds = np.max([np.max(np.abs(eq.motion.qd), axis=0) for eq in problem.equations], axis=0)  # (J,)
    off = law_doubt(problem, sure.upright, values[layout.friction], QUOTED_SPEEDS_RAD_S)  # (J,) [N·m]
    another = np.array([off_nm**2 * np.diag([1.0, 1.0 / max(speed, 0.1) ** 2]) for off_nm, speed in zip(off, speeds, strict=True)])
    richer = None
    if richer_law:
        richer = FrictionFit(
            law=found.law,
            values=solution.values[places],
            covariance=covariance[places[:, :, None], places[:, None, :]],
            load_nm=mean_load(problem, loads),
        )
    return _PaperParameters(
        values=values,
        covariance=base_covariance,
        coulomb_nm=coulomb,
        viscous_nm_s_per_rad=viscous,
        friction_cov=base_covariance[pair],
        friction=richer,
        total_covariance=total,
        misfit_cov=np.where(known[:, None, None], positive(misfit[pair]) + another, np.nan),
        paper_d=np.linalg.norm((M @ solution.directions), axis=1),
    )


def _residual_friction(problem: FitProblem, paper: Fit, moving: Mask) -> ResidualFrictionFit:
    """The law of the residual friction on the same equations. moving : (N, J) the samples of all motions whose residual counts."""
    law, B = residual_law(), len(problem.prior)
    solution, residuals = refit(problem, paper, law)
    values, places = solution.values, problem.layout.of_law(law)
    loads = [np.where(eq.used, np.abs(eq.load(values[:B], problem.layout)), 0.0) for eq in problem.equations]
    left = np.concatenate(residuals)
    return ResidualFrictionFit(
        law=law,
        rigid=values[:B],
        friction=np.where(np.all(solution.excited[places], axis=1)[:, None], values[places], np.nan),
        load_nm=np.max(np.concatenate(loads), axis=0),
        rms_nm=errors_of(left, np.zeros_like(left), moving).rms_nm,
    )


def _source(moved: Motion) -> Source:
    return Source(
        file=moved.source,
        samples=moved.recorded_samples,
        rate_hz=moved.rate_hz,
        duration_s=moved.duration_s,
        rejected_samples=moved.rejected_samples,
        rejected_why=dict(moved.rejected_why),
    )
