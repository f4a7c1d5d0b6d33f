"""One arm's replay, belief → belief: its context is compared, its joints go through the filter step, and a reader is warned."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.judge.belief import Belief
from monitor.judge.drift.contexts import (
    OpenedContext,
    comparable,
    declare_level,
    differences,
    enter,
    may_be_level,
    with_declarations_of,
    with_lasting_declarations,
)
from monitor.judge.drift.maintenance import MAINTENANCE, REPLACED, SERIALS, Maintenance, count_replay, judged
from monitor.judge.drift.ripple_track import update_ripple
from monitor.judge.drift.step import OUTLIER, STEP, UNRESOLVED, Replay, StepResult, initial_state, step
from monitor.judge.drift.undeclared import (
    NO_UNDECLARED_CHANGE,
    RigidFit,
    UndeclaredChange,
    Weights,
    another_gravity,
    declares_level,
    rigid_fit,
    weigh,
)
from monitor.judge.friction.observation import Observation, observe
from monitor.judge.maintenance import begin_maintenance, with_outcomes
from monitor.judge.settings import AssessSettings, HealthSettings
from monitor.reason import Reason, Sentence
from monitor.recording import DAY_S, FOREIGN_MOTION, Context

WARMING_FAST_K_PER_MIN = 0.5  # as a cold UR5 does in the first quarter of an hour of work
INCONSISTENT = 2.5  # mean of 20 normalised innovations squared, χ²(1) each: about 5 σ


class LearnResult(NamedTuple):
    """The belief after a replay, and the warnings that a reader of it needs."""

    belief: Belief
    warnings: tuple[Reason, ...]
    undeclared: UndeclaredChange = NO_UNDECLARED_CHANGE
    maintenance: tuple[
        Maintenance, ...
    ] = ()  # on joints: those that this replay's context declares first, and those that this replay judges


class ContextChange(NamedTuple):
    """A change of the declared context."""

    belief: Belief  # with the new context in force
    differences: list[str]
    opened: bool  # whether the level of the new context is unknown
    maintenance: tuple[Maintenance, ...]  # that the context declares first

    @property
    def replaced(self) -> np.ndarray:
        """(J,) joints with another serial number."""
        replaced = np.zeros(self.belief.joints, dtype=bool)
        replaced[[act.joint - 1 for act in self.maintenance if act.kind == REPLACED]] = True
        return replaced


def begin(robot: str, context: Context, identification: Identification, at_unix_s: float, settings: AssessSettings) -> Belief:
    """The belief before the first replay: no wear, unknown levels, the temperature slopes of the robot family.

    Only T0 and the size of the slopes are taken from the identification; `learn` then learns from it as from any other.
    """
    J = len(identification.coulomb_nm)
    state = initial_state(observe(identification, settings.drift), J, settings)
    unknown = np.full(J, np.nan)
    return Belief(
        robot=robot,
        reference_speed_rad_s=settings.drift.reference_speed_rad_s,
        at_unix_s=at_unix_s,
        began_at_unix_s=at_unix_s,
        replays=0,
        days=0,
        contexts=(OpenedContext(comparable(context), at_unix_s, 0, 0),),
        friction=state.friction,
        beside=state.beside,
        event=state.event,
        since_replay_days=state.since_replay_days,
        temperature_c=unknown,
        inside_range=np.zeros(J),
        first_log_torque=state.first_log_torque,
        last_log_torque=unknown,
        first_temperature_c=state.first_temperature_c,
        usage=state.usage,
        mass_estimate=None,
        viscous=state.viscous,
        coulomb=state.coulomb,
    )


def learn(
    belief: Belief,
    identification: Identification,
    context: Context,
    at_unix_s: float,
    settings: AssessSettings,
) -> LearnResult:
    """The belief after one more replay, by `step` over the arm's joints.

    Where the recording contradicts its declared context, the filter does not learn from it.
    Raises BadInput for a time before the belief's, and for revolutions of another number of joints.
    """
    observation = observe(identification, settings.drift)
    limits, fit = settings.health, rigid_fit(identification)
    change = enter_declared_context(belief, with_lasting_declarations(belief.context, context), at_unix_s, fit, settings)
    undeclared = another_gravity(identification)
    if undeclared.condition is None:
        change, undeclared = enter_undeclared_level(change, fit, at_unix_s, limits)
    moved = change.belief
    replay = Replay(
        observation=observation,
        days=np.array([_days_since(belief, at_unix_s)]),
        slot=moved.slot[:1],
        opened=np.array([change.opened]),
        replaced=change.replaced,
        awaiting_proof=moved.awaiting_proof,
        undeclared=np.array([undeclared.withheld]),
        revolutions=_revolutions(belief, context),
    )
    result = step(moved.drift_state, replay, settings)
    days = float(replay.days[0]) + float(belief.since_replay_days.max())  # since the last replay
    ripple = update_ripple(belief.ripple, identification.ripple, days, fresh=bool(change.differences))
    after = replace(_after(moved, result, at_unix_s), residual_peak_rad=identification.residual_peak_rad, ripple=ripple)
    after, settled = _judge_maintenance(after, limits)
    return LearnResult(after, tuple(_warnings(after, result, change, undeclared)), undeclared, (*change.maintenance, *settled))


def _judge_maintenance(belief: Belief, limits: HealthSettings) -> tuple[Belief, tuple[Maintenance, ...]]:
    """The belief with its works after one more replay, and those of them that this replay judges."""
    if not any(act.waiting for act in belief.maintenance):
        return belief, ()
    day, worn = math.floor(belief.at_unix_s / DAY_S), math.log1p(limits.clear_fraction * limits.wear_rise)
    counts = belief.learnt_from & np.isfinite(belief.temperature_c)

    def after(act: Maintenance) -> Maintenance:
        if not (act.waiting and counts[act.joint - 1]):
            return act
        counted = count_replay(act, day)
        return judged(counted, belief.friction, least_replays=limits.min_replays, least_days=limits.min_days, worn=worn)

    maintenance = tuple(after(act) for act in belief.maintenance)
    settled = tuple(now for before, now in zip(belief.maintenance, maintenance, strict=True) if before.waiting and not now.waiting)
    return with_outcomes(replace(belief, maintenance=maintenance), settled), settled


def enter_declared_context(belief: Belief, context: Context, at_unix_s: float, fit: RigidFit, settings: AssessSettings) -> ContextChange:
    """The belief with the replay's context in force, and with the work on joints that the context declares first."""
    changed = differences(belief.context, context)
    if not changed:
        return ContextChange(belief, changed, False, ())
    declared = _declared_maintenance(belief, context, at_unix_s)
    belief, maintenance = begin_maintenance(replace(belief, contexts=with_declarations_of(belief.contexts, context)), declared, settings)
    if not differences(belief.context, context):
        return ContextChange(belief, changed, False, maintenance)
    sigma, mass_kg = settings.health.contradiction_sigma, settings.health.contradiction_kg
    weights, level = belief.arm_weights, belief.arm_weights.level
    if level is not None and may_be_level(belief.contexts, context) and declares_level(weights, fit, sigma=sigma, mass_kg=mass_kg):
        belief = replace(belief, contexts=declare_level(belief.contexts, context))
        return ContextChange(belief.with_arm_weights(Weights(level.estimate)), changed, False, maintenance)
    contexts, opened = enter(belief.contexts, context, at_unix_s)
    weights = weights if _another_motion_only(belief.context, context) else Weights()
    return ContextChange(replace(belief, contexts=contexts).with_arm_weights(weights), changed, opened, maintenance)


