"""Belief → health: which alerts are raised, told again or cleared by a replay, and what state every joint is in.

An alert asks for statistical evidence (the probability that wear exceeds a tier's rise), for practical relevance (the rise
itself), for replays on several days inside the learnt temperatures, and that not all joints rise together.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from monitor.judge.belief import OUTLIER, UNSEEN, Belief
from monitor.judge.health import (
    ACTIONS,
    CHECK_FUNCTION,
    COMMON_MODE,
    FRICTION_FALLING,
    NORMAL,
    OFF_SPEC,
    STATE_OF_TIER,
    STATES,
    TIERS,
    WEAR_RISING,
    Alert,
    Evidence,
    Health,
    HealthSettings,
    JointHealth,
    Transition,
)
from monitor.recording import Array


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
    usable = belief.learnt_from & (belief.inside_range > 0)
    doubt = np.maximum(belief.wear_std, 1e-9)

    together = _common_wear(belief, settings)
    common = before.common
    if 2 * usable.sum() >= J:  # as for a joint: an unusable replay says nothing
        common = common.with_replay(day) if together else Evidence()
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
    std = math.exp(wear) * belief.wear_std[j]
    return (
        f"Joint {j + 1}: friction at {belief.reference_speed_rad_s:g} rad/s and {belief.reference_temperature_c[j]:.1f} °C went from "
        f"{math.exp(level):.2f} to {math.exp(level + wear):.2f} N·m ({math.expm1(wear):+.1%} ± {std:.1%}), temperature "
        f"taken out ({belief.mean[j, 1]:.2%}/K); {evidence.replays} replays on {evidence.days} days in a row agree."
    )
