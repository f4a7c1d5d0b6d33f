"""Belief → health: which alerts are raised, told again or cleared by a replay, and what state every joint is in.

`tiers.py` weighs the evidence, over arrays; here one arm's is put into words and carried through the life of its alerts.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from monitor.judge.alerts.evidence import FALLING, Counts, Evidence, weigh_evidence
from monitor.judge.alerts.health import (
    CHECK_FUNCTION,
    COMMON_MODE,
    DATA_QUALITY,
    FRICTION_FALLING,
    NORMAL,
    OFF_SPEC,
    OUTSIDE_RANGE,
    RISES,
    STATE_OF_TIER,
    STATES,
    SUDDEN_STEP,
    TEMPERATURE_SENSOR,
    WEAR_RISING,
    Alert,
    Attribution,
    Confirmations,
    Health,
    JointHealth,
    Transition,
)
from monitor.judge.alerts.life_cycle import ConditionStatus, next_step
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.alerts.why_not import counts_of
from monitor.judge.belief import Belief
from monitor.judge.drift.filter_state import OUTLIER, UNRESOLVED
from monitor.judge.drift.observation import DriftSettings
from monitor.judge.drift.undeclared_change import NO_UNDECLARED_CHANGE, UndeclaredChange
from monitor.recording import Array


class Judged(NamedTuple):
    """The next health, and what changed on the way."""

    health: Health
    transitions: tuple[Transition, ...]


def judge(
    health: Health | None,
    belief: Belief,
    settings: HealthSettings,
    undeclared: UndeclaredChange = NO_UNDECLARED_CHANGE,
    *,
    drift: DriftSettings | None = None,
) -> Judged:
    """Health after the belief's last replay. `drift` says how wear is put into words, and decides nothing."""
    at, J = belief.at_unix_s, belief.joints
    day = math.floor(at / 86_400.0)
    before = health or Health(joints=tuple(JointHealth(joint=j + 1, since_unix_s=at) for j in range(J)), since_unix_s=at)
    usable = belief.learnt_from & (belief.inside_range > 0) & (undeclared.condition is None)
    seen, days = belief.filter_state.replays > 0, np.full(J, float(day))
    found = weigh_evidence(
        belief.wear,
        belief.wear_std,
        seen,
        usable,
        days,
        belief.filter_state.agreeing,
        belief.filter_state.interval_days,
        counts_of(before),
        J,
        settings,
    )
    known = {alert.key: alert for alert in before.alerts}

    statuses: dict[tuple[int | None, str], ConditionStatus] = {}
    counted = []
    for j, joint in enumerate(before.joints):
        troubled = _troubles(joint, belief, j, day, settings, contradicted=undeclared.condition is not None)
        told = at if belief.learnt_from[j] else joint.told_unix_s
        counted.append(replace(_with_counts(joint, found.counts, j), troubled=tuple(troubled.items()), told_unix_s=told))
        statuses |= _of_joint(belief, j, found, counted[j], known, settings)
        for condition, evidence in troubled.items():
            statuses[j + 1, condition] = _trouble(evidence, partial(_trouble_text, condition, belief, j, evidence), settings)
    counts = found.counts
    common = Confirmations(int(counts.arm_replays[0]), int(counts.arm_days[0]), int(counts.arm_last_day[0]))
    statuses[None, COMMON_MODE] = _common_finding(belief, found, common, settings)
    arm_troubled = _arm_troubles(before, belief, undeclared, day)
    for condition, evidence in arm_troubled.items():
        if condition == TEMPERATURE_SENSOR:
            statuses[None, condition] = _trouble(evidence, partial(_BLIND.format, evidence.replays), settings)
            continue
        raises = _trouble(evidence, lambda: undeclared.text, settings)
        # what is declared and what is measured contradict each other in one replay already; two leave no doubt of the replay
        statuses[None, condition] = raises._replace(raise_tier=0 if evidence.replays >= 2 else None)

    transitions = []
    for key, status in statuses.items():
        step = next_step(known.get(key), key, status, at, settings)
        if step:
            known[key] = step.alert
            transitions.append(step)
    alerts = tuple(known.values())
    wear = belief.wear_with_undetected(drift or DriftSettings())
    joints = tuple(_joint_state(joint, belief, wear, alerts, settings, undeclared) for joint in counted)
    state, why = _arm_state(joints, alerts, undeclared)
    since = before.since_unix_s if state == before.state else at
    after = Health(
        state=state, why=why, since_unix_s=since, joints=joints, alerts=alerts, common=common, troubled=tuple(arm_troubled.items())
    )  # fmt: skip
    return Judged(after, tuple(transitions))


