"""Identification: the parameters that explain a recording, and how sure we are of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify import caveats as told
from monitor.identify.caveats import Caveat
from monitor.identify.fit import Equations, Fit, Layout, fit, layout_of, noise, robust_inflation
from monitor.identify.least_squares import WINDOW_STEPS, condition_number, jackknife_covariances
from monitor.identify.mounting import mounting_check
from monitor.identify.projection import mapped, mean_load, positive, projection
from monitor.identify.selection import AUTO, choose_law
from monitor.identify.signals import STANDSTILL_SPEED_RAD_S, Mask, Motion, SignalSettings, motion
from monitor.identify.torque import joint_torque
from monitor.model.base import Base, base_parameters
from monitor.model.friction import LAWS, FrictionLaw, friction_law
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, Recording

__all__ = [
    "Caveat", "FrictionFit", "Identification", "IdentifySettings", "Source", "TorqueParts", "Validation",
    "identify", "identify_motions", "predict_torque", "validate",
]  # fmt: skip

METHODS = ("ls", "wls", "robust")


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifySettings:
    """How a motion becomes parameters."""

    signals: SignalSettings = field(default_factory=SignalSettings)
    moving_rad_s: float = STANDSTILL_SPEED_RAD_S  # slower samples of a joint are not fitted by WLS, nor counted in the RMS
    block_s: float = 0.8  # residuals stay correlated for 0.4–0.55 s: blocks must be longer, and still be many


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
class FrictionFit:
    """Friction by a law richer than the paper's."""

    law: FrictionLaw
    values: Array  # (J, K) in the order of `law.parameters`
    covariance: Array  # (J, K, K); NaN where the motion did not excite it
    load_nm: Array  # (J,) mean torque through the gear while the joint moved

    def at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """Friction torque at a positive speed under the recording's mean load, and its standard deviation, each (J,) [N·m]."""
        x = self.law.columns(np.full(len(self.load_nm), speed_rad_s), self.load_nm)  # (J, K)
        return np.einsum("jk,jk->j", x, self.values), np.sqrt(np.einsum("ji,jik,jk->j", x, self.covariance, x))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """What one recording, or several together, say about one arm.

    Whatever the friction law, fc and fv are those of the paper: the line fc·s(q̇) + fv·q̇ nearest to the law over the speeds and loads of
    the recording, so that they may be compared with any other. `values` contains them too. Covariances are of noise: how far another
    recording of the same motion would come out. What another motion would change because the law is not quite the arm's is `misfit_cov`.
    """

    robot: str
    mounting: Mounting
    method: str  # "ls" | "wls" | "robust"
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
    friction: FrictionFit | None = None  # None: the paper's law, fc and fv say all
    misfit_cov: Array | None = None  # (J, 2, 2) of (fc, fv), to be added to `friction_cov` to compare different motions
    held_out: Mapping[str, float] | None = None  # law → RMS over the noise of data left out, where the law was chosen by it

    @property
    def law(self) -> FrictionLaw:
        """The friction law."""
        return self.friction.law if self.friction else LAWS["paper"]

    @property
    def std(self) -> Array:
        """(B,) standard deviation of each base parameter; NaN where the motion did not excite it."""
        deviation: Array = np.sqrt(np.diag(self.covariance))
        return deviation

    def friction_at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """Friction torque by the law at a positive speed (and mean load), and its standard deviation, each (J,) [N·m]."""
        if self.friction:
            return self.friction.at(speed_rad_s)
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
    friction: str = "paper",
    gains: Array | None = None,
    rigid_from: Identification | None = None,
    settings: IdentifySettings | None = None,
) -> Identification:
    """The base parameters that explain the recordings together.

    `ls` is the paper's: all samples, all joints alike. `wls` scales each joint's rows by its residual and leaves out the samples where
    that joint stands still. `robust` gives rows little weight that do not fit the rest, and repairs spikes before the filter smears them.
    friction : `paper`, `load`, `concave`, or `auto`, which takes the simplest of them that predicts data left out as well as the best.
    rigid_from : an earlier identification whose rigid parameters are taken as known; covariances are then under that condition.
    gains : (J,) [N·m/A] or None for the published torque constants. Raises Unidentifiable where a recording holds too little motion,
    BadInput where it does not fit the robot.
    """
    settings = settings or IdentifySettings()
    for recording in recordings:
        _refuse_other_arm(recording, robot)
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
    return identify_motions(
        motions, torques, robot, mounting, method=method, friction=friction, rigid_from=rigid_from, settings=settings, caveats=remarks
    )


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
    caveats: Sequence[Caveat] = (),
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
        prior = rigid_from.values
    equations = [_equations(moved, torque, robot, mounting, base, method, settings) for moved, torque in zip(motions, torques, strict=True)]
    layout = layout_of(base.columns, robot.joints, frozen=rigid_from is not None)
    held_out = None
    if law is None:
        law, held_out = choose_law(equations, layout, prior, method)
    found = fit(equations, law, layout, prior, method=method)
    covariance, with_misfit = _covariances(equations, found, layout, prior)
    unknown = ~found.solution.excited
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan

    loads = [eq.load(found.solution.values[: base.count], layout) for eq in equations]
    M, places = projection(equations, loads, found, layout), layout.of_law(law)  # (B, X): the paper's base parameters, (J, K)
    values, base_covariance = M @ found.solution.values, mapped(M, covariance)
    misfit = mapped(M, with_misfit) - mapped(M, np.nan_to_num(covariance))
    if rigid_from is not None:
        values[layout.rigid] = rigid_from.values[layout.rigid]
        rigid = np.ix_(layout.rigid, layout.rigid)
        base_covariance[rigid] = rigid_from.covariance[rigid]
    known = np.all(found.solution.excited[places], axis=1)  # (J,)
    pair = layout.friction[:, :, None], layout.friction[:, None, :]
    coulomb, viscous = np.where(known[:, None], values[layout.friction], np.nan).T  # (J,), (J,)

    condition = condition_number(found.joints, np.flatnonzero(~layout.rigid) if layout.frozen else np.arange(base.count))
    speeds, measured = np.concatenate([moved.qd for moved in motions]), np.concatenate(list(torques))
    predicted = measured - np.concatenate(found.residuals)
    moving = np.abs(speeds) > settings.moving_rad_s
    errors = _errors(measured, predicted, moving)
    remarks = [*caveats, *told.of_joints(robot, speeds, moving), *told.of_trust(found.rows)]
    excited = found.solution.excited[: base.count] | (layout.rigid & layout.frozen)
    remarks += told.of_solution(base.names, excited, condition, len(measured), coulomb, viscous)
    richer = None
    if law != LAWS["paper"]:
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
        rms_nm=errors.rms_nm,
        relative_rms=errors.relative_rms,
        rms_all_nm=errors.rms_all_nm,
        normalised_error_nm=errors.normalised_error_nm,
        samples=len(measured),
        caveats=tuple(remarks),
        sources=tuple(
            Source(m.source, m.recorded_samples, m.rate_hz, m.duration_s, m.rejected_samples, dict(m.rejected_why)) for m in motions
        ),
        friction=richer,
        misfit_cov=np.where(known[:, None, None], [positive(part) for part in misfit[pair]], np.nan),
        held_out=held_out,
    )


