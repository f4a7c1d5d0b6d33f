"""NE 107 states of joints and arm: the gravest of everything that holds, and why; what changed friction, what is stale or unseen."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from monitor.judge.alerts.condition import ArmSituation, JointSituation
from monitor.judge.alerts.conditions import CONDITIONS, outside_learnt_range
from monitor.judge.alerts.health import (
    CHECK_FUNCTION,
    NORMAL,
    OFF_SPEC,
    STATES,
    Alert,
    Attribution,
    Health,
    HealthSettings,
    JointHealth,
    State,
)
from monitor.judge.belief import Belief
from monitor.judge.drift.filter_state import LEVELS, OUTLIER, UNRESOLVED
from monitor.judge.drift.undetected_change import UnseenStep
from monitor.reason import joint_name, joint_text
from monitor.recording import DAY_S, Array

KNOWN_VAR = 1.0  # [log²] a level that any replay has taught is far better known, one of no replay far worse


def attribute_changes(belief: Belief) -> tuple[Attribution | None, ...]:
    """The causes of the change of every joint since its first replays; None before there is a change to attribute."""
    filter_state = belief.filter_state
    whole = belief.last_log_torque - belief.first_log_torque  # (J,) as all below
    T0 = np.where(np.isfinite(belief.first_temperature_c), belief.first_temperature_c, belief.reference_temperature_c)
    T = np.where(np.isfinite(belief.temperature_c), belief.temperature_c, T0)
    slot = belief.contexts[-1].slot or 0
    now, first = np.full(belief.joints, slot), np.array([_first_slot(belief, j, slot) for j in range(belief.joints)])
    at_first, at_now, at_last = (filter_state.steady_mean(t, slot) for t, slot in ((T0, first), (T0, now), (T, now)))
    temperature, payload, wear = at_last - at_now, at_now - at_first, filter_state.change
    parts = np.stack([whole, temperature, payload, wear, whole - temperature - payload - wear], axis=1)  # (J, 5)
    return tuple(Attribution(*of_joint) if math.isfinite(of_joint[0]) else None for of_joint in parts.tolist())


def _first_slot(belief: Belief, j: int, slot: int) -> int:
    """The slot of the oldest baseline that is still kept and known of joint j; that in force where none is.

    A level that is not known, as after a replacement, is no reference: the difference to it would be the logarithm of a torque.
    """
    state = belief.filter_state
    known = [
        context
        for context in belief.contexts
        if context.slot is not None and state.cov[j, LEVELS + context.slot, LEVELS + context.slot] < KNOWN_VAR
    ]
    return (min(known, key=lambda context: context.opened_at_unix_s).slot or 0) if known else slot


# --- Which joints no replay has updated for a long time --------------------------------------------------


def stale_joints(health: Health, now_unix_s: float, settings: HealthSettings) -> tuple[bool, ...]:
    """(J,) whether the last replay that updated a joint is older than `stale_days`, or there is none."""
    limit = now_unix_s - settings.stale_days * DAY_S
    return tuple(joint.learnt_at_unix_s is None or joint.learnt_at_unix_s < limit for joint in health.joints)


def stale_text(stale: Sequence[int], joints: int, since: str, then: str) -> str:
    """The sentence that bus, page and report publish of stale joints.

    stale : numbers of the stale joints, from 1; joints : J; since : for how long; then : the time that the state does not stand for.
    """
    who = "all joints" if len(stale) == joints else ", ".join(map(joint_name, stale))
    return f"STALE: {who}: nothing was learnt {since}: the state is of then, not of {then}"


# --- Which steps of friction may be unseen yet -----------------------------------------------------------


def unseen_step_text(rise: float, days: float) -> str:
    """Of one joint; rise : fraction."""
    return f"a step of the last {days:.0f} days up to {rise:.0%} may be unseen"


def unseen_steps_text(friction: Sequence[Mapping[str, Any]]) -> str:
    """Of all joints, from their friction documents; empty where nothing is known, as in documents of older releases."""
    known = [row for row in friction if row.get("unseen_step") is not None]
    if not known:
        return ""
    each = ", ".join(f"{joint_name(row['joint'])} {row['unseen_step']:.0%}" for row in known)
    days = max(row["unseen_step_days"] for row in known)
    return f"The ± of wear does not hold for a fresh step: one of the last {days:.0f} days may be unseen up to {each}."


# --- NE 107 states of the joints and of the arm after a replay -------------------------------------------

Reason = tuple[State, str]


def joint_state(
    situation: JointSituation, wear: Array, wear_std: Array, unseen: UnseenStep, alerts: tuple[Alert, ...], *, of_replay: bool = True
) -> JointHealth:
    """The joint's health with its state after a replay.

    wear, wear_std, unseen : (J,) logarithm of friction torque, as it is published; alerts : of the arm and all joints, after the replay.
    of_replay : whether it follows a replay, and not ordinary work.
    """
    joint, belief = situation.health, situation.belief
    j = situation.j
    act = belief.counted_since(joint.joint)
    since = "the beginning" if act is None else f"it {act.verb} on {act.day}"
    normal = f"friction {math.expm1(wear[j]):+z.1%} ± {wear_std[j]:.1%} since {since}"
    if math.isfinite(unseen.days[j]):
        normal += f"; {unseen_step_text(math.expm1(unseen.log_rise[j]), unseen.days[j])}"
    waiting = [one.text for one in belief.maintenance if one.waiting and one.joint == joint.joint]
    state, why = joint_of(joint.joint, waiting[-1] if waiting else normal, alerts, _of_replay(situation) if of_replay else ())
    return replace(joint, state=state, why=why, since_unix_s=joint.since_unix_s if state == joint.state else belief.at_unix_s)


def joint_of(joint: int, normal: str, alerts: tuple[Alert, ...], others: Sequence[Reason] = ()) -> tuple[State, str]:
    """State of a joint (from 1) and why, by its active alerts and `others`. normal : what is said where nothing speaks against it."""
    active = [alert for alert in alerts if alert.active and alert.joint == joint]
    return max([(NORMAL, normal), *others, *map(_of_alert, active)], key=_precedence)


def arm_state(situation: ArmSituation, joints: tuple[JointHealth, ...], alerts: tuple[Alert, ...]) -> tuple[str, str]:
    """The gravest state of the joints and of the arm's own alerts, and why."""
    undeclared = situation.undeclared
    return arm_of(joints, alerts, () if undeclared.condition is None else ((CHECK_FUNCTION, undeclared.text),))