def split(belief: Belief, j: int) -> Attribution | None:
    """What a joint's change since its first replays is made of; None before there is one."""
    y0, y = belief.first_log_torque[j], belief.last_log_torque[j]
    if not (math.isfinite(y0) and math.isfinite(y)):
        return None
    filter_state, slots = belief.filter_state, belief.contexts
    T0 = belief.reference_temperature_c[j] if not math.isfinite(belief.first_temperature_c[j]) else belief.first_temperature_c[j]
    T = belief.temperature_c[j] if math.isfinite(belief.temperature_c[j]) else T0
    here, there = np.full(filter_state.joints, slots[-1].slot or 0), np.full(filter_state.joints, _first_slot(belief))
    at = [filter_state.reference(np.full(filter_state.joints, t), slot)[0][j] for t, slot in ((T0, there), (T0, here), (T, here))]
    temperature, payload, wear = float(at[2] - at[1]), float(at[1] - at[0]), float(belief.wear[j])
    whole = float(y - y0)
    return Attribution(whole=whole, temperature=temperature, payload=payload, wear=wear, rest=whole - temperature - payload - wear)


def stale(health: Health, now_unix_s: float, settings: HealthSettings) -> tuple[bool, ...]:
    """Which joints nothing was learnt of for longer than `stale_days`: neither good nor bad, and to be shown so."""
    limit = now_unix_s - settings.stale_days * 86_400.0
    return tuple(joint.told_unix_s is None or joint.told_unix_s < limit for joint in health.joints)


def stale_words(old: Sequence[int], joints: int, since: str, then: str) -> str:
    """Of which joints nothing was learnt, and that the state is not of `then`: one wording for bus, page and report."""
    who = "all joints" if len(old) == joints else f"joint{'s' if len(old) > 1 else ''} {' '.join(map(str, old))}"
    return f"STALE: {who}: nothing was learnt {since}: the state is of then, not of {then}"


# --- what is found ------------------------------------------------------------------------------------------


def _of_joint(
    belief: Belief, j: int, found: Evidence, joint: JointHealth, known: Mapping[tuple[int | None, str], Alert], settings: HealthSettings
) -> dict[tuple[int | None, str], ConditionStatus]:
    """Rising and falling friction of one joint."""
    change = math.expm1(found.excess[j])
    raise_tier = int(found.raises[j]) if found.raises[j] >= 0 else None
    hold_tier = max((k for k in range(3) if change >= settings.clear_fraction * settings.rises[k]), default=None)
    evidence = max((e for e in joint.rising), key=lambda e: e.replays)
    parts = split(belief, j)
    rising = ConditionStatus(raise_tier, hold_tier, change, found.above[j], partial(_joint_text, belief, j, evidence, parts), parts)
    fallen = math.expm1(belief.wear[j])
    holds = 0 if fallen <= -settings.clear_fraction * settings.wear_rise else None
    text = partial(_joint_text, belief, j, joint.falling, parts)
    falling = ConditionStatus(0 if found.falls[j] else None, holds, fallen, found.below[[j, j, j]], text, parts)
    return {(j + 1, _kind_of_rise(belief, j, known)): rising, (j + 1, FRICTION_FALLING): falling}


def _kind_of_rise(belief: Belief, j: int, known: Mapping[tuple[int | None, str], Alert]) -> str:
    """The condition that is active already, else a step where most of the wear came as one."""
    for condition in RISES:
        alert = known.get((j + 1, condition))
        if alert is not None and alert.active:
            return condition
    return SUDDEN_STEP if belief.filter_state.stepped[j] > 0.5 * max(belief.wear[j], 1e-9) else WEAR_RISING


