"""From belief to what a maintenance engineer is told: a state a joint, and alerts that are raised, updated and cleared.

States are those of NAMUR NE 107 as OPC UA spells them. An alert asks for statistical evidence (the probability that wear
exceeds a tier's rise), for practical relevance (the rise itself), for replays on several days inside the learnt
temperatures, and that not all joints rise together: that would be temperature or supply. It stays until somebody
acknowledges it; acknowledged and shelved are orthogonal to active (ISA-18.2).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from monitor.errors import BadConfiguration, BadInput
from monitor.judge.belief import OUTLIER, UNSEEN, Belief
from monitor.judge.document import entry, plain
from monitor.recording import Array

NORMAL, CHECK_FUNCTION, OFF_SPEC, MAINTENANCE_REQUIRED, FAILURE = STATES = (
    "NORMAL",
    "CHECK_FUNCTION",  # the data, not the joint, are in doubt
    "OFF_SPEC",  # outside the temperatures that were learnt
    "MAINTENANCE_REQUIRED",
    "FAILURE",  # the configured end of life is reached
)  # in the order of what wins when states are combined
TIERS = ("advisory", "wear", "limit")
STATE_OF_TIER = {"advisory": NORMAL, "wear": MAINTENANCE_REQUIRED, "limit": FAILURE}
WEAR_RISING, FRICTION_FALLING, COMMON_MODE = "wear_rising", "friction_falling", "common_mode"
ACTIONS = {
    ("wear_rising", "advisory"): "Nothing yet: watch this joint.",
    ("wear_rising", "wear"): "Plan an inspection of this joint: lubrication, backlash, noise.",
    ("wear_rising", "limit"): "Replace or overhaul this joint: friction has reached the configured limit.",
    (
        "friction_falling",
        "advisory",
    ): "Tell the monitor if the joint was greased or replaced; otherwise check its brake, current and temperature.",
    ("common_mode", "advisory"): "Check what all joints share: temperature sensors, supply voltage, payload and mounting as configured.",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthSettings:
    """When to speak. Rises are fractions of the friction torque at the beginning."""

    advisory_rise: float = 0.01
    wear_rise: float = 0.05
    limit_rise: float = 0.30
    advisory_sure: float = 0.99  # P(wear > rise); stricter where acting is cheap to doubt
    wear_sure: float = 0.95
    limit_sure: float = 0.95
    min_replays: int = 3
    min_days: int = 2
    clear_fraction: float = 0.6  # of a tier's rise: lower than the raising level, so that an alert does not flap
    update_step: float = 0.02  # an active alert is told again when its change has moved by so much
    common_share: float = 2.0 / 3.0  # of the joints rising together …
    common_sure: float = 0.9  # … each with this probability, are no wear
    learning_replays: int = 10  # until then a new temperature is learning, not OFF_SPEC

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the figure that is out of order."""
        if not 0 < self.advisory_rise < self.wear_rise < self.limit_rise:
            raise BadConfiguration("health: expected 0 < advisory_rise < wear_rise < limit_rise")
        for name in ("advisory_sure", "wear_sure", "limit_sure", "common_sure"):
            if not 0.5 <= getattr(self, name) < 1:
                raise BadConfiguration(f"health.{name} = {getattr(self, name)!r}; expected a probability from 0.5 to below 1")
        if not 0 < self.clear_fraction < 1:
            raise BadConfiguration(f"health.clear_fraction = {self.clear_fraction!r}; expected a fraction between 0 and 1")
        if self.min_replays < 1 or self.min_days < 1:
            raise BadConfiguration("health.min_replays and min_days: expected 1 or more")

    @property
    def rises(self) -> Array:
        """(3,) of the tiers."""
        return np.array([self.advisory_rise, self.wear_rise, self.limit_rise])

    @property
    def sures(self) -> Array:
        """(3,) of the tiers."""
        return np.array([self.advisory_sure, self.wear_sure, self.limit_sure])


class Evidence(NamedTuple):
    """Replays in a row that agree, and on how many UTC days."""

    replays: int = 0
    days: int = 0
    last_day: int = -1

    def with_replay(self, day: int) -> "Evidence":
        """One more that agrees."""
        return Evidence(self.replays + 1, self.days + (day != self.last_day), day)

    def suffices(self, settings: HealthSettings) -> bool:
        """Whether enough replays on enough days agree."""
        return self.replays >= settings.min_replays and self.days >= settings.min_days