def with_service_alert(health: Health, alert: Alert, at_unix_s: float) -> Health:
    """The health with a changed alert of the service's own, and with the arm's state as that alert makes it.

    The state is the gravest truth: a monitor that learns nothing does not go on saying NORMAL. A health without joints, before the first
    assessment, has no state; and an alert without a predicate of its own changes the state with the next replay.
    """
    condition = CONDITIONS.get(alert.condition)
    alerts = tuple(({other.key: other for other in health.alerts} | {alert.key: alert}).values())
    if not health.joints or condition is None or condition.service is None:
        return replace(health, alerts=alerts)
    state, why = arm_of(health.joints, alerts)
    since = health.since_unix_s if state == health.state else at_unix_s
    return replace(health, alerts=alerts, state=state, why=why, since_unix_s=since)


def arm_of(joints: tuple[JointHealth, ...], alerts: tuple[Alert, ...], others: Sequence[Reason] = ()) -> tuple[str, str]:
    """State of the arm and why, by its joints, its own active alerts and `others`, which come first of equally grave ones."""
    reasons = [*others, *((joint.state, f"{joint_text(joint.joint)}: {joint.why}") for joint in joints)]
    reasons += [(_state_of(alert), f"{alert.condition}: {alert.text}") for alert in alerts if alert.active and alert.joint is None]
    state, why = max(reasons, key=_precedence)
    if state != NORMAL:
        return state, why
    noticed = {alert.joint for alert in alerts if alert.active}
    notices = [f"{joint_text(joint.joint)}: {joint.why}" for joint in joints if joint.joint in noticed]
    return NORMAL, f"no action is needed; {notices[0]}" if notices else "all joints are as they were at the beginning"


def _of_replay(situation: JointSituation) -> list[Reason]:
    """What one replay says before any alert is raised."""
    belief, j, undeclared = situation.belief, situation.j, situation.arm.undeclared
    reasons: list[Reason] = []
    if undeclared.withheld:
        reasons.append((CHECK_FUNCTION, f"nothing is learnt of wear: {undeclared.text}"))
    elif belief.event[j] == UNRESOLVED:
        reasons.append((CHECK_FUNCTION, "the last replay does not resolve this joint's friction"))
    if belief.event[j] == OUTLIER:
        reasons.append((CHECK_FUNCTION, f"the last replay is {belief.filter_state.innovation[j]:+z.1%} off: waiting for the next"))
    if outside_learnt_range(situation):
        reasons.append((OFF_SPEC, f"{belief.temperature_c[j]:.1f} °C is outside the temperatures learnt so far"))
    return reasons


def _of_alert(alert: Alert) -> Reason:
    """State and reason of a joint with an active alert."""
    if alert.awaiting_proof:
        return CHECK_FUNCTION, alert.text
    condition = CONDITIONS.get(alert.condition)
    of_friction = condition is not None and condition.probability_of is not None
    change = f": {alert.change:+z.1%}" if of_friction else ""  # the change of other conditions is 0
    return _state_of(alert), f"{alert.condition} ({alert.tier}){change}"


def _state_of(alert: Alert) -> State:
    """An alert whose condition or tier this release does not know, for example one that a later release raised, is to be checked."""
    condition = CONDITIONS.get(alert.condition)
    return condition.tiers[alert.tier].state if condition is not None and alert.tier in condition.tiers else CHECK_FUNCTION


def _precedence(reason: tuple[str, str]) -> int:
    """The later in `STATES`, the graver; of equally grave reasons the first one is given."""
    return STATES.index(reason[0])
