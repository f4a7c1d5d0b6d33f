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
from monitor.judge.alerts.conditions import CONDITIONS, RISES, noise_reason
from monitor.judge.alerts.evidence import Evidence, joint_rise_beside, raised_by_production, weigh_evidence
from monitor.judge.alerts.health import NO_CONFIRMATIONS, TIERS, Alert, Attribution, Confirmations, Health, JointHealth, Transition
from monitor.judge.alerts.life_cycle import OF_FRICTION, begin, next_transition, settle
from monitor.judge.alerts.states import arm_of, arm_state, attribute_changes, joint_state
from monitor.judge.belief import Belief
from monitor.judge.drift.maintenance import Maintenance
from monitor.judge.drift.undeclared import NO_UNDECLARED_CHANGE, UndeclaredChange
from monitor.judge.settings import AssessSettings
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
    settings: AssessSettings,
    undeclared: UndeclaredChange = NO_UNDECLARED_CHANGE,
    *,
    maintenance: tuple[Maintenance, ...] = (),
) -> Judgement:
    """Health after the belief's last replay.

    health : before the replay, None or without joints before the first one; undeclared : change that the replay contradicts the
    declarations by; maintenance : of joints, that this replay declares first, or judges.
    """
    at, J = belief.at_unix_s, belief.joints
    before = health or Health(joints=(), since_unix_s=at)
    if not before.joints:  # the first replay: there are at most alerts of the service's own
        before = replace(before, joints=tuple(JointHealth(joint=j + 1, since_unix_s=at) for j in range(J)), since_unix_s=at)
    begun = tuple(act for act in maintenance if act.declared_at_unix_s == at)
    evidence = weigh_evidence(belief.drift_state, settings.health)
    arm = ArmSituation(
        belief=belief,
        evidence=evidence,
        undeclared=undeclared,
        alerts={alert.key: alert for alert in before.alerts},
        settings=settings.health,
    )
    causes = attribute_changes(belief, settings.friction)
    situations = [_joint_situation(arm, *each) for each in zip(before.joints, causes, strict=True)]
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
    wear, unseen = belief.change_with_unfound(settings.friction), belief.unseen_step(settings.friction)
    joints = tuple(joint_state(situation, *wear, unseen, alerts) for situation in situations)
    state, why = arm_state(arm, joints, alerts)
    after = Health(
        state=state,
        why=why,
        since_unix_s=before.since_unix_s if state == before.state else at,
        joints=joints,
        alerts=alerts,
        confirmations=tuple(confirmations.items()),
    )
    return Judgement(after, tuple(transitions))


class ProductionJudgement(NamedTuple):
    """Health after a period of production, the changes of alerts that led to it, and what a replay shall confirm."""

    health: Health
    transitions: tuple[Transition, ...]
    asks: tuple[int, ...]  # joints (from 1) whose friction seems to have risen to a graver tier than production alone may raise