def predict_torque(identification: Identification, robot: Robot, q: Array, qd: Array, qdd: Array) -> TorqueParts:
    """Torque that the identified model expects at states q, q̇, q̈ (N, J) [rad, rad/s, rad/s²]."""
    if robot.name != identification.robot:
        raise BadInput(f"the parameters are of {identification.robot}, the robot is {robot.name}")
    Y = regressor(robot, identification.mounting, q, qd, qdd)[:, :, list(identification.columns)]  # (N, J, B)
    layout = layout_of(identification.columns, robot.joints)
    rigid = Y @ np.where(layout.rigid, identification.values, 0.0)
    if identification.friction:
        columns = identification.law.columns(qd, Y @ np.where(layout.load, identification.values, 0.0))  # (N, J, K)
        friction: Array = np.einsum("njk,jk->nj", columns, identification.friction.values)
    else:
        friction = Y @ np.where(layout.rigid, 0.0, identification.values)
    return TorqueParts(rigid + friction, rigid, friction)


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


def _covariances(equations: Sequence[Equations], found: Fit, layout: Layout, prior: Array) -> tuple[Array, Array]:
    """Covariance of the unknowns (X, X) by noise alone, and by noise and misfit together."""
    opinions = [noise(equations, found, layout, prior), found.residuals]
    alone, together = jackknife_covariances(found.rows, found.weights, found.solution, opinions)
    inflation = robust_inflation(found) ** 2
    return alone * inflation, together * inflation


def _mean_temperature(motions: Sequence[Motion]) -> Array | None:
    """(J,) over all samples of all motions, or None where one of them did not measure it."""
    measured = [moved.temperature_c for moved in motions if moved.temperature_c is not None]
    if len(measured) < len(motions):
        return None
    mean: Array = np.mean(np.concatenate(measured), axis=0)
    return mean
