"""Why a joint does not alert: what is missing for its next tier, in sentences for a person who asks."""

import math

import numpy as np

from monitor.judge.alerts.beside import joint_beside
from monitor.judge.alerts.conditions import RISES
from monitor.judge.alerts.evidence import Evidence, advisory_sigmas, counts_of, required_of_joints, wear_after_replay, weigh_evidence
from monitor.judge.alerts.health import TIERS, Health
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.belief import Belief


def why_not_alerting(health: Health, belief: Belief, joint: int, settings: HealthSettings) -> tuple[str, ...]:
    """What is missing between a joint (from 1) and its next tier of risen friction; empty where the highest tier is active."""
    waiting = [act for act in belief.maintenance if act.waiting and act.joint == joint]
    if waiting:
        return (waiting[-1].text,)
    active = [alert for alert in health.active_alerts if alert.joint == joint and alert.condition in RISES]
    tier = TIERS.index(active[0].tier) + 1 if active else 0
    if tier >= len(TIERS):
        return ()
    nothing_usable = np.zeros(belief.joints, dtype=bool)  # the last replay is counted already
    evidence = weigh_evidence(wear_after_replay(belief, nothing_usable), counts_of(health), belief.joints, settings)
    return (
        *_too_little_change(evidence, belief, joint - 1, tier, settings),
        *_unusable_replay(belief, joint - 1),
        *_too_few_replays(health, joint - 1, tier, settings),
    )


def _too_little_change(evidence: Evidence, belief: Belief, j: int, tier: int, settings: HealthSettings) -> list[str]:
    rise, change = settings.rises[tier], math.expm1(evidence.excess[j])
    reasons = [f"next is the {TIERS[tier]} tier, from {rise:+z.0%}; friction has changed by {change:+z.1%} ± {belief.wear_std[j]:.1%}"]
    beside = joint_beside(evidence.beside, evidence.excess, j)
    if beside.found:
        reasons.append(beside.finding)
    if evidence.common[0] > 0:
        reasons.append(f"all joints have risen together by {math.expm1(evidence.common[0]):+z.1%}: that is taken off")
    required = advisory_sigmas(belief.joints, settings)
    if tier == 0:
        required = float(required_of_joints(wear_after_replay(belief, belief.learnt_from), required)[j])
    if evidence.sigmas[j] < required:
        reasons.append(f"that is {evidence.sigmas[j]:z.1f} of its standard deviations; {required:.1f} are asked for")
    if tier == 0 and change < rise:
        reasons.append(f"it is below {rise:+z.0%}")
    if tier > 0 and evidence.above[j, tier] < (sure := (settings.wear_sure, settings.limit_sure)[tier - 1]):
        reasons.append(f"P(more than {rise:.0%}) is {evidence.above[j, tier]:.2f}; {sure:.2f} is asked for")
    return reasons


def _unusable_replay(belief: Belief, j: int) -> list[str]:
    if not belief.learnt_from[j]:
        return ["the last replay taught nothing of this joint"]
    if not math.isfinite(belief.temperature_c[j]):
        return ["the last replay does not tell this joint's temperature: it counts for no alert"]
    if not belief.inside_range[j]:
        return ["the last replay was outside the temperatures learnt so far"]
    return []


def _too_few_replays(health: Health, j: int, tier: int, settings: HealthSettings) -> list[str]:
    counted = health.joints[j].rising[tier]
    if counted.replays >= settings.min_replays and counted.days >= settings.min_days:
        return []
    required = f"{settings.min_replays} on {settings.min_days} are asked for"
    return [f"{counted.replays} replays on {counted.days} days in a row agree; {required}"]