def judge_production(health: Health, belief: Belief, learnt: np.ndarray, settings: AssessSettings) -> ProductionJudgement:
    """Health after a period of production, the belief's last observation.

    Production says something of the friction of single joints. What most joints do together, and what is wrong with data or declarations,
    are for the replays to say. learnt : (J,) joints that were learned from.
    """
    at = belief.at_unix_s
    found = weigh_evidence(belief.drift_state, settings.health)
    evidence = found._replace(raises=raised_by_production(found.raises), falls=np.zeros_like(found.falls))
    arm = ArmSituation(
        belief=belief,
        evidence=evidence,
        undeclared=NO_UNDECLARED_CHANGE,
        alerts={alert.key: alert for alert in health.alerts},
        settings=settings.health,
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
                transition = next_transition(known.get((joint, name)), joint, condition, told, at, settings.health)
                if transition:
                    known[joint, name] = transition.alert
                    transitions.append(transition)
    alerts = tuple(known.values())
    wear, unseen = belief.change_with_unfound(settings.friction), belief.unseen_step(settings.friction)
    joints = tuple(
        joint_state(situation, *wear, unseen, alerts, of_replay=False) if learnt[situation.j] else situation.health
        for situation in situations
    )
    state, why = arm_of(joints, alerts)
    since = health.since_unix_s if state == health.state else at
    after = replace(health, state=state, why=why, since_unix_s=since, joints=joints, alerts=alerts)
    tiers = {alert.joint: TIERS.index(alert.tier) for alert in alerts if alert.active and alert.condition in RISES}
    alone = belief.unconfirmed
    asks = tuple(j + 1 for j in range(belief.joints) if learnt[j] and (alone[j] or found.raises[j] > tiers.get(j + 1, -1)))
    return ProductionJudgement(after, tuple(transitions), asks)


UNCONFIRMED = Sentence("unconfirmed", "Production shows this; no replay has confirmed it yet.")()


def _unconfirmed(text: Callable[[], Reason]) -> Reason:
    return together(text(), UNCONFIRMED)


def _after_maintenance(arm: ArmSituation, joint: JointHealth, learnt: bool) -> JointSituation:
    """One joint after a period of production."""
    after = replace(joint, learnt_at_unix_s=arm.belief.at_unix_s if learnt else joint.learnt_at_unix_s)
    return JointSituation(arm=arm, j=joint.joint - 1, health=after, attribution=None)


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


def _day(belief: Belief) -> int:
    """UTC day of the last replay, counted from 1970-01-01."""
    return math.floor(belief.at_unix_s / DAY_S)


def _joint_situation(arm: ArmSituation, joint: JointHealth, attribution: Attribution | None) -> JointSituation:
    """One joint after the replay, with the confirmations that the replay adds."""
    j, belief = joint.joint - 1, arm.belief
    counted = replace(joint, learnt_at_unix_s=belief.at_unix_s if belief.learnt_from[j] else joint.learnt_at_unix_s)
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


def why_not_alerting(health: Health, belief: Belief, joint: int, settings: AssessSettings) -> tuple[Reason, ...]:
    """What is missing between a joint (from 1) and its next tier of risen friction; empty where the highest tier is active."""
    waiting = [act for act in belief.maintenance if act.waiting and act.joint == joint]
    if waiting:
        return (waiting[-1].reason,)
    active = [alert for alert in health.active_alerts if alert.joint == joint and alert.condition in RISES]
    tier = TIERS.index(active[0].tier) + 1 if active else 0
    if tier >= len(TIERS):
        return ()
    evidence = weigh_evidence(belief.drift_state, settings.health)
    return (*_too_little_change(evidence, belief, joint - 1, tier, settings), *_unusable_replay(belief, joint - 1))


NEXT_TIER = Sentence("next_tier", "next is the {tier:word} tier, from {rise:+z.0%}; friction has changed by {change:+z.1%} ± {std:.1%}")
TOO_FEW_ODDS = Sentence(
    "too_few_odds",
    "chance alone comes as far as this joint once in {odds:.0f} days; a rise is told from {needed:.0f} on ({share:.0%} of the way, in "
    "logarithms)",
)
STANDS_OUT = Sentence(
    "stands_out", "that is {factor:.1f} times the usual {limit:.0f}: chance has moved this arm's joints by more than noise explains"
)
STILL_LEARNING = Sentence("still_learning", "{replays} replays have shown this joint; nothing is told before the {learning}th")
NOT_SURE = Sentence("not_sure", "P(more than {rise:.0%}) is {probability:.2f}; {required:.2f} is asked for")
TAUGHT_NOTHING = Sentence("taught_nothing", "the last replay taught nothing of this joint")()
UNKNOWN_TEMPERATURE = Sentence(
    "unknown_temperature", "the last replay does not tell this joint's temperature: it is learnt with more doubt"
)()
NEW_TEMPERATURES = Sentence("new_temperatures", "the last replay was outside the temperatures learnt so far")()


def _too_little_change(evidence: Evidence, belief: Belief, j: int, tier: int, settings: AssessSettings) -> list[Reason]:
    rise, model = settings.health.rises[tier], settings.friction
    mean, std = belief.change_with_unfound(model)
    reasons = [NEXT_TIER(tier=TIERS[tier], rise=rise, change=math.expm1(mean[j]), std=std[j])]
    beside = joint_rise_beside(evidence.beside, evidence.wear, j)
    if beside.found:
        reasons.append(beside.finding)
    if tier > 0:
        sure = (settings.health.wear_sure, settings.health.limit_sure)[tier - 1]
        return [*reasons, NOT_SURE(rise=rise, probability=evidence.above[j, tier], required=sure), noise_reason(belief, model, j)]
    odds = belief.odds_of_rise(model)
    share = math.log(max(odds.odds[j], 1.0)) / math.log(odds.needed[j])
    reasons.append(TOO_FEW_ODDS(odds=odds.odds[j], needed=odds.needed[j], share=min(share, 1.0)))
    if odds.needed[j] > odds.limit:
        reasons.append(STANDS_OUT(factor=odds.needed[j] / odds.limit, limit=odds.limit))
    if odds.replays[j] <= model.decision.learning_replays:
        reasons.append(STILL_LEARNING(replays=int(odds.replays[j]), learning=model.decision.learning_replays + 1))
    return [*reasons, noise_reason(belief, model, j)]


def _unusable_replay(belief: Belief, j: int) -> list[Reason]:
    if not belief.learnt_from[j]:
        return [TAUGHT_NOTHING]
    if not math.isfinite(belief.temperature_c[j]):
        return [UNKNOWN_TEMPERATURE]
    if not belief.inside_range[j]:
        return [NEW_TEMPERATURES]
    return []
