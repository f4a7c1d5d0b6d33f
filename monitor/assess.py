"""Recording, belief → assessment: the whole flow as one function. Daemon, commands, tests and studies all call this one."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.identification import Identification, IdentifySettings
from monitor.identify.identify import identify
from monitor.identify.signals.quality import QualitySettings, quality_problem
from monitor.identify.warnings import DataWarning
from monitor.judge.alerts.documents import alert_document
from monitor.judge.alerts.health import Health, Transition
from monitor.judge.alerts.remaining_life import PrognosisSettings, RemainingLife, remaining_life
from monitor.judge.alerts.rules import judge
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.belief import Belief
from monitor.judge.document import plain
from monitor.judge.drift.contexts import differences, with_lasting_declarations
from monitor.judge.drift.observation import observe
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.single_replay import single_torque_nm
from monitor.judge.learn import begin, learn
from monitor.judge.temperature.curves import LAWS
from monitor.judge.temperature.laws import Line, TemperatureSettings
from monitor.judge.torque import prediction_error
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.judge.torque.compensation import build_model
from monitor.judge.torque.evaluation import measure_prediction_error
from monitor.judge.torque.production_residual import ResidualSettings
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, Context, Recording

LAW_POINTS = 9  # of a temperature law that is told


@dataclass(frozen=True, slots=True, kw_only=True)
class AssessSettings:
    """The settings of every room on the way."""

    method: str = "wls"
    trust: QualitySettings = field(default_factory=QualitySettings)
    identify: IdentifySettings = field(default_factory=IdentifySettings)
    drift: DriftSettings = field(default_factory=DriftSettings)
    temperature: TemperatureSettings = field(default_factory=TemperatureSettings)
    health: HealthSettings = field(default_factory=HealthSettings)
    prognosis: PrognosisSettings = field(default_factory=PrognosisSettings)
    residual: ResidualSettings = field(default_factory=ResidualSettings)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointFriction:
    """One joint after one replay, with the names that are published; None where it is unknown."""

    joint: int  # 1…J
    coulomb_nm: float | None  # of this replay, at its temperature
    coulomb_std_nm: float | None  # what one replay differs from the next included
    viscous_nm_s_per_rad: float | None
    viscous_std_nm_s_per_rad: float | None
    temperature_c: float | None
    reference_speed_rad_s: float
    reference_temperature_c: float
    reference_torque_nm: float | None  # F(v*, T0), all replays considered
    reference_torque_std_nm: float | None
    wear: float  # fraction of friction torque since the beginning
    wear_std: float
    wear_rate_per_day: float  # of a usual day of work
    wear_rate_std_per_day: float
    remaining_life: RemainingLife
    revolutions: float | None  # counted until this replay
    revolutions_per_day: float | None  # usual
    remaining_revolutions: tuple[float | None, float | None, float | None]  # P10, P50, P90 of remaining life, in use
    replay_torque_nm: float | None  # F(v*, T0) of this replay alone
    replay_torque_std_nm: float | None  # what one replay differs from the next included


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTemperature:
    """What has been learnt of one joint's fv(T), wear divided out."""

    joint: int
    law: str  # of fv, where it erred least on temperatures left out: linear | exponential | vogel; the rest is always the paper's line
    held_out: dict[str, float | None]  # law → RMS error of fv on temperatures left out [N·m·s/rad]
    reference_temperature_c: float
    viscous_nm_s_per_rad: float | None  # at the reference temperature
    viscous_std_nm_s_per_rad: float | None
    slope_nm_s_per_rad_k: float
    slope_std_nm_s_per_rad_k: float
    coulomb_nm: float | None
    coulomb_std_nm: float | None
    coulomb_law: str
    coulomb_slope_nm_per_k: float
    coulomb_slope_std_nm_per_k: float
    coulomb_depends: bool  # on temperature, by more than two standard deviations
    range_c: tuple[float, float] | None  # coldest and warmest replay
    change: float | None  # of fv over that range, fraction; Raviola et al. (2021), table 4
    torque_change_mean_nm: float | None  # what that change makes of joint torque over the replay's motion; tables 5–7
    torque_change_max_nm: float | None  # at its fastest
    friction_slope_per_k: float  # β of the filter: log F(v*) per kelvin
    viscous_by_temperature: tuple[tuple[float, float, float], ...]  # °C, fv, its std: along `law` over the range; by it torque is foreseen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessment:
    """Everything one replay has told."""

    robot: str
    recorded_at_unix_s: float
    source: str
    identification: Identification
    friction: tuple[JointFriction, ...]
    temperature: tuple[JointTemperature, ...]
    belief: Belief
    health: Health
    transitions: tuple[Transition, ...]
    model: CompensatedModel
    warnings: tuple[DataWarning, ...]

    def as_document(self) -> dict[str, Any]:
        """What is told of this replay, plain JSON; belief and model have documents of their own."""
        return {
            "robot": self.robot,
            "recorded_at_unix_s": self.recorded_at_unix_s,
            "file": self.source,
            "replays": self.belief.replays,
            "health": {"arm": self.health.state, "joints": [joint.state for joint in self.health.joints]},
            "why": {"arm": self.health.why, "joints": [joint.why for joint in self.health.joints]},
            "alerts": [alert_document(alert) for alert in self.health.active_alerts],
            "friction": plain(self.friction),
            "temperature": plain(self.temperature),
            "contexts": plain(self.belief.contexts),
            "warnings": [plain(warning) for warning in self.warnings],
        }


