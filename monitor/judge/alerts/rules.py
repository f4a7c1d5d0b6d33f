"""Belief → health: which alerts a replay raises, updates or clears, and the state of every joint.

`evidence` weighs changed friction over the joints of an arm. `conditions` says what each condition makes of it. Here the conditions of
one arm are evaluated in their order and carried through the life of their alerts.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from monitor.judge.alerts.condition import AlertCondition, ArmSituation, ConditionStatus, JointSituation
from monitor.judge.alerts.conditions import CONDITIONS, RISES
from monitor.judge.alerts.evidence import (
    FALLING,
    Counts,
    Evidence,
    advisory_sigmas,
    counts_of,
    joint_channel_rise,
    raised_by_production,
    required_of_joints,
    wear_after_replay,
    weigh_evidence,
)
from monitor.judge.alerts.health import NO_CONFIRMATIONS, TIERS, Alert, Attribution, Confirmations, Health, JointHealth, Transition
from monitor.judge.alerts.life_cycle import OF_FRICTION, begin, next_transition, settle, without_confirmations
from monitor.judge.alerts.states import arm_of, arm_state, attribute_changes, joint_state
from monitor.judge.belief import Belief
from monitor.judge.drift.maintenance import Maintenance
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.undeclared import NO_UNDECLARED_CHANGE, UndeclaredChange
from monitor.judge.settings import HealthSettings
from monitor.reason import Reason, Sentence, together
from monitor.recording import DAY_S

Statuses = list[tuple[int | None, AlertCondition, ConditionStatus]]  # joint (None: the arm), condition, status


class Judgement(NamedTuple):
    """Health after a replay, and the changes of alerts that led to it."""

    health: Health
    transitions: tuple[Transition, ...]


def judge(
    health: Health | None,
    belief: Belief,
    settings: HealthSettings,
    undeclared: UndeclaredChange = NO_UNDECLARED_CHANGE,
    *,
    drift: DriftSettings | None = None,
    maintenance: tuple[Maintenance, ...] = (),
) -> Judgement:
    """Health after the belief's last replay.

    health : before the replay, None or without joints before the first one; undeclared : change that the replay contradicts the
    declarations by; drift : for the published figure of wear, which alerts do not depend on;
    maintenance : of joints, that this replay declares first, or judges.
    """
    at, J = belief.at_unix_s, belief.joints
    before = health or Health(joints=(), since_unix_s=at)
    if not before.joints:  # the first replay: there are at most alerts of the service's own
        before = replace(before, joints=tuple(JointHealth(joint=j + 1, since_unix_s=at) for j in range(J)), since_unix_s=at)
    begun = tuple(act for act in maintenance if act.declared_at_unix_s == at)
    before = replace(before, joints=tuple(without_confirmations(joint, begun) for joint in before.joints))
    evidence = _evidence(belief, before, settings, undeclared)
    arm = ArmSituation(
        belief=belief,
        evidence=evidence,
        undeclared=undeclared,
        common=_common(evidence.counts),
        alerts={alert.key: alert for alert in before.alerts},
        settings=settings,
    )
    situations = [_joint_situation(arm, *each) for each in zip(before.joints, attribute_changes(belief), strict=True)]
    confirmations = _confirm_arm(arm, dict(before.confirmations))
    statuses = [each for situation in situations for each in _joint_statuses(situation)] + _arm_statuses(arm, confirmations)

    known, transitions = dict(arm.alerts), []
    for declared in (each for act in begun for each in begin(dict(known), act, at)):
        known[declared.alert.key] = declared.alert
        transitions.append(declared)
    settled = {act.joint: act for act in maintenance if act not in begun}
    for joint, condition, status in statuses:
        transition = _next(known.get((joint, condition.name)), joint, condition, status, settled, arm)
        if transition:
            known[joint, condition.name] = transition.alert
            transitions.append(transition)
    alerts = tuple(known.values())
    published = drift or DriftSettings()
    wear, unseen = belief.wear_with_undetected(published), belief.unseen_step(published)
    joints = tuple(joint_state(situation, *wear, unseen, alerts) for situation in situations)
    state, why = arm_state(arm, joints, alerts)
    after = Health(
        state=state,
        why=why,
        since_unix_s=before.since_unix_s if state == before.state else at,
        joints=joints,
        alerts=alerts,
        common=arm.common,
        confirmations=tuple(confirmations.items()),
    )
    return Judgement(after, tuple(transitions))


class ProductionJudgement(NamedTuple):
    """Health after a period of production, the changes of alerts that led to it, and what a replay shall confirm."""

    health: Health
    transitions: tuple[Transition, ...]
    asks: tuple[int, ...]  # joints (from 1) whose friction seems to have risen to a graver tier than production alone may raise


def judge_production(
    health: Health, belief: Belief, usable: np.ndarray, learnt: np.ndarray, settings: HealthSettings, *, drift: DriftSettings
) -> ProductionJudgement:
    """Health after a period of production, the belief's last observation.

    Production says something of the friction of single joints. What most joints do together, and what is wrong with data or declarations,
    are for the replays to say. usable : (J,) joints whose production counts for or against a change; learnt : (J,) that were learned from.
    """
    at = belief.at_unix_s
    evidence = weigh_evidence(wear_after_replay(belief, usable & ~belief.awaiting_proof), counts_of(health), belief.joints, settings)
    wanted, evidence = evidence.raises, evidence._replace(raises=raised_by_production(evidence), falls=np.zeros_like(evidence.falls))
    arm = ArmSituation(
        belief=belief,
        evidence=evidence,
        undeclared=NO_UNDECLARED_CHANGE,
        common=health.common,
        alerts={alert.key: alert for alert in health.alerts},
        settings=settings,
    )
    situations = [_after_maintenance(arm, joint, bool(learnt[joint.joint - 1])) for joint in health.joints]
    known, transitions = dict(arm.alerts), []
    for situation in situations:
        joint = situation.health.joint
        if not learnt[joint - 1] or belief.awaiting_proof[joint - 1]:
            continue
        for name in RISES:
            condition = CONDITIONS[name]
            assert condition.joint is not None
            status = condition.joint.status(situation, NO_CONFIRMATIONS)
            if status is not None:
                told = status._replace(text=partial(_unconfirmed, status.text), from_production=True)
                transition = next_transition(known.get((joint, name)), joint, condition, told, at, settings)
                if transition:
                    known[joint, name] = transition.alert
                    transitions.append(transition)
    alerts = tuple(known.values())
    wear, unseen = belief.wear_with_undetected(drift), belief.unseen_step(drift)
    joints = tuple(
        joint_state(situation, *wear, unseen, alerts, of_replay=False) if learnt[situation.j] else situation.health
        for situation in situations
    )
    state, why = arm_of(joints, alerts)
    since = health.since_unix_s if state == health.state else at
    after = replace(health, state=state, why=why, since_unix_s=since, joints=joints, alerts=alerts)
    tiers = {alert.joint: TIERS.index(alert.tier) for alert in alerts if alert.active and alert.condition in RISES}
    asks = tuple(j + 1 for j in range(belief.joints) if learnt[j] and wanted[j] > tiers.get(j + 1, -1))
    return ProductionJudgement(after, tuple(transitions), asks)


UNCONFIRMED = Sentence("unconfirmed", "Production shows this; no replay has confirmed it yet.")()


def _unconfirmed(text: Callable[[], Reason]) -> Reason:
    return together(text(), UNCONFIRMED)


def _after_maintenance(arm: ArmSituation, joint: JointHealth, learnt: bool) -> JointSituation:
    """One joint after a period of production, with the confirmations that it adds."""
    j, counts = joint.joint - 1, arm.evidence.counts
    friction = [Confirmations(int(counts.replays[j, k]), int(counts.days[j, k]), int(counts.last_day[j, k])) for k in range(FALLING + 1)]
    counted = replace(
        joint,
        rising=tuple(friction[:FALLING]),
        falling=friction[FALLING],
        learnt_at_unix_s=arm.belief.at_unix_s if learnt else joint.learnt_at_unix_s,
    )
    return JointSituation(arm=arm, j=j, health=counted, attribution=None)


def _next(
    alert: Alert | None,
    joint: int | None,
    condition: AlertCondition,
    status: ConditionStatus,
    settled: Mapping[int, Maintenance],
    arm: ArmSituation,
) -> Transition | None:
    """What becomes of an alert after this replay. settled : maintenance that it judges, by joint."""
    at = arm.belief.at_unix_s
    if condition.name in OF_FRICTION and joint is not None:
        act = settled.get(joint)
        if arm.belief.awaiting_proof[joint - 1]:
            return None  # the maintenance is not judged yet
        if act is not None and alert is not None and alert.active:
            transition = settle(alert, act, status, at, condition.action(alert.tier))
            if transition is not None:
                return transition
    return next_transition(alert, joint, condition, status, at, arm.settings)


def _evidence(belief: Belief, before: Health, settings: HealthSettings, undeclared: UndeclaredChange) -> Evidence:
    """The evidence of changed friction after the last replay.

    It counts for the joints that it updated inside the learned range, where no maintenance of them waits to be judged.
    """
    usable = belief.learnt_from & (belief.inside_range > 0) & (not undeclared.withheld) & ~belief.awaiting_proof
    return weigh_evidence(wear_after_replay(belief, usable), counts_of(before), belief.joints, settings)


def _day(belief: Belief) -> int:
    """UTC day of the last replay, counted from 1970-01-01."""
    return math.floor(belief.at_unix_s / DAY_S)


def _common(counts: Counts) -> Confirmations:
    return Confirmations(int(counts.arm_replays[0]), int(counts.arm_days[0]), int(counts.arm_last_day[0]))


def _joint_situation(arm: ArmSituation, joint: JointHealth, attribution: Attribution | None) -> JointSituation:
    """One joint after the replay, with the confirmations that the replay adds."""
    j, counts, belief = joint.joint - 1, arm.evidence.counts, arm.belief
    friction = [Confirmations(int(counts.replays[j, k]), int(counts.days[j, k]), int(counts.last_day[j, k])) for k in range(FALLING + 1)]
    counted = replace(
        joint,
        rising=tuple(friction[:FALLING]),
        falling=friction[FALLING],
        learnt_at_unix_s=belief.at_unix_s if belief.learnt_from[j] else joint.learnt_at_unix_s,
    )
    situation = JointSituation(arm=arm, j=j, health=counted, attribution=attribution)
    before, confirmations = dict(joint.confirmations), {}
    for name, condition in CONDITIONS.items():
        if condition.joint is not None and condition.joint.shows is not None:
            confirmations[name] = _confirm(condition.joint.shows(situation), before.get(name, NO_CONFIRMATIONS), _day(belief))
    return replace(situation, health=replace(counted, confirmations=tuple(confirmations.items())))


def _confirm_arm(arm: ArmSituation, before: Mapping[str, Confirmations]) -> dict[str, Confirmations]:
    """Confirmations of the arm's conditions, of those alone that a replay has ever shown."""
    confirmations = {}
    for name, condition in CONDITIONS.items():
        if condition.arm is not None and condition.arm.shows is not None:
            shows = condition.arm.shows(arm)
            if shows or name in before:
                confirmations[name] = _confirm(shows, before.get(name, NO_CONFIRMATIONS), _day(arm.belief))
    return confirmations