NO_EVIDENCE = (Evidence(),) * len(TIERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointHealth:
    """One joint's state, why and since when, and the evidence gathered so far."""

    joint: int  # 1…J
    state: str = NORMAL
    why: str = "nothing is known yet"
    since_unix_s: float = 0.0
    rising: tuple[Evidence, ...] = NO_EVIDENCE  # one a tier
    falling: Evidence = NO_EVIDENCE[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Alert:
    """One condition of one joint, or of the arm, through its life."""

    joint: int | None  # 1…J; None is the arm
    condition: str
    tier: str
    raised_at_unix_s: float
    updated_at_unix_s: float
    cleared_at_unix_s: float | None = None
    change: float  # fraction of friction torque
    probability: float  # that the change exceeds the tier's rise
    text: str
    action: str
    acknowledged_at_unix_s: float | None = None
    acknowledged_by: str | None = None
    acknowledged_why: str | None = None
    shelved_until_unix_s: float | None = None
    shelved_by: str | None = None
    shelved_why: str | None = None

    @property
    def active(self) -> bool:
        """Raised and not cleared."""
        return self.cleared_at_unix_s is None

    @property
    def key(self) -> tuple[int | None, str]:
        """What there is at most one alert of."""
        return self.joint, self.condition


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """The arm and its joints, and the last alert of every condition, cleared ones included."""

    state: str = NORMAL
    why: str = "nothing is known yet"
    since_unix_s: float = 0.0
    joints: tuple[JointHealth, ...]
    alerts: tuple[Alert, ...] = ()
    common: Evidence = field(default_factory=Evidence)

    @property
    def active_alerts(self) -> tuple[Alert, ...]:
        """Raised and not cleared, the oldest first."""
        return tuple(sorted((alert for alert in self.alerts if alert.active), key=lambda alert: alert.raised_at_unix_s))

    def as_document(self) -> dict[str, Any]:
        """Plain JSON; `health_from_document` is its exact inverse."""
        document: dict[str, Any] = plain(self)
        return document


class Transition(NamedTuple):
    """What happened to an alert: "raised", "updated" or "cleared"."""

    kind: str
    alert: Alert


class Judged(NamedTuple):
    """The next health, and what changed on the way."""

    health: Health
    transitions: tuple[Transition, ...]


class _Finding(NamedTuple):
    """What one condition looks like now: `raise_tier` if it may be raised, `hold_tier` if it may be kept; None if not."""

    raise_tier: int | None
    hold_tier: int | None
    change: float
    probabilities: Array  # (3,) of the tiers
    text: Callable[[], str]  # told only when something is to be told


def judge(health: Health | None, belief: Belief, settings: HealthSettings) -> Judged:
    """Health after the belief's last replay."""
    at, J = belief.at_unix_s, belief.joints
    day = math.floor(at / 86_400.0)
    before = health or Health(joints=tuple(JointHealth(joint=j + 1, since_unix_s=at) for j in range(J)), since_unix_s=at)
    usable = (belief.event != UNSEEN) & (belief.event != OUTLIER) & (belief.inside_range > 0)
    doubt = np.maximum(belief.wear_std, 1e-9)

    together = _common_wear(belief, settings)
    common = before.common.with_replay(day) if together else Evidence()
    excess = belief.wear - together  # (J,) beyond what all joints share
    rises, sures = settings.rises, settings.sures
    above = ndtr((excess[:, None] - np.log1p(rises)) / doubt[:, None])  # (J, 3) P(wear > rise)
    below = ndtr((np.log1p(-rises) - belief.wear[:, None]) / doubt[:, None])  # (J, 3) P(wear < −rise)

    findings: dict[tuple[int | None, str], _Finding] = {}
    counted = []
    for j, joint in enumerate(before.joints):
        rising, falling = joint.rising, joint.falling
        if usable[j]:  # an unusable replay neither adds evidence nor takes it away
            agree = above[j] >= sures
            rising = tuple(e.with_replay(day) if yes else Evidence() for e, yes in zip(joint.rising, agree, strict=True))
            falling = joint.falling.with_replay(day) if below[j, 1] >= settings.wear_sure else Evidence()
        counted.append(replace(joint, rising=rising, falling=falling))
        change = math.expm1(excess[j])
        raise_tier = max((k for k in range(3) if rising[k].suffices(settings)), default=None)
        hold_tier = max((k for k in range(3) if change >= settings.clear_fraction * rises[k]), default=None)
        findings[j + 1, WEAR_RISING] = _Finding(raise_tier, hold_tier, change, above[j], partial(_joint_text, belief, j, rising[0]))
        fallen = math.expm1(belief.wear[j])
        holds = 0 if fallen <= -settings.clear_fraction * settings.wear_rise else None
        text = partial(_joint_text, belief, j, falling)
        findings[j + 1, FRICTION_FALLING] = _Finding(0 if falling.suffices(settings) else None, holds, fallen, below[j][[1, 1, 1]], text)
    shift = math.expm1(together) if together else math.expm1(float(np.median(belief.wear)))
    holds = 0 if shift >= settings.clear_fraction * settings.advisory_rise else None
    text = partial(
        "Friction has risen in most joints together, by about {:+.1%} in {} replays: not the wear of one joint.".format,
        shift,
        common.replays,
    )
    certainty = np.full(3, float(np.median(ndtr(belief.wear / doubt))))
    findings[None, COMMON_MODE] = _Finding(0 if common.suffices(settings) else None, holds, shift, certainty, text)

    known = {alert.key: alert for alert in before.alerts}
    transitions = []
    for key, finding in findings.items():
        step = _step(known.get(key), key, finding, at, settings)
        if step:
            known[key] = step.alert
            transitions.append(step)
    alerts = tuple(known.values())
    joints = tuple(_joint_state(joint, belief, alerts, settings) for joint in counted)
    state, why = _arm_state(joints, alerts)
    since = before.since_unix_s if state == before.state else at
    return Judged(Health(state=state, why=why, since_unix_s=since, joints=joints, alerts=alerts, common=common), tuple(transitions))


def acknowledge(health: Health, joint: int | None, condition: str, *, by: str, why: str, at_unix_s: float) -> Health:
    """The same health with one active alert acknowledged; it clears by itself once its condition is gone.

    Raises BadInput where there is no such active alert, or nobody says who acknowledges.
    """
    alert = _active(health, joint, condition, by)
    done = replace(alert, acknowledged_at_unix_s=at_unix_s, acknowledged_by=by, acknowledged_why=why)
    return replace(health, alerts=tuple(done if other is alert else other for other in health.alerts))


def shelve(health: Health, joint: int | None, condition: str, *, by: str, why: str, until_unix_s: float, at_unix_s: float) -> Health:
    """The same health with one active alert shelved: it stays active, and need not be shown until then.

    Raises BadInput where there is no such active alert, nobody says who shelves, or the end lies in the past.
    """
    alert = _active(health, joint, condition, by)
    if not until_unix_s > at_unix_s:
        raise BadInput("shelve: the end lies in the past; expected a time to come")
    done = replace(alert, shelved_until_unix_s=until_unix_s, shelved_by=by, shelved_why=why)
    return replace(health, alerts=tuple(done if other is alert else other for other in health.alerts))


def health_from_document(document: Any) -> Health:
    """A Health from `Health.as_document()`. Raises BadInput naming what is missing or wrong."""
    try:
        joints = tuple(
            JointHealth(**{**o, "rising": tuple(Evidence(**e) for e in o["rising"]), "falling": Evidence(**o["falling"])})
            for o in entry(document, "joints", where="health")
        )
        alerts = tuple(Alert(**o) for o in entry(document, "alerts", where="health"))
        rest = {f.name: entry(document, f.name, where="health") for f in fields(Health) if f.name not in {"joints", "alerts", "common"}}
        return Health(joints=joints, alerts=alerts, common=Evidence(**entry(document, "common", where="health")), **rest)
    except (TypeError, KeyError) as wrong:
        raise BadInput(f"health: {wrong}") from None


def _common_wear(belief: Belief, settings: HealthSettings) -> float:
    """How much all joints have risen together, log; 0 where they have not. Two joints alone share nothing that one can tell."""
    seen = belief.joint_replays > 0
    if seen.sum() < 3:
        return 0.0
    rising = ndtr(belief.wear / np.maximum(belief.wear_std, 1e-9)) >= settings.common_sure
    shift = float(np.median(belief.wear[seen]))
    together = (rising & seen).sum() >= settings.common_share * seen.sum() and shift >= math.log1p(settings.advisory_rise)
    return shift if together else 0.0


def _step(alert: Alert | None, key: tuple[int | None, str], finding: _Finding, at: float, settings: HealthSettings) -> Transition | None:
    """One alert's next step in life, or None where it stays as it is."""
    joint, condition = key
    tier = finding.raise_tier
    if alert is None or not alert.active:
        if tier is None:
            return None
        raised = Alert(
            joint=joint,
            condition=condition,
            tier=TIERS[tier],
            raised_at_unix_s=at,
            updated_at_unix_s=at,
            change=finding.change,
            probability=float(finding.probabilities[tier]),
            text=finding.text(),
            action=ACTIONS[condition, TIERS[tier]],
        )
        return Transition("raised", raised)

    now = TIERS.index(alert.tier)
    acknowledged = alert.acknowledged_at_unix_s is not None
    if acknowledged and tier is None and finding.hold_tier is None:
        return Transition("cleared", replace(alert, cleared_at_unix_s=at, updated_at_unix_s=at, change=finding.change, text=finding.text()))
    highest = max((k for k in (tier, finding.hold_tier) if k is not None), default=now)
    if tier is not None and tier > now:
        highest = tier
    else:
        highest = min(highest, now) if acknowledged else now  # latched: it steps down only once somebody has seen it
    if highest == now and abs(finding.change - alert.change) < settings.update_step:
        return None
    told = replace(
        alert,
        tier=TIERS[highest],
        updated_at_unix_s=at,
        change=finding.change,
        probability=float(finding.probabilities[highest]),
        text=finding.text(),
        action=ACTIONS[condition, TIERS[highest]],
    )
    if highest > now:  # a graver alert is to be seen again
        told = replace(told, acknowledged_at_unix_s=None, acknowledged_by=None, acknowledged_why=None, shelved_until_unix_s=None)
    return Transition("updated", told)


def _joint_state(joint: JointHealth, belief: Belief, alerts: tuple[Alert, ...], settings: HealthSettings) -> JointHealth:
    """The gravest of what holds for a joint, and why."""
    j = joint.joint - 1
    reasons = [(NORMAL, f"friction {math.expm1(belief.wear[j]):+.1%} ± {belief.wear_std[j]:.1%} since the beginning")]
    if belief.event[j] == UNSEEN:
        reasons.append((CHECK_FUNCTION, "the last replay does not resolve this joint's friction"))
    if belief.event[j] == OUTLIER:
        reasons.append((CHECK_FUNCTION, f"the last replay is {belief.innovation[j]:+.1%} off: waiting for the next"))
    outside = math.isfinite(belief.temperature_c[j]) and not belief.inside_range[j]
    if outside and belief.replays > settings.learning_replays:
        reasons.append((OFF_SPEC, f"{belief.temperature_c[j]:.1f} °C is outside the temperatures learnt so far"))
    for alert in alerts:
        if alert.active and alert.joint == joint.joint:
            state = STATE_OF_TIER[alert.tier] if alert.condition == WEAR_RISING else CHECK_FUNCTION
            reasons.append((state, f"{alert.condition} ({alert.tier}): {alert.change:+.1%}"))
    state, why = max(reasons, key=lambda reason: STATES.index(reason[0]))
    since = joint.since_unix_s if state == joint.state else belief.at_unix_s
    return replace(joint, state=state, why=why, since_unix_s=since)


def _arm_state(joints: tuple[JointHealth, ...], alerts: tuple[Alert, ...]) -> tuple[str, str]:
    """The gravest of the joints' and of the arm's own alerts, and why."""
    reasons = [(joint.state, f"joint {joint.joint}: {joint.why}") for joint in joints]
    reasons += [(CHECK_FUNCTION, f"{alert.condition}: {alert.change:+.1%}") for alert in alerts if alert.active and alert.joint is None]
    state, why = max(reasons, key=lambda reason: STATES.index(reason[0]))
    return (state, why) if state != NORMAL else (NORMAL, "all joints are as they were at the beginning")


def _joint_text(belief: Belief, j: int, evidence: Evidence) -> str:
    """Before, after, where and how often: what an engineer asks first."""
    level, wear = belief.mean[j, 0], belief.wear[j]
    return (
        f"Joint {j + 1}: friction at {belief.reference_speed_rad_s:g} rad/s and {belief.reference_temperature_c[j]:.1f} °C went from "
        f"{math.exp(level):.2f} to {math.exp(level + wear):.2f} N·m ({math.expm1(wear):+.1%} ± {belief.wear_std[j]:.1%}), temperature "
        f"taken out ({belief.mean[j, 1]:.2%}/K); {evidence.replays} replays on {evidence.days} days in a row agree."
    )


def _active(health: Health, joint: int | None, condition: str, by: str) -> Alert:
    """The one active alert of that name. Raises BadInput."""
    if not by.strip():
        raise BadInput("by: expected the name of the person who acts")
    for alert in health.alerts:
        if alert.active and alert.key == (joint, condition):
            return alert
    active = ", ".join(f"{alert.joint or 'arm'}/{alert.condition}" for alert in health.alerts if alert.active) or "none"
    raise BadInput(f"no active alert {joint or 'arm'}/{condition}; active: {active}")