class Rejected(NamedTuple):
    """A replay not worth learning from: not an error, so it is stored and told."""

    reason: str


def assess(
    recording: Recording,
    *,
    robot: Robot,
    mounting: Mounting,
    belief: Belief | None,
    health: Health | None,
    gains: Array | None = None,
    settings: AssessSettings | None = None,
    model: CompensatedModel | None = None,
) -> Assessment | Rejected:
    """One recording's verdict, and the belief and health to hand in with the next one.

    model : as it was held before. How far it was off tells the next one how sure it may be; verdicts do not depend on it.
    gains : (J,) [N·m/A] or None for the published torque constants. A recording without enough motion, without a time or older
    than the belief is Rejected; BadInput is raised where recording, robot and belief do not belong together.
    """
    settings = settings or AssessSettings()
    refused = _refusal(recording.context.recorded_at_unix_s, belief)
    if refused:
        return refused
    why_not = quality_problem(recording.quality, recording.samples, settings.trust)
    if why_not is not None:
        return Rejected(f"the recording is not to be trusted: {why_not}")
    try:
        identification = _identified(recording, robot, mounting, gains, settings)
    except Unidentifiable as why:
        return Rejected(str(why))
    if (
        belief is not None
        and model is not None
        and not differences(belief.context, with_lasting_declarations(belief.context, recording.context))
    ):
        error = measure_prediction_error(recording, model, robot, gains)
        if error is not None:
            belief = replace(belief, prediction_error=prediction_error.update(belief.prediction_error, error, model.residual_rms_nm))
    return judge_identification(identification, recording.context, belief=belief, health=health, settings=settings, source=recording.source)


def judge_identification(
    identification: Identification,
    context: Context,
    *,
    belief: Belief | None,
    health: Health | None,
    settings: AssessSettings | None = None,
    source: str = "",
) -> Assessment | Rejected:
    """The same flow from an identification on; its time is `context.recorded_at_unix_s`."""
    settings = settings or AssessSettings()
    at = context.recorded_at_unix_s
    refused = _refusal(at, belief)
    if refused or at is None:
        return refused or Rejected("no time")
    if belief is None:
        belief = begin(identification.robot, context, identification, at, settings=settings.drift, laws=settings.temperature)
    _belong_together(identification, belief, health, settings)
    belief, told, said = learn(
        belief, identification, context, at, settings=settings.drift, laws=settings.temperature, health=settings.health
    )
    judged = judge(health, belief, settings.health, said, drift=settings.drift)
    coulomb, viscous = belief.lines(settings.temperature)
    return Assessment(
        robot=identification.robot,
        recorded_at_unix_s=at,
        source=source,
        identification=identification,
        friction=_friction(identification, belief, settings, coulomb=coulomb, viscous=viscous),
        temperature=_temperature(identification, belief, coulomb=coulomb, viscous=viscous),
        belief=belief,
        health=judged.health,
        transitions=judged.transitions,
        model=build_model(identification, belief, coulomb=coulomb, viscous=viscous),
        warnings=(*identification.warnings, *told),
    )