def _confirm(shows: bool | None, before: Confirmations, day: int) -> Confirmations:
    """Confirmations with one more replay; none after one that does not show the condition, those of before after one that cannot tell."""
    if shows is None:
        return before
    return Confirmations(before.replays + 1, before.days + (day != before.last_day), day) if shows else NO_CONFIRMATIONS


def _joint_statuses(situation: JointSituation) -> Statuses:
    confirmations = dict(situation.health.confirmations)
    found: Statuses = []
    for name, condition in CONDITIONS.items():
        if condition.joint is not None:
            status = condition.joint.status(situation, confirmations.get(name, NO_CONFIRMATIONS))
            if status is not None:
                found.append((situation.health.joint, condition, status))
    return found


def _arm_statuses(arm: ArmSituation, confirmations: Mapping[str, Confirmations]) -> Statuses:
    found: Statuses = []
    for name, condition in CONDITIONS.items():
        if condition.arm is not None and (condition.arm.shows is None or name in confirmations):
            status = condition.arm.status(arm, confirmations.get(name, NO_CONFIRMATIONS))
            if status is not None:
                found.append((None, condition, status))
    return found


# --- Why a joint does not alert --------------------------------------------------------------------------


def why_not_alerting(health: Health, belief: Belief, joint: int, settings: HealthSettings) -> tuple[Reason, ...]:
    """What is missing between a joint (from 1) and its next tier of risen friction; empty where the highest tier is active."""
    waiting = [act for act in belief.maintenance if act.waiting and act.joint == joint]
    if waiting:
        return (waiting[-1].reason,)
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


