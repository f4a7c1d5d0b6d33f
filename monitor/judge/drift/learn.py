"""Evidence, belief → belief: the contexts compared, the filter aged and updated, the temperature laws learnt.

The filter's state and algebra are in `track.py`, `follow.py` and `kalman.py`, over any number of joints; here is one arm's.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.identify.warnings import DataWarning
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.belief import Belief, OpenedContext, comparable, differences, with_lasting_declarations
from monitor.judge.drift.change_detection import update_filter
from monitor.judge.drift.filter_state import (
    OUTLIER,
    SLOTS,
    STEP,
    UNRESOLVED,
    initial_filter,
    leave_context,
    open_slot,
    predict_filter,
    replace_joints,
    rescale_rate,
    update_interval,
)
from monitor.judge.drift.observation import DriftSettings, Observation, observe
from monitor.judge.drift.undeclared_change import NO_UNDECLARED_CHANGE, UndeclaredChange, find_undeclared_change, update_mass_estimate
from monitor.judge.drift.usage import no_usage, update_usage
from monitor.judge.temperature.laws import TemperatureSettings, initial_law, inside_range, reopen_law, update_law
from monitor.judge.temperature.stuck import stuck_sensors, update_sensors
from monitor.recording import Array, Context

SECONDS_PER_DAY = 86_400.0
CONTEXTS_KEPT = 16
WARMING_FAST_K_PER_MIN = 0.5  # as a cold UR5 does in the first quarter of an hour of work


class LearnResult(NamedTuple):
    """The belief after a replay, and what the reader must know of how it came about."""

    belief: Belief
    warnings: tuple[DataWarning, ...]
    undeclared: UndeclaredChange = NO_UNDECLARED_CHANGE


def begin(
    robot: str, context: Context, identification: Identification, at_unix_s: float, *, settings: DriftSettings, laws: TemperatureSettings
) -> Belief:
    """The belief before the first replay: no wear, an unknown level, the robot family's temperature slopes.

    Only T0 and the size of the slopes are taken from the identification; `learn` then learns from it as from any other.
    """
    seen = observe(identification, settings)
    state = initial_filter(
        seen,
        settings,
        fall_per_k=laws.viscous_fall_per_k,
        fall_std_per_k=laws.viscous_fall_std_per_k,
        coulomb_std_per_k=laws.coulomb_fall_std_per_k,
    )
    T0, J = state.origin_c, state.joints
    fc, fv = identification.coulomb_nm, identification.viscous_nm_s_per_rad
    unknown = np.full(J, np.nan)
    return Belief(
        robot=robot,
        reference_speed_rad_s=settings.reference_speed_rad_s,
        at_unix_s=at_unix_s,
        began_at_unix_s=at_unix_s,
        replays=0,
        days=0,
        contexts=(OpenedContext(comparable(context), at_unix_s, 0, 0),),
        reference_temperature_c=T0,
        filter_state=state,
        temperature_c=unknown,
        inside_range=np.zeros(J),
        first_log_torque=unknown,
        last_log_torque=unknown,
        first_temperature_c=unknown,
        usage=no_usage(J),
        mass_estimate=None,
        viscous=initial_law(T0, fv, fall_per_k=laws.viscous_fall_per_k, fall_std_per_k=laws.viscous_fall_std_per_k, scatter=laws.scatter),
        coulomb=initial_law(T0, fc, fall_per_k=0.0, fall_std_per_k=laws.coulomb_fall_std_per_k, scatter=laws.scatter),
    )


def predict_belief(belief: Belief, at_unix_s: float, settings: DriftSettings, revolutions: tuple[float, ...] | None = None) -> Belief:
    """The same belief at a later time, less sure: wear goes on at its rate, and the rate wanders. Silence never shrinks it.

    revolutions : of every joint until then, as `Context.revolutions`; None where nobody counts: every day is as usual.
    Raises BadInput for a time before the belief's, and for as many counts as the arm has not joints.
    """
    days = (at_unix_s - belief.at_unix_s) / SECONDS_PER_DAY
    if not days >= 0:
        raise BadInput(f"a belief of {belief.at_unix_s:.0f} s cannot be aged to {at_unix_s:.0f} s: that is before it")
    J = belief.joints
    if revolutions is not None and len(revolutions) != J:
        raise BadInput(f"context: revolutions has {len(revolutions)} figures; expected {J}, one a joint")
    each = np.full(J, days)
    done = update_usage(belief.usage, np.full(J, np.nan) if revolutions is None else np.array(revolutions, dtype=float), each)
    state = predict_filter(rescale_rate(belief.filter_state, done.factor), each, J, settings, done.usual_days)
    return replace(belief, filter_state=state, at_unix_s=at_unix_s, usage=done.usage)


def in_context(belief: Belief, context: Context, at_unix_s: float, laws: TemperatureSettings) -> tuple[Belief, bool]:
    """The belief in another context, and whether that was seen before: then its level is what it was, else it is unknown.

    Wear and its rate are kept with their doubt: wear that coincides with a change cannot be seen in a context never seen before.
    """
    ledger = list(belief.contexts)
    known = next((o for o in ledger if o.slot is not None and not differences(o.context, context)), None)
    if known is not None:
        ledger.remove(known)
        ledger.append(known)
        state = belief.filter_state
    else:
        taken = [o.slot for o in ledger if o.slot is not None]  # the one that is away the longest comes first
        slot = next((free for free in range(SLOTS) if free not in taken), taken[0])
        ledger = [o._replace(slot=None) if o.slot == slot else o for o in ledger]
        ledger.append(OpenedContext(comparable(context), at_unix_s, 0, slot))
        J = belief.joints
        state = open_slot(belief.filter_state, np.full(J, slot), np.ones(J, dtype=bool))
    moved = replace(
        belief,
        contexts=tuple(ledger[-CONTEXTS_KEPT:]),
        filter_state=leave_context(state, np.ones(belief.joints, dtype=bool)),
        mass_estimate=None,
        viscous=reopen_law(belief.viscous, laws),
        coulomb=reopen_law(belief.coulomb, laws),
    )
    return moved, known is not None


def learn(
    belief: Belief,
    identification: Identification,
    context: Context,
    at_unix_s: float,
    *,
    settings: DriftSettings,
    laws: TemperatureSettings,
    health: HealthSettings | None = None,
) -> LearnResult:
    """Evidence, belief → belief. The context is compared, the belief aged, T0 settled, the filter and the laws updated.

    Where the recording contradicts what was declared of it, nothing is learnt of wear.
    """
    context = with_lasting_declarations(belief.context, context)
    seen = observe(identification, settings)
    sensors = update_sensors(belief.sensors, seen.temperature_c)
    frozen = stuck_sensors(sensors)
    seen = seen._replace(temperature_c=np.where(frozen, np.nan, seen.temperature_c))
    warnings: list[DataWarning] = []
    if frozen.any():
        text = f"joints {numbers(frozen)}: the temperature sensor stands still while the other joints warm and cool: not believed"
        warnings.append(DataWarning("temperature_stuck", text))
    changed = differences(belief.context, context)
    if changed:
        exchanged = _exchanged(belief.context, context)
        belief, known = in_context(belief, context, at_unix_s, laws)
        then = "its baseline is known from before"
        if not known:
            then = "a new baseline begins, wear is carried over; wear that came with the change cannot be seen"
        if exchanged.any():
            belief = _with_new_joints(belief, exchanged, settings)
            then += f"; joints {numbers(exchanged)} were replaced: they begin without wear"
        warnings.append(DataWarning("context_changed", f"{'; '.join(changed)}: {then}"))
    said = find_undeclared_change(identification, belief.mass_estimate, health or HealthSettings())
    contradicted = said.condition is not None
    if contradicted:
        seen = seen._replace(log_torque=np.full(belief.joints, np.nan))
        warnings.append(DataWarning(str(said.condition), said.text))
    days = (at_unix_s - belief.at_unix_s) / SECONDS_PER_DAY
    new_day = belief.replays == 0 or math.floor(at_unix_s / SECONDS_PER_DAY) > math.floor(belief.at_unix_s / SECONDS_PER_DAY)
    belief = predict_belief(belief, at_unix_s, settings, context.revolutions)
    belief = replace(belief, filter_state=update_interval(belief.filter_state, np.full(belief.joints, days)))

    T = seen.temperature_c
    known_c = np.isfinite(T)
    if not known_c.all():
        text = f"joints {numbers(~known_c)}: no temperature: the replay is learnt with more doubt and counts for no alert"
        warnings.append(DataWarning("temperature_unknown", text))
    fast = np.abs(np.nan_to_num(seen.warming_k_per_min)) > WARMING_FAST_K_PER_MIN
    if fast.any():
        text = f"joints {numbers(fast)}: warming or cooling faster than {WARMING_FAST_K_PER_MIN:g} K/min: the grease lags behind the sensor"
        warnings.append(DataWarning("warming_fast", text))
    if belief.replays < settings.settle_replays:
        T0 = belief.reference_temperature_c
        T0 = T0 + (np.where(known_c, T, T0) - T0) / (belief.replays + 1)
        belief = replace(belief, reference_temperature_c=T0)
    inside = inside_range(belief.viscous.range_c, T, laws.margin_k)  # as learnt before this replay

    state = update_filter(belief.filter_state, seen, belief.slot, belief.joints, settings)
    belief = replace(_remembering_the_first(belief, seen, settings), filter_state=state)
    if not contradicted:
        warnings += _told(belief)
    unworn = np.where(belief.learnt_from & (not contradicted), np.exp(-belief.wear), np.nan)  # wear divided out, outliers left out
    now = belief.contexts[-1]
    return LearnResult(
        replace(
            belief,
            replays=belief.replays + 1,
            days=belief.days + new_day,
            contexts=(*belief.contexts[:-1], now._replace(replays=now.replays + 1)),
            temperature_c=T,
            sensors=sensors,
            inside_range=inside.astype(float),
            last_log_torque=seen.log_torque,
            mass_estimate=belief.mass_estimate if contradicted else update_mass_estimate(belief.mass_estimate, identification),
            viscous=update_law(belief.viscous, T, identification.viscous_nm_s_per_rad * unworn),
            coulomb=update_law(belief.coulomb, T, identification.coulomb_nm * unworn),
        ),
        tuple(warnings),
        said,
    )


def _exchanged(before: Context, after: Context) -> np.ndarray:
    """(J,) joints whose serial numbers are known to differ; a serial that was not known says nothing."""
    old, new = before.joint_serials, after.joint_serials
    if old is None or new is None or len(old) != len(new):
        return np.zeros(1, dtype=bool)
    return np.array([bool(a.strip() and b.strip() and a.strip() != b.strip()) for a, b in zip(old, new, strict=True)])


def _with_new_joints(belief: Belief, exchanged: np.ndarray, settings: DriftSettings) -> Belief:
    """Joints that were replaced have no wear, and nothing is known of their levels in any context."""
    return replace(
        belief,
        filter_state=replace_joints(belief.filter_state, exchanged, settings),
        first_log_torque=np.where(exchanged, np.nan, belief.first_log_torque),
        first_temperature_c=np.where(exchanged, np.nan, belief.first_temperature_c),
    )


def _remembering_the_first(belief: Belief, seen: Observation, settings: DriftSettings) -> Belief:
    """Means of the first replays as they were, nothing taken out."""
    n = belief.filter_state.replays  # (J,) before this one
    more = (n < settings.baseline_replays) & np.isfinite(seen.log_torque)

    def mean(old: Array, new: Array) -> Array:
        usable = more & np.isfinite(new)
        return np.where(usable, np.where(np.isfinite(old), old, new) + (new - np.where(np.isfinite(old), old, new)) / (n + 1.0), old)

    return replace(
        belief,
        first_log_torque=mean(belief.first_log_torque, seen.log_torque),
        first_temperature_c=mean(belief.first_temperature_c, seen.temperature_c),
    )


def _told(belief: Belief) -> list[DataWarning]:
    """What of the last update a reader must know."""
    warnings = []
    state = belief.filter_state
    for j in np.flatnonzero(belief.event == OUTLIER):
        text = f"joint {j + 1}: {state.innovation[j]:+z.1%} from the expected friction, {abs(state.normalised[j]):.1f} σ: not learnt from"
        warnings.append(DataWarning("outlier", text))
    for j in np.flatnonzero(belief.event == STEP):
        text = f"joint {j + 1}: {state.agreeing[j]:.0f} replays are best explained by a change of the joint: "
        text += f"wear is now {belief.wear[j]:+z.1%}"
        warnings.append(DataWarning("step", text))
    if (belief.event == UNRESOLVED).any():
        who, speed = numbers(belief.event == UNRESOLVED), belief.reference_speed_rad_s
        text = f"joints {who}: friction at {speed:g} rad/s is not resolved in this replay"
        warnings.append(DataWarning("joint_unseen", text))
    if (state.consistency > 2.5).any():  # 20 replays' mean of χ²(1): 2.5 is about 5 σ
        text = f"joints {numbers(state.consistency > 2.5)}: replays scatter more than the filter believes"
        warnings.append(DataWarning("filter_inconsistent", text))
    return warnings


def numbers(mask: np.ndarray) -> str:
    """The joints of a mask, counted from 1."""
    return " ".join(str(j + 1) for j in np.flatnonzero(mask))