def model_after(
    recording: Recording, belief: Belief, *, robot: Robot, mounting: Mounting, gains: Array | None, settings: AssessSettings
) -> CompensatedModel:
    """The model that was held after a recording had been learnt from, of what was believed then.

    Raises BadInput, of it Unidentifiable.
    """
    identification = _identified(recording, robot, mounting, gains, settings)
    coulomb, viscous = belief.lines(settings.temperature)
    return build_model(identification, belief, coulomb=coulomb, viscous=viscous)


def _identified(recording: Recording, robot: Robot, mounting: Mounting, gains: Array | None, settings: AssessSettings) -> Identification:
    return identify([recording], robot, mounting, method=settings.method, gains=gains, settings=settings.identify, residual_friction=True)


def _refusal(at_unix_s: float | None, belief: Belief | None) -> Rejected | None:
    """Why a recording of that time cannot be learnt from."""
    if at_unix_s is None or not math.isfinite(at_unix_s):
        return Rejected("the recording does not say when it was made (context.recorded_at_unix_s): replays are judged in time order")
    if belief is not None and belief.replays and at_unix_s <= belief.at_unix_s:
        which = (
            "is the one learnt last" if at_unix_s == belief.at_unix_s else f"is {belief.at_unix_s - at_unix_s:.0f} s older than the last"
        )
        return Rejected(f"this replay {which}: replays are learnt once, in time order")
    return None


def _belong_together(identification: Identification, belief: Belief, health: Health | None, settings: AssessSettings) -> None:
    """Raises BadInput where a belief or health of another arm, or of another reference speed, was handed in."""
    if identification.robot != belief.robot:
        raise BadInput(f"the belief is of {belief.robot}, the recording of {identification.robot}: each arm has its own state")
    if len(identification.coulomb_nm) != belief.joints or (health is not None and len(health.joints) != belief.joints):
        raise BadInput(f"the belief has {belief.joints} joints, the identification {len(identification.coulomb_nm)}; they must agree")
    if belief.reference_speed_rad_s != settings.drift.reference_speed_rad_s:
        was, now = belief.reference_speed_rad_s, settings.drift.reference_speed_rad_s
        raise BadInput(
            f"the belief refers friction to {was:g} rad/s, drift.reference_speed_rad_s is {now:g}: keep it, or begin a new history"
        )


def _friction(
    identification: Identification, belief: Belief, settings: AssessSettings, *, coulomb: Line, viscous: Line
) -> tuple[JointFriction, ...]:
    """What is published of every joint."""
    torque, torque_std = belief.reference_torque_nm(settings.drift)
    replay = observe(identification, settings.drift)._replace(log_torque=belief.last_log_torque)  # NaN where nothing was learnt
    alone, alone_std = single_torque_nm(belief.drift_state, replay, settings.drift)
    # what one replay says of fc and fv, with what the next would say differently: the larger of the two scatters
    fc_std = np.maximum(np.sqrt(identification.friction_cov[:, 0, 0]), coulomb.scatter)
    fv_std = np.maximum(np.sqrt(identification.friction_cov[:, 1, 1]), viscous.scatter)
    means, covs = belief.rate()
    wear, wear_std = belief.wear_with_undetected(settings.drift)
    joints = []
    for j in range(belief.joints):
        mean, cov = means[j], covs[j]
        rise = math.exp(wear[j])
        life = remaining_life(mean, cov, wear_walk_per_sqrt_day=settings.drift.wear_walk_per_sqrt_day, settings=settings.prognosis)
        usual = belief.usage.per_day[j]
        left = tuple(None if days is None else _known(days * usual) for days in (life.p10_days, life.p50_days, life.p90_days))
        joints.append(
            JointFriction(
                joint=j + 1,
                coulomb_nm=_known(identification.coulomb_nm[j]),
                coulomb_std_nm=_known(fc_std[j]),
                viscous_nm_s_per_rad=_known(identification.viscous_nm_s_per_rad[j]),
                viscous_std_nm_s_per_rad=_known(fv_std[j]),
                temperature_c=_known(belief.temperature_c[j]),
                reference_speed_rad_s=belief.reference_speed_rad_s,
                reference_temperature_c=float(belief.reference_temperature_c[j]),
                reference_torque_nm=_known(torque[j]),
                reference_torque_std_nm=_known(torque_std[j]),
                wear=rise - 1.0,
                wear_std=rise * float(wear_std[j]),
                wear_rate_per_day=float(mean[1]),
                wear_rate_std_per_day=math.sqrt(max(cov[1, 1], 0.0)),
                remaining_life=life,
                revolutions=_known(belief.usage.revolutions[j]),
                revolutions_per_day=_known(usual),
                remaining_revolutions=(left[0], left[1], left[2]),
                replay_torque_nm=_known(alone[j]),
                replay_torque_std_nm=_known(alone_std[j]),
            )
        )
    return tuple(joints)