def _common_finding(belief: Belief, found: Evidence, common: Confirmations, settings: HealthSettings) -> ConditionStatus:
    together = found.common[0] + found.fallen[0]  # one of them is 0
    shift = math.expm1(together) if together else math.expm1(float(np.median(belief.wear)))
    rose = shift >= settings.clear_fraction * settings.advisory_rise
    holds = 0 if rose or shift <= -settings.clear_fraction * settings.wear_rise else None
    text = partial(
        "Friction has {} in most joints together, by about {:+z.1%} in {} replays: not {} of one joint.".format,
        "risen" if shift >= 0 else "fallen",
        shift,
        common.replays,
        "the wear" if shift >= 0 else "the grease",
    )
    # of the change itself: what `found` says of each joint is beyond what all share
    beyond = belief.wear - math.log1p(settings.advisory_rise) if shift >= 0 else math.log1p(-settings.wear_rise) - belief.wear
    certainty = np.full(3, float(np.median(ndtr(beyond / np.maximum(belief.wear_std, 1e-9)))))
    return ConditionStatus(0 if found.together[0] else None, holds, shift, certainty, text)


def _troubles(
    joint: JointHealth, belief: Belief, j: int, day: int, settings: HealthSettings, *, contradicted: bool
) -> dict[str, Confirmations]:
    """Conditions of the data of one joint, each with the replays in a row that showed it."""
    filter_state, T = belief.filter_state, belief.temperature_c
    now = {
        TEMPERATURE_SENSOR: not math.isfinite(T[j]) and bool(np.isfinite(T).any()),
        DATA_QUALITY: not contradicted and (belief.event[j] in {UNRESOLVED, OUTLIER} or bool(filter_state.consistency[j] > 2.5)),
        OUTSIDE_RANGE: bool(math.isfinite(T[j]) and not belief.inside_range[j] and belief.replays > settings.learning_replays),
    }
    before = dict(joint.troubled)
    return {
        condition: _one_more(before.get(condition, Confirmations()), day) if shows else Confirmations() for condition, shows in now.items()
    }


_BLIND = "No joint's temperature is known in {} replays in a row: of wear nothing is told until one is."


def _arm_troubles(before: Health, belief: Belief, undeclared: UndeclaredChange, day: int) -> dict[str, Confirmations]:
    known = dict(before.troubled)
    now = {undeclared.condition} if undeclared.condition else set()
    if not np.isfinite(belief.temperature_c).any():
        now.add(TEMPERATURE_SENSOR)
    return {c: _one_more(known.get(c, Confirmations()), day) if c in now else Confirmations() for c in sorted({*known, *now})}


def _one_more(evidence: Confirmations, day: int) -> Confirmations:
    return Confirmations(evidence.replays + 1, evidence.days + (day != evidence.last_day), day)


def _trouble(evidence: Confirmations, text: Callable[[], str], settings: HealthSettings) -> ConditionStatus:
    enough = evidence.replays >= settings.min_replays and evidence.days >= settings.min_days
    return ConditionStatus(0 if enough else None, 0 if evidence.replays else None, 0.0, np.ones(3), text)


def _with_counts(joint: JointHealth, counts: Counts, j: int) -> JointHealth:
    evidence = [Confirmations(int(counts.replays[j, k]), int(counts.days[j, k]), int(counts.last_day[j, k])) for k in range(FALLING + 1)]
    return replace(joint, rising=tuple(evidence[:FALLING]), falling=evidence[FALLING])


def _first_slot(belief: Belief) -> int:
    """Where the level of the oldest baseline still kept is."""
    kept = [o for o in belief.contexts if o.slot is not None]
    return min(kept, key=lambda o: o.opened_at_unix_s).slot or 0


# --- states and words ---------------------------------------------------------------------------------------


