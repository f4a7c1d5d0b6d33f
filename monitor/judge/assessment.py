"""What one replay leads to: the assessment, and the figures of each joint that are published from it."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from monitor.identify.identification import Identification
from monitor.judge.alerts.health import Health, Transition, alert_document
from monitor.judge.alerts.remaining_life import RemainingLife, remaining_life_of_joint
from monitor.judge.belief import Belief
from monitor.judge.document import plain
from monitor.judge.drift.maintenance import Maintenance
from monitor.judge.drift.ripple_track import JointRipple, joint_ripple
from monitor.judge.drift.single_replay import single_torque_nm
from monitor.judge.friction.observation import observe
from monitor.judge.settings import AssessSettings
from monitor.judge.temperature.curves import LAWS
from monitor.judge.temperature.laws import Line
from monitor.judge.torque.model import CompensatedModel, build_model
from monitor.reason import Reason
from monitor.recording import known_or_none

LAW_POINTS = 9  # points of the published temperature law, over the learned range
DEPENDS_SIGMAS = 2.0  # Coulomb friction depends on temperature if its slope is beyond so many standard deviations


@dataclass(frozen=True, slots=True, kw_only=True)
class JointFriction:
    """Friction of one joint after one replay, with the published names; None where a value is unknown."""

    joint: int  # 1…J
    coulomb_nm: float | None  # fc of this replay, at its temperature
    coulomb_std_nm: float | None  # with the scatter from replay to replay
    viscous_nm_s_per_rad: float | None  # fv of this replay, at its temperature
    viscous_std_nm_s_per_rad: float | None
    temperature_c: float | None
    reference_speed_rad_s: float  # v*
    reference_temperature_c: float  # T0
    reference_torque_nm: float | None  # F(v*, T0) estimated from all replays
    reference_torque_std_nm: float | None
    wear: float  # fraction of friction torque since the beginning
    wear_std: float
    wear_rate_per_day: float  # per usual day of usage
    wear_rate_std_per_day: float
    remaining_life: RemainingLife
    revolutions: float | None  # counted until this replay
    revolutions_per_day: float | None  # usual
    remaining_revolutions: tuple[float | None, float | None, float | None]  # P10, P50, P90 of remaining life, in revolutions
    replay_torque_nm: float | None  # F(v*, T0) of this replay alone
    replay_torque_std_nm: float | None  # with the scatter from replay to replay
    unseen_step: float | None  # fraction: a larger step, `unseen_step_days` ago, would have been detected in nine of ten
    unseen_step_days: float | None
    ripple: JointRipple | None  # of the gear


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTemperature:
    """The temperature laws learned of one joint, wear divided out, with the published names."""

    joint: int  # 1…J
    law: str  # of fv, the one with the least error on temperatures left out of its fit: linear | exponential | vogel
    held_out: dict[str, float | None]  # law → RMS error of fv on temperatures left out of its fit [N·m·s/rad]
    reference_temperature_c: float
    viscous_nm_s_per_rad: float | None  # of the straight line at T0, as are its slope and both standard deviations
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
    torque_change_mean_nm: float | None  # effect of that change on joint torque, mean over the replay's motion; ibid., tables 5–7
    torque_change_max_nm: float | None  # at the replay's fastest speed
    friction_slope_per_k: float  # β of the filter: log F(v*) per kelvin
    viscous_by_temperature: tuple[tuple[float, float, float], ...]  # °C, fv and its std along `law`, from which torque is predicted


@dataclass(frozen=True, kw_only=True, eq=False)
class Assessment:
    """Everything that follows from one replay.

    Published figures and the model are computed when they are first asked for: who judges years of replays in turn asks only at the end.
    """

    robot: str
    recorded_at_unix_s: float
    source: str
    identification: Identification
    belief: Belief
    health: Health
    transitions: tuple[Transition, ...]
    warnings: tuple[Reason, ...]
    maintenance: tuple[Maintenance, ...]  # on joints: those that this replay's context declares first, and those that this replay judges
    settings: AssessSettings

    @cached_property
    def lines(self) -> tuple[Line, Line]:
        """fc(T) and fv(T) of the belief."""
        return self.belief.lines(self.settings.temperature)

    @cached_property
    def friction(self) -> tuple[JointFriction, ...]:
        """The published friction of every joint."""
        coulomb, viscous = self.lines
        return joint_friction(self.identification, self.belief, self.settings, coulomb=coulomb, viscous=viscous)

    @cached_property
    def temperature(self) -> tuple[JointTemperature, ...]:
        """The published temperature laws of every joint."""
        coulomb, viscous = self.lines
        return joint_temperature(self.identification, self.belief, coulomb=coulomb, viscous=viscous)

    @cached_property
    def model(self) -> CompensatedModel:
        """The temperature-compensated torque model."""
        coulomb, viscous = self.lines
        return build_model(self.identification, self.belief, self.settings.friction, coulomb=coulomb, viscous=viscous)

    def as_document(self) -> dict[str, Any]:
        """The verdict of this replay as plain JSON; belief and model have documents of their own."""
        return {
            "robot": self.robot,
            "recorded_at_unix_s": self.recorded_at_unix_s,
            "file": self.source,
            "replays": self.belief.replays,
            "health": {"arm": self.health.state, "joints": [joint.state for joint in self.health.joints]},
            "why": {"arm": self.health.why.document(), "joints": [joint.why.document() for joint in self.health.joints]},
            "alerts": [alert_document(alert) for alert in self.health.active_alerts],
            "friction": plain(self.friction),
            "temperature": plain(self.temperature),
            "contexts": plain(self.belief.contexts),
            "warnings": [plain(warning) for warning in self.warnings],
        }


def joint_friction(
    identification: Identification, belief: Belief, settings: AssessSettings, *, coulomb: Line, viscous: Line
) -> tuple[JointFriction, ...]:
    """The published friction of every joint, from the belief after the replay and its `lines`."""
    model = settings.friction
    torque, torque_std = belief.reference_torque_nm(model)
    replay = observe(identification, settings.drift)._replace(log_torque=belief.last_log_torque)  # NaN where nothing was learned
    alone, alone_std = single_torque_nm(belief.drift_state, replay, model)
    # the next replay would scatter around this one: the larger of the fit's and the scatter's standard deviation
    fc_std = np.maximum(np.sqrt(identification.friction_cov[:, 0, 0]), coulomb.scatter)
    fv_std = np.maximum(np.sqrt(identification.friction_cov[:, 1, 1]), viscous.scatter)
    means, covs = belief.wear_and_rate()
    wear, wear_std = belief.change_with_unfound(model)
    unseen = belief.unseen_step(model)
    ripples = joint_ripple(belief.ripple)
    joints = []
    for j in range(belief.joints):
        mean, cov = means[j], covs[j]
        factor = math.exp(wear[j])
        life = remaining_life_of_joint(belief.friction, j, model, settings.prognosis, settings.drift.wear_prior)
        # the model's rate is that of a straight line; an accelerating joint is faster by now
        rate, rate_std = float(mean[1]), math.sqrt(max(cov[1, 1], 0.0))
        if life.rate_per_day is not None and life.rate_std_per_day is not None:
            rate, rate_std = life.rate_per_day, life.rate_std_per_day
        usual = belief.usage.per_day[j]
        left = tuple(None if days is None else known_or_none(days * usual) for days in (life.p10_days, life.p50_days, life.p90_days))
        joints.append(
            JointFriction(
                joint=j + 1,
                coulomb_nm=known_or_none(identification.coulomb_nm[j]),
                coulomb_std_nm=known_or_none(fc_std[j]),
                viscous_nm_s_per_rad=known_or_none(identification.viscous_nm_s_per_rad[j]),
                viscous_std_nm_s_per_rad=known_or_none(fv_std[j]),
                temperature_c=known_or_none(belief.temperature_c[j]),
                reference_speed_rad_s=belief.reference_speed_rad_s,
                reference_temperature_c=float(belief.reference_temperature_c[j]),
                reference_torque_nm=known_or_none(torque[j]),
                reference_torque_std_nm=known_or_none(torque_std[j]),
                wear=factor - 1.0,
                wear_std=factor * float(wear_std[j]),
                wear_rate_per_day=rate,
                wear_rate_std_per_day=rate_std,
                remaining_life=life,
                revolutions=known_or_none(belief.usage.revolutions[j]),
                revolutions_per_day=known_or_none(usual),
                remaining_revolutions=(left[0], left[1], left[2]),
                replay_torque_nm=known_or_none(alone[j]),
                replay_torque_std_nm=known_or_none(alone_std[j]),
                unseen_step=known_or_none(np.expm1(unseen.log_rise[j])),
                unseen_step_days=known_or_none(unseen.days[j]),
                ripple=None if ripples is None else ripples[j],
            )
        )
    return tuple(joints)


def joint_temperature(identification: Identification, belief: Belief, *, coulomb: Line, viscous: Line) -> tuple[JointTemperature, ...]:
    """The published temperature laws of every joint, from the belief after the replay and its `lines`."""
    change, std = viscous.change, np.sqrt(viscous.cov[:, [0, 1], [0, 1]])  # (J,), and (J, 2) of intercept and slope
    coulomb_slope_std = np.sqrt(coulomb.cov[:, 1, 1])
    mean_speed = identification.mean_speed_rad_s if identification.mean_speed_rad_s is not None else np.full(belief.joints, np.nan)
    fv_change = np.abs(viscous.slope) * (viscous.range_c[:, 1] - viscous.range_c[:, 0])  # of fv, [N·m·s/rad]
    held = np.full((belief.joints, len(LAWS)), np.nan) if viscous.curve is None else viscous.curve.held_out
    along = np.linspace(viscous.range_c[:, 0], viscous.range_c[:, 1], LAW_POINTS)  # (P, J)
    law = viscous.at(along)
    return tuple(
        JointTemperature(
            joint=j + 1,
            law=viscous.law[j],
            held_out={law: known_or_none(held[j, k]) for k, law in enumerate(LAWS)},
            reference_temperature_c=float(belief.reference_temperature_c[j]),
            viscous_nm_s_per_rad=known_or_none(viscous.intercept[j]),
            viscous_std_nm_s_per_rad=known_or_none(std[j, 0]) if math.isfinite(viscous.intercept[j]) else None,
            slope_nm_s_per_rad_k=float(viscous.slope[j]),
            slope_std_nm_s_per_rad_k=float(std[j, 1]),
            coulomb_nm=known_or_none(coulomb.intercept[j]),
            coulomb_std_nm=known_or_none(math.sqrt(coulomb.cov[j, 0, 0])) if math.isfinite(coulomb.intercept[j]) else None,
            coulomb_law=coulomb.law[j],
            coulomb_slope_nm_per_k=float(coulomb.slope[j]),
            coulomb_slope_std_nm_per_k=float(coulomb_slope_std[j]),
            coulomb_depends=bool(abs(coulomb.slope[j]) > DEPENDS_SIGMAS * coulomb_slope_std[j]),
            range_c=(float(viscous.range_c[j, 0]), float(viscous.range_c[j, 1])) if np.isfinite(viscous.range_c[j]).all() else None,
            change=known_or_none(change[j]),
            torque_change_mean_nm=known_or_none(fv_change[j] * mean_speed[j]),
            torque_change_max_nm=known_or_none(fv_change[j] * identification.max_speed_rad_s[j]),
            friction_slope_per_k=float(belief.slope[j]),
            viscous_by_temperature=tuple(
                (float(t), float(fv), float(std))
                for t, fv, std in zip(along[:, j], law.value[:, j], law.std[:, j], strict=True)
                if math.isfinite(t) and math.isfinite(fv)
            ),
        )
        for j in range(belief.joints)
    )