def _temperature(identification: Identification, belief: Belief, *, coulomb: Line, viscous: Line) -> tuple[JointTemperature, ...]:
    """What has been learnt of every joint's temperature laws."""
    change, std = viscous.change, np.sqrt(viscous.cov[:, [0, 1], [0, 1]])  # (J,), (J, 2)
    dry_std = np.sqrt(coulomb.cov[:, 1, 1])
    mean_speed = identification.mean_speed_rad_s if identification.mean_speed_rad_s is not None else np.full(belief.joints, np.nan)
    fallen = np.abs(viscous.slope) * (viscous.range_c[:, 1] - viscous.range_c[:, 0])  # of fv, [N·m·s/rad]
    held = np.full((belief.joints, len(LAWS)), np.nan) if viscous.curve is None else viscous.curve.held_out
    along = np.linspace(viscous.range_c[:, 0], viscous.range_c[:, 1], LAW_POINTS)  # (P, J)
    law = viscous.at(along)
    return tuple(
        JointTemperature(
            joint=j + 1,
            law=viscous.law[j],
            held_out={law: _known(held[j, k]) for k, law in enumerate(LAWS)},
            reference_temperature_c=float(belief.reference_temperature_c[j]),
            viscous_nm_s_per_rad=_known(viscous.intercept[j]),
            viscous_std_nm_s_per_rad=_known(std[j, 0]) if math.isfinite(viscous.intercept[j]) else None,
            slope_nm_s_per_rad_k=float(viscous.slope[j]),
            slope_std_nm_s_per_rad_k=float(std[j, 1]),
            coulomb_nm=_known(coulomb.intercept[j]),
            coulomb_std_nm=_known(math.sqrt(coulomb.cov[j, 0, 0])) if math.isfinite(coulomb.intercept[j]) else None,
            coulomb_law=coulomb.law[j],
            coulomb_slope_nm_per_k=float(coulomb.slope[j]),
            coulomb_slope_std_nm_per_k=float(dry_std[j]),
            coulomb_depends=bool(abs(coulomb.slope[j]) > 2.0 * dry_std[j]),
            range_c=(float(viscous.range_c[j, 0]), float(viscous.range_c[j, 1])) if np.isfinite(viscous.range_c[j]).all() else None,
            change=_known(change[j]),
            torque_change_mean_nm=_known(fallen[j] * mean_speed[j]),
            torque_change_max_nm=_known(fallen[j] * identification.max_speed_rad_s[j]),
            friction_slope_per_k=float(belief.slope[j]),
            viscous_by_temperature=tuple(
                (float(t), float(fv), float(std))
                for t, fv, std in zip(along[:, j], law.value[:, j], law.std[:, j], strict=True)
                if math.isfinite(t) and math.isfinite(fv)
            ),
        )
        for j in range(belief.joints)
    )


def _known(value: float) -> float | None:
    """A float, or None for NaN."""
    return float(value) if math.isfinite(value) else None