def _joint_state(
    joint: JointHealth,
    belief: Belief,
    wear: tuple[Array, Array],
    alerts: tuple[Alert, ...],
    settings: HealthSettings,
    undeclared: UndeclaredChange,
) -> JointHealth:
    """The gravest of what holds for a joint, and why."""
    j = joint.joint - 1
    reasons = [(NORMAL, f"friction {math.expm1(wear[0][j]):+z.1%} ± {wear[1][j]:.1%} since the beginning")]
    if undeclared.condition is not None:
        reasons.append((CHECK_FUNCTION, f"nothing is learnt of wear: {undeclared.text}"))
    elif belief.event[j] == UNRESOLVED:
        reasons.append((CHECK_FUNCTION, "the last replay does not resolve this joint's friction"))
    if belief.event[j] == OUTLIER:
        reasons.append((CHECK_FUNCTION, f"the last replay is {belief.filter_state.innovation[j]:+z.1%} off: waiting for the next"))
    outside = math.isfinite(belief.temperature_c[j]) and not belief.inside_range[j]
    if outside and belief.replays > settings.learning_replays:
        reasons.append((OFF_SPEC, f"{belief.temperature_c[j]:.1f} °C is outside the temperatures learnt so far"))
    for alert in alerts:
        if alert.active and alert.joint == joint.joint:
            if alert.condition in RISES:
                state = STATE_OF_TIER[alert.tier]
            else:
                state = OFF_SPEC if alert.condition == OUTSIDE_RANGE else CHECK_FUNCTION
            change = f": {alert.change:+z.1%}" if alert.condition in {*RISES, FRICTION_FALLING} else ""  # the others are of the data
            reasons.append((state, f"{alert.condition} ({alert.tier}){change}"))
    state, why = max(reasons, key=lambda reason: STATES.index(reason[0]))
    since = joint.since_unix_s if state == joint.state else belief.at_unix_s
    return replace(joint, state=state, why=why, since_unix_s=since)


def _arm_state(joints: tuple[JointHealth, ...], alerts: tuple[Alert, ...], undeclared: UndeclaredChange) -> tuple[str, str]:
    """The gravest of the joints' and of the arm's own alerts, and why."""
    reasons = [(joint.state, f"joint {joint.joint}: {joint.why}") for joint in joints]
    reasons += [(CHECK_FUNCTION, f"{alert.condition}: {alert.text}") for alert in alerts if alert.active and alert.joint is None]
    if undeclared.condition is not None:
        reasons.insert(0, (CHECK_FUNCTION, undeclared.text))
    state, why = max(reasons, key=lambda reason: STATES.index(reason[0]))
    return (state, why) if state != NORMAL else (NORMAL, "all joints are as they were at the beginning")


def _joint_text(belief: Belief, j: int, evidence: Confirmations, parts: Attribution | None) -> str:
    """Before, after, where and how often: what an engineer asks first."""
    level, wear = float(belief.level()[j]), belief.wear[j]
    std = math.exp(wear) * belief.wear_std[j]
    text = (
        f"Joint {j + 1}: friction at {belief.reference_speed_rad_s:g} rad/s and {belief.reference_temperature_c[j]:.1f} °C went from "
        f"{math.exp(level):.2f} to {math.exp(level + wear):.2f} N·m ({math.expm1(wear):+z.1%} ± {std:.1%}), temperature "
        f"taken out ({belief.slope[j]:.2%}/K); {evidence.replays} replays on {evidence.days} days in a row agree."
    )
    if parts is None:
        return text
    return (
        f"{text} Of the measured {math.expm1(parts.whole):+z.1%}, temperature makes {math.expm1(parts.temperature):+z.1%}, payload and "
        f"context {math.expm1(parts.payload):+z.1%}, wear {math.expm1(parts.wear):+z.1%}, chance {math.expm1(parts.rest):+z.1%}."
    )


def _trouble_text(condition: str, belief: Belief, j: int, evidence: Confirmations) -> str:
    T = belief.temperature_c[j]
    said = {
        TEMPERATURE_SENSOR: "tells no temperature, or none that can be believed",
        DATA_QUALITY: "is not resolved, or scatters more than the filter believes",
        OUTSIDE_RANGE: f"at {T:.1f} °C is outside the temperatures learnt so far",
    }
    return f"Joint {j + 1} {said[condition]}, in {evidence.replays} replays in a row."