def enter_undeclared_level(
    change: ContextChange, fit: RigidFit, at_unix_s: float, limits: HealthSettings
) -> tuple[ContextChange, UndeclaredChange]:
    """The belief with the weights of one more replay, and with that level in force to which they belong; what they contradict."""
    belief, sigma, mass_kg = change.belief, limits.contradiction_sigma, limits.contradiction_kg
    weights, undeclared = weigh(belief.arm_weights, fit, at_unix_s, sigma=sigma, mass_kg=mass_kg, declared_kg=belief.context.payload_kg)
    belief, opened = belief.with_arm_weights(weights), change.opened
    if undeclared.begins or (not undeclared.withheld and belief.contexts[-1].undeclared != undeclared.own_level):
        before = belief.contexts
        if opened:  # nothing is learnt in the declared context yet: its slot may hold the level of one that was displaced
            before = (*before[:-1], before[-1]._replace(slot=None))
        contexts, new = enter(before, belief.context, at_unix_s, undeclared=undeclared.own_level, begins=undeclared.begins)
        belief, opened = replace(belief, contexts=contexts), new
    return change._replace(belief=belief, opened=opened), undeclared


def _another_motion_only(before: Context, after: Context) -> bool:
    """Whether files from elsewhere differ in nothing but the motion: what the arm weighs does not depend on it."""
    named = after.trajectory_digest or ""
    return named.startswith(FOREIGN_MOTION) and not differences(replace(before, trajectory_digest=named), after)


