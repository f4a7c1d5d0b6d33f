"""Identification: the parameters that explain recordings, and how sure they are. It joins the steps of the sub-rooms."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from monitor.errors import BadInput
from monitor.identify.detectors import Together, warnings_of
from monitor.identify.diagnosis import Fitted
from monitor.identify.fit.covariance import Causes
from monitor.identify.fit.fit import Fit, FitProblem, choose_law, first_fit, fit, problem_of
from monitor.identify.fit.least_squares import condition_number
from monitor.identify.fit.physically_consistent import physical_fit
from monitor.identify.identification import Identification, Source
from monitor.identify.parameters import paper_parameters, residual_friction
from monitor.identify.settings import IdentifySettings, SignalSettings
from monitor.identify.signals.arm import joint_torque, motions_of
from monitor.identify.signals.motion import Motion
from monitor.identify.signals.ripple import combined, current_noise, gear_ripple
from monitor.identify.signals.temperature import constant, mean_temperature, warming
from monitor.identify.validate import errors_of, residual_peak
from monitor.model.base import Base, base_parameters
from monitor.model.friction import AUTO, PAPER, friction_law
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, Recording

METHODS = ("ls", "wls", "robust", "consistent")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentifyOptions:
    """What is fitted, and how; each as `identify` describes it."""

    method: str = "wls"
    friction: str = PAPER.name
    rigid_from: Identification | None = None
    settings: IdentifySettings = field(default_factory=IdentifySettings)
    residual_friction: bool = False

    def __post_init__(self) -> None:
        """Raises BadInput where the method or the friction law is not known."""
        if self.method not in METHODS:
            raise BadInput(f"method {self.method!r} is not known; known are {', '.join(METHODS)}")
        if self.friction != AUTO:
            friction_law(self.friction)
        if self.method == "consistent" and self.rigid_from is not None:
            raise BadInput("method 'consistent' finds rigid parameters, and those of rigid_from are to stay; expected one or the other")

    @property
    def least_squares(self) -> str:
        """The method by which equations are solved: `consistent` is `wls`, moved to a physically consistent arm afterwards."""
        return "wls" if self.method == "consistent" else self.method

    @property
    def signals(self) -> SignalSettings:
        """How recordings become motions: for `robust` without single spikes."""
        return replace(self.settings.signals, despike=True) if self.method == "robust" else self.settings.signals


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
    options = IdentifyOptions(
        method=method,
        friction=friction,
        rigid_from=rigid_from,
        settings=settings or IdentifySettings(),
        residual_friction=residual_friction,
    )
    motions = motions_of(recordings, robot, options.signals)
    torques = [joint_torque(moved, robot, gains) for moved in motions]
    found = identify_motions(motions, torques, robot, mounting, options)
    ripple = combined([gear_ripple(moved.unfiltered, robot.gear_ratio, moved.rate_hz) for moved in motions])
    gain = robot.drive_gain_nm_per_a if gains is None else gains
    of_signals = [warning for moved in motions for value in (moved.repaired, moved) for warning in warnings_of(value)]
    return replace(
        found,
        warnings=(*warnings_of(Together(recordings)), *of_signals, *found.warnings),
        warming_k_per_min=warming(recordings),
        temperature_constant=constant(recordings),
        current_noise_a=current_noise([moved.unfiltered for moved in motions]),
        ripple=None if ripple is None else ripple._replace(gain_nm_per_a=gain),
    )


def identify_motions(
    motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, mounting: Mounting, options: IdentifyOptions | None = None
) -> Identification:
    """`identify` from prepared signals on. torques : (N, J) [N·m] of each motion."""
    options = options or IdentifyOptions()
    if not motions:
        raise BadInput("identify: no recording was given; expected one or more")
    base = base_parameters(robot, mounting)
    rigid = None if options.rigid_from is None else _known_rigid(options.rigid_from, robot, base)
    problem = problem_of(motions, torques, robot, mounting, base, options.settings, all_rows=options.method == "ls", rigid=rigid)
    found, held_out = _fit(problem, options)
    found, physical = (found, None) if options.method != "consistent" else physical_fit(found, base, robot)
    causes = Causes(problem, found, problem.redundancy)
    paper = paper_parameters(problem, found, causes, options.rigid_from)
    moving = [moved.moving(options.settings.moving_rad_s) for moved in motions]
    q, qd = (np.concatenate([getattr(moved, name) for moved in motions]) for name in ("q", "qd"))
    torque, residual, on = (np.concatenate(list(each)) for each in (torques, found.residuals, moving))
    errors = errors_of(torque, torque - residual, on)
    fitted = Fitted(
        problem=problem,
        found=found,
        causes=causes,
        robot=robot,
        mounting=mounting,
        base=base,
        moving=moving,
        friction=np.stack([paper.coulomb_nm, paper.viscous_nm_s_per_rad], axis=1),
        relative_rms=errors.relative_rms,
        residual_ratio=None if physical is None else physical.residual_ratio,
    )
    return Identification(
        robot=robot.name,
        mounting=mounting,
        method=options.method,
        names=base.names,
        combination=base.combination,
        columns=base.columns,
        condition_number=condition_number(fitted.Y, fitted.fitted_base),
        temperature_c=mean_temperature([moved.temperature_c for moved in motions]),
        max_speed_rad_s=np.max(np.abs(qd), axis=0),
        mean_speed_rad_s=np.mean(np.abs(qd), axis=0),
        residual_peak_rad=residual_peak(q, residual, on),
        rms_nm=errors.rms_nm,
        relative_rms=errors.relative_rms,
        rms_all_nm=errors.rms_all_nm,
        normalised_error_nm=errors.normalised_error_nm,
        samples=len(torque),
        warnings=tuple(warnings_of(fitted)),
        sources=tuple(_source(moved) for moved in motions),
        held_out=held_out,
        physical=physical,
        residual_friction=residual_friction(problem, found, on) if options.residual_friction and found.law == PAPER else None,
        **paper._asdict(),
    )


def _fit(problem: FitProblem, options: IdentifyOptions) -> tuple[Fit, Mapping[str, float] | None]:
    """The fit of the law that is asked for; with `auto` also the error of each law on data left out."""
    start, held_out = first_fit(problem, options.least_squares), None
    if options.friction == AUTO:
        law, held_out = choose_law(problem, options.least_squares, start)
    else:
        law = friction_law(options.friction)
    return fit(problem, law, method=options.least_squares, start=start), held_out


def _known_rigid(known: Identification, robot: Robot, base: Base) -> Array:
    """(B,) the parameters of an identification that are to stay. Raises BadInput where it is of another robot or kind of mounting."""
    if known.robot != robot.name or known.columns != base.columns:
        raise BadInput(
            f"rigid_from: the parameters are of {known.robot} with {len(known.columns)} base parameters; "
            f"expected those of {robot.name} on the same kind of mounting, with {base.count}"
        )
    return known.values


def _source(moved: Motion) -> Source:
    return Source(
        file=moved.source,
        samples=moved.recording.samples,
        rate_hz=moved.rate_hz,
        duration_s=moved.duration_s,
        rejected_samples=moved.rejected_samples,
        rejected_why=moved.rejected_why,
    )