NEXT_TIER = Sentence("next_tier", "next is the {tier:word} tier, from {rise:+z.0%}; friction has changed by {change:+z.1%} ± {std:.1%}")
RISEN_TOGETHER = Sentence("risen_together", "all joints have risen together by {change:+z.1%}: that is taken off")
TOO_FEW_SIGMAS = Sentence("too_few_sigmas", "that is {sigmas:z.1f} of its standard deviations; {required:.1f} are asked for")
BELOW = Sentence("below_tier", "it is below {rise:+z.0%}")
NOT_SURE = Sentence("not_sure", "P(more than {rise:.0%}) is {probability:.2f}; {required:.2f} is asked for")
TAUGHT_NOTHING = Sentence("taught_nothing", "the last replay taught nothing of this joint")()
UNKNOWN_TEMPERATURE = Sentence("unknown_temperature", "the last replay does not tell this joint's temperature: it counts for no alert")()
NEW_TEMPERATURES = Sentence("new_temperatures", "the last replay was outside the temperatures learnt so far")()
TOO_FEW_REPLAYS = Sentence("too_few_replays", "{replays} replays on {days} days in a row agree; {min_replays} on {min_days} are asked for")


def _too_little_change(evidence: Evidence, belief: Belief, j: int, tier: int, settings: HealthSettings) -> list[Reason]:
    rise, change = settings.rises[tier], math.expm1(evidence.excess[j])
    reasons = [NEXT_TIER(tier=TIERS[tier], rise=rise, change=change, std=belief.wear_std[j])]
    channels = joint_channel_rise(evidence.channels, evidence.excess, j)
    if channels.found:
        reasons.append(channels.finding)
    if evidence.common[0] > 0:
        reasons.append(RISEN_TOGETHER(change=math.expm1(evidence.common[0])))
    required = advisory_sigmas(belief.joints, settings)
    if tier == 0:
        required = float(required_of_joints(wear_after_replay(belief, belief.learnt_from), required)[j])
    if evidence.sigmas[j] < required:
        reasons.append(TOO_FEW_SIGMAS(sigmas=evidence.sigmas[j], required=required))
    if tier == 0 and change < rise:
        reasons.append(BELOW(rise=rise))
    if tier > 0 and evidence.above[j, tier] < (sure := (settings.wear_sure, settings.limit_sure)[tier - 1]):
        reasons.append(NOT_SURE(rise=rise, probability=evidence.above[j, tier], required=sure))
    return reasons


def _unusable_replay(belief: Belief, j: int) -> list[Reason]:
    if not belief.learnt_from[j]:
        return [TAUGHT_NOTHING]
    if not math.isfinite(belief.temperature_c[j]):
        return [UNKNOWN_TEMPERATURE]
    if not belief.inside_range[j]:
        return [NEW_TEMPERATURES]
    return []


def _too_few_replays(health: Health, j: int, tier: int, settings: HealthSettings) -> list[Reason]:
    counted = health.joints[j].rising[tier]
    if counted.replays >= settings.min_replays and counted.days >= settings.min_days:
        return []
    required = {"min_replays": settings.min_replays, "min_days": settings.min_days}
    return [TOO_FEW_REPLAYS(replays=counted.replays, days=counted.days, **required)]