def _declared_maintenance(belief: Belief, after: Context, at_unix_s: float) -> tuple[Maintenance, ...]:
    """Work on joints that a context declares, and the one before did not.

    A serial number that changes is a new joint. One that is declared for the first time may be: friction shows it. Another text of
    `maintenance` may be about any joint.
    """
    before = belief.context

    def act(joint: int, kind: str, why: str) -> Maintenance:
        return Maintenance(joint, kind, at_unix_s, at_unix_s, "declared in the configuration", why)

    old, new = before.joint_serials or (), after.joint_serials or ()
    maintenance: dict[int, Maintenance] = {}
    if before.maintenance != after.maintenance and after.maintenance:
        maintenance = {joint: act(joint, MAINTENANCE, after.maintenance) for joint in range(1, belief.joints + 1)}
    for joint in range(1, belief.joints + 1):
        was, now = (one[joint - 1].strip() if len(one) == belief.joints else "" for one in (old, new))
        if was and now and was != now:
            maintenance[joint] = act(joint, REPLACED, f"serial number {was} → {now}")
        elif now and not was and joint not in maintenance:
            maintenance[joint] = act(joint, SERIALS, f"serial number {now}, declared for the first time")
    return tuple(maintenance[joint] for joint in sorted(maintenance))


def _days_since(belief: Belief, at_unix_s: float) -> float:
    """Days since the belief's last replay. Raises BadInput for a time before it."""
    days = (at_unix_s - belief.at_unix_s) / DAY_S
    if not days >= 0:
        raise BadInput(f"a belief of {belief.at_unix_s:.0f} s cannot be aged to {at_unix_s:.0f} s: that is before it")
    return days


def _revolutions(belief: Belief, context: Context) -> np.ndarray | None:
    """(J,) counted until the replay, or None. Raises BadInput where they are not one per joint."""
    if context.revolutions is None:
        return None
    if len(context.revolutions) != belief.joints:
        raise BadInput(f"context: revolutions has {len(context.revolutions)} figures; expected {belief.joints}, one a joint")
    return np.array(context.revolutions, dtype=float)


def _after(belief: Belief, result: StepResult, at_unix_s: float) -> Belief:
    """The belief with one more replay in the context in force, and the state after it."""
    now = belief.contexts[-1]
    new_day = belief.replays == 0 or math.floor(at_unix_s / DAY_S) > math.floor(belief.at_unix_s / DAY_S)
    return replace(
        belief.with_drift_state(result.state),
        at_unix_s=at_unix_s,
        replays=belief.replays + 1,
        days=belief.days + new_day,
        contexts=(*belief.contexts[:-1], now._replace(replays=now.replays + 1)),
        temperature_c=result.observation.temperature_c,
        inside_range=result.inside_range.astype(float),
        last_log_torque=result.observation.log_torque,
        production=None if belief.production is None else replace(belief.production, asks=(), suspects=()),
    )


