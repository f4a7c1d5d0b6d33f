"""Why a joint does not alert: what stands between it and the next tier, in words, on request."""

import math

import numpy as np

from monitor.judge.alerts.evidence import Counts, advisory_sigmas, weigh_evidence
from monitor.judge.alerts.health import RISES, TIERS, Health
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.belief import Belief


def why_not_alerting(health: Health, belief: Belief, joint: int, settings: HealthSettings) -> tuple[str, ...]:
    """What stands between a joint (from 1) and the next tier of an alert, in words; empty where the highest tier stands."""
    j = joint - 1
    evidence = health.joints[j].rising
    active = [alert for alert in health.active_alerts if alert.joint == joint and alert.condition in RISES]
    tier = TIERS.index(active[0].tier) + 1 if active else 0
    if tier >= len(TIERS):
        return ()
    found = weigh_evidence(
        belief.wear,
        belief.wear_std,
        belief.filter_state.replays > 0,
        np.zeros(belief.joints, dtype=bool),
        np.zeros(belief.joints),
        np.ones(belief.joints),
        np.ones(belief.joints),
        counts_of(health),
        belief.joints,
        settings,
    )
    rise, change = settings.rises[tier], math.expm1(found.excess[j])
    reasons = [f"next is the {TIERS[tier]} tier, from {rise:+z.0%}; friction has changed by {change:+z.1%} ± {belief.wear_std[j]:.1%}"]
    if found.common[0] > 0:
        reasons.append(f"all joints have risen together by {math.expm1(found.common[0]):+z.1%}: that is taken off")
    needed = advisory_sigmas(belief.joints, settings)
    if found.sigmas[j] < needed:
        reasons.append(f"that is {found.sigmas[j]:z.1f} of its standard deviations; {needed:.1f} are asked for")
    if tier == 0 and change < rise:
        reasons.append(f"it is below {rise:+z.0%}")
    if tier > 0 and found.above[j, tier] < (sure := (settings.wear_sure, settings.limit_sure)[tier - 1]):
        reasons.append(f"P(more than {rise:.0%}) is {found.above[j, tier]:.2f}; {sure:.2f} is asked for")
    if not belief.learnt_from[j]:
        reasons.append("the last replay taught nothing of this joint")
    elif not math.isfinite(belief.temperature_c[j]):
        reasons.append("the last replay does not tell this joint's temperature: it counts for no alert")
    elif not belief.inside_range[j]:
        reasons.append("the last replay was outside the temperatures learnt so far")
    counted = evidence[tier]
    if counted.replays < settings.min_replays or counted.days < settings.min_days:
        reasons.append(
            f"{counted.replays} replays on {counted.days} days in a row agree; {settings.min_replays} on {settings.min_days} are asked for"
        )
    return tuple(reasons)


def counts_of(health: Health) -> Counts:
    """The evidence so far, as arrays."""
    rows = [[*joint.rising, joint.falling] for joint in health.joints]
    return Counts(
        replays=np.array([[float(e.replays) for e in row] for row in rows]),
        days=np.array([[float(e.days) for e in row] for row in rows]),
        last_day=np.array([[float(e.last_day) for e in row] for row in rows]),
        arm_replays=np.array([float(health.common.replays)]),
        arm_days=np.array([float(health.common.days)]),
        arm_last_day=np.array([float(health.common.last_day)]),
    )