TEMPERATURE_STUCK = Sentence(
    "temperature_stuck", "joints {joints}: the temperature stands still, from replay to replay, as no working sensor's does: not believed"
)
CONTEXT_CHANGED = Sentence("context_changed", "{what}")
TEMPERATURE_UNKNOWN = Sentence("temperature_unknown", "joints {joints}: no temperature: the replay is learnt with more doubt")
WARMING_FAST = Sentence(
    "warming_fast", "joints {joints}: warming or cooling faster than {limit_k_per_min:g} K/min: the grease lags behind the sensor"
)
OUTLIER_REPLAY = Sentence("outlier", "{joint:joint}: {change:+z.1%} from the expected friction, {sigmas:.1f} σ: it counts for little")
STEP_FOUND = Sentence("step", "{what}")
STEP_TOGETHER = Sentence(
    "step_together", "joints {joints}: the last replays are best explained by a change of most joints together: it is no wear"
)
STEP_OF_JOINT = Sentence(
    "step_of_joint",
    "{joint:joint}: the replays of the last {days:.0f} days are best explained by a change of the joint: friction is now {change:+z.1%} "
    "from the beginning",
)
JOINT_UNSEEN = Sentence("joint_unseen", "joints {joints}: friction at {speed_rad_s:g} rad/s is not resolved in this replay")
FILTER_INCONSISTENT = Sentence("filter_inconsistent", "joints {joints}: replays scatter more than is believed")


def _warnings(belief: Belief, result: StepResult, change: ContextChange, undeclared: UndeclaredChange) -> list[Reason]:
    """The warnings of a replay, in the order of the step's stages."""
    warnings = []
    if result.stuck.any():
        warnings.append(TEMPERATURE_STUCK(joints=joint_numbers(result.stuck)))
    if change.differences:
        warnings.append(CONTEXT_CHANGED(what=_change_text(change)))
    if undeclared.condition is not None:
        warnings.append(Reason(undeclared.condition, undeclared.reason.parameters, undeclared.reason.text))
    warnings += _temperature_warnings(result.observation)
    if not undeclared.withheld:
        warnings += _filter_warnings(belief)
    return warnings


def _change_text(change: ContextChange) -> str:
    """What changed in the context, and what becomes of the baseline."""
    then = "its baseline is known from before"
    if change.opened:
        then = "a new baseline begins, wear is carried over; wear that came with the change cannot be seen"
    elif any(act.waiting for act in change.maintenance):
        then = "work may have moved friction either way; the next replays show by how much"
    if change.replaced.any():
        then += f"; joints {joint_numbers(change.replaced)} were replaced: they begin without wear"
    return f"{'; '.join(change.differences)}: {then}"


def _temperature_warnings(observation: Observation) -> list[Reason]:
    """Warnings of temperatures that are unknown or change fast."""
    warnings = []
    unknown = ~np.isfinite(observation.temperature_c)
    if unknown.any():
        warnings.append(TEMPERATURE_UNKNOWN(joints=joint_numbers(unknown)))
    fast = np.abs(np.nan_to_num(observation.warming_k_per_min)) > WARMING_FAST_K_PER_MIN
    if fast.any():
        warnings.append(WARMING_FAST(joints=joint_numbers(fast), limit_k_per_min=WARMING_FAST_K_PER_MIN))
    return warnings


def _filter_warnings(belief: Belief) -> list[Reason]:
    """Warnings of what the filter made of the replay."""
    warnings = []
    state = belief.friction
    innovation, sigmas, change = state.of_joints(state.innovation), np.abs(state.of_joints(state.normalised)), belief.change
    for j in np.flatnonzero(belief.event == OUTLIER):
        warnings.append(OUTLIER_REPLAY(joint=j + 1, change=innovation[j], sigmas=sigmas[j]))
    together = (belief.event == STEP) & bool(state.told.common.any())
    if together.any():
        warnings.append(STEP_FOUND(what=STEP_TOGETHER(joints=joint_numbers(together))))
    for j in np.flatnonzero((belief.event == STEP) & ~together):
        warnings.append(STEP_FOUND(what=STEP_OF_JOINT(joint=j + 1, days=belief.found(int(j)).began_days, change=change[j])))
    unresolved = belief.event == UNRESOLVED
    if unresolved.any():
        warnings.append(JOINT_UNSEEN(joints=joint_numbers(unresolved), speed_rad_s=belief.reference_speed_rad_s))
    inconsistent = belief.consistency > INCONSISTENT
    if inconsistent.any():
        warnings.append(FILTER_INCONSISTENT(joints=joint_numbers(inconsistent)))
    return warnings


def joint_numbers(mask: np.ndarray) -> str:
    """The joints of a mask (J,), counted from 1."""
    return " ".join(str(j + 1) for j in np.flatnonzero(mask))
