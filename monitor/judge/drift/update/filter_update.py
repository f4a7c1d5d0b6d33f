"""The filter's update by one replay: gate it, detect sudden changes, update the state, estimate the noise."""

from dataclasses import replace

import numpy as np

from monitor.judge.drift.filter_state import (
    LEVELS,
    NOISE,
    ORDINARY,
    OUTLIER,
    PRODUCTION_LEVEL,
    SETTLING,
    SLOPE,
    STATES,
    STEP,
    UNRESOLVED,
    WEAR,
    FilterState,
)
from monitor.judge.drift.kalman import update
from monitor.judge.drift.noise.chance import forget_chance, learn_chance
from monitor.judge.drift.noise.size import STEADY, counted_sigma, follow
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.reference import with_common_change
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.two_sources import TwoSources
from monitor.judge.drift.update.change_detection import LONG, Change, advance_bank, detect_change, stays
from monitor.judge.drift.update.innovation import Gate, Innovation, Noise, gate_outliers, innovate
from monitor.judge.drift.update.lowest_level import may_run_in, running_in
from monitor.judge.drift.wear_history import add_replay, move_level
from monitor.recording import Array

OFTEN, FEWEST = 0.1, 3  # share and number of outliers from which they are the joint's noise, and no longer left out of it
NOISE_KNOWN = 12  # [replays] before, size and correlation of the noise are too uncertain to tell what else chance does
CONSISTENCY_REPLAYS = 20.0  # memory of the mean of normalised innovations squared
LEVELS_KNOWN_VAR = 0.02**2  # [log²] of both levels: before, an observation from production says little of the course of friction
HELD_SIGMAS = 1.5  # [σ] of wear below which observations speak against a rise that was found before
CLIPPED = 3.0  # [σ] one replay changes the noise estimate by no more than a residual of this size


def update_filter(
    state: FilterState,
    observation: Observation,
    slot: Array,
    joints_per_arm: int,
    settings: DriftSettings,
    *,
    replay_slot: Array | None = None,
    same_mass: np.ndarray | None = None,
) -> FilterState:
    """The state after a replay, from the state predicted to its time.

    slot : (N,) in which the level of the replay's context is kept; SLOTS of an observation from production, with that source in force, and
    then replay_slot : (N,) of the replays' context. same_mass : (N,) whether the arm was weighed and carries what it did before; None: no
    arm was weighed. Joints without a resolved torque keep their mean and covariance.
    """
    rho = state.autocorrelation(joints_per_arm, settings)
    var = state.noise_var(joints_per_arm, settings, rho)
    innovation = innovate(state, observation, slot, var, settings)
    gate = gate_outliers(state, innovation, settings)
    noise = Noise(rho, var)
    # outliers in a row may be a step, and do not tell how long the tails are before they are over
    counted = counted_sigma(np.maximum(state.outliers - gate.run_before, 0.0), state.replays, joints_per_arm)
    bank = advance_bank(state, innovation, gate, counted, settings)
    gate = gate._replace(in_a_row=gate.in_a_row & (stays(bank, innovation, gate, noise, counted) | (state.replays < NOISE_KNOWN)))
    change = detect_change(state, bank, innovation, gate, noise, slot, joints_per_arm, settings, same_mass)
    event = classify(innovation, gate, of_baseline=change.of_baseline, of_wear=change.of_wear)
    learnt = event <= STEP

    new_mean, new_cov = update(change.mean, change.cov, innovation.log_torque, innovation.within_var + change.differing_var, innovation.row)
    # responses to a change follow the gain of the filter that knew of no change
    K = np.where(learnt[:, None], innovation.state_cov / innovation.var[:, None], 0.0)
    found = change.of_baseline | change.of_wear
    after = bank.after_update(K, restarted=found)
    history = move_level(state.history, change.shared)
    history[change.of_baseline] = 0.0
    counts = innovation.resolved & ~innovation.settling & ~gate.gated & (state.replays >= NOISE_KNOWN)
    chance = learn_chance(state.chance, bank.glr_score_now, bank.information_now, bank.ages, counts, may_run_in(state), joints_per_arm)
    slow = running_in(state, change.shared, change.since)
    z = innovation.normalised
    consistency = state.consistency + (z**2 - state.consistency) / CONSISTENCY_REPLAYS
    updated = replace(
        update_noise(state, innovation, event, rho, var, joints_per_arm, settings),
        mean=np.where(learnt[:, None], new_mean, change.mean),
        cov=np.where(learnt[:, None, None], new_cov, change.cov),
        replays=state.replays + learnt,
        consistency=np.where(event == ORDINARY, consistency, state.consistency),
        innovation=np.where(innovation.resolved, innovation.value, np.nan),
        normalised=np.where(innovation.resolved, z, np.nan),
        event=event,
        gate_run=np.where(found, 0.0, gate.run),
        # those that proved a step never do
        outliers=np.maximum(state.outliers + (event == OUTLIER) - np.where(change.of_wear & gate.in_a_row, gate.run_before, 0.0), 0.0),
        ages=after.ages,
        responses=after.responses,
        glr_scores=after.glr_score_now,
        raw_glr_scores=after.raw_glr_score_now,
        glr_informations=after.information_now,
        agreeing=change.agreeing,
        stepped=state.stepped + change.stepped,
        history=add_replay(history, *in_course(new_mean, new_cov, innovation, learnt & innovation.sensed, replay_slot)),
        counted_from=with_common_change(state.counted_from, change.shared, change.shared_var, slow),
        chance=forget_chance(chance, change.common).since_change(learnt, change.of_wear, change.since),
    )
    return updated if updated.sources is None else replace(updated, sources=remember_rise(updated, updated.sources, state.wear, change))


def remember_rise(state: FilterState, sources: TwoSources, before: Array, change: Change) -> TwoSources:
    """The sources with the joints of which a rise was found, and wear holds it. state : after the observation; before : (N,) wear.

    How large wear is now is less sure than that it rose: a rate that began long ago and a late step explain the same observations, and rare
    replays tell them apart late. So it is remembered that a rise was found which began long ago, for wear to confirm.
    """
    own = change.of_wear & ~change.common
    rise = change.mean[:, WEAR] > before
    risen = np.where(own & rise & (change.since >= LONG), 1.0, np.where(own & ~rise, 0.0, sources.risen))
    return replace(sources, risen=np.where(state.wear > HELD_SIGMAS * state.wear_std, risen, 0.0))


def in_course(
    mean: Array, cov: Array, innovation: Innovation, learnt: np.ndarray, replay_slot: Array | None
) -> tuple[Array, Array, np.ndarray]:
    """Row, log torque and which joints (N,), as the course of friction keeps an observation: one from production as if a replay had seen
    it.
    """
    row, y = innovation.row[:, SLOPE:STATES], innovation.log_torque
    if replay_slot is None:
        return row, y, learnt
    n, at = np.arange(len(y)), LEVELS + replay_slot
    row = row.copy()
    row[n, at - SLOPE] = 1.0
    known = np.maximum(cov[:, PRODUCTION_LEVEL, PRODUCTION_LEVEL], cov[n, at, at]) < LEVELS_KNOWN_VAR
    return row, y - mean[:, PRODUCTION_LEVEL] + mean[n, at], learnt & known


def classify(innovation: Innovation, gate: Gate, *, of_baseline: np.ndarray, of_wear: np.ndarray) -> Array:
    """(N,) ORDINARY, SETTLING, STEP, OUTLIER or UNRESOLVED: what the replay is to each joint.

    of_baseline, of_wear : (N,) joints with a sudden change that belongs to the baseline, or to wear.
    """
    settling = innovation.settling
    event = np.where(of_wear, STEP, np.where(gate.gated, OUTLIER, np.where(settling, SETTLING, ORDINARY))).astype(float)
    event[(gate.gated & settling & ~(of_baseline | of_wear)) | of_baseline] = SETTLING
    event[~innovation.resolved] = UNRESOLVED
    return event


def update_noise(
    state: FilterState, innovation: Innovation, event: Array, rho: Array, var: Array, joints_per_arm: int, settings: DriftSettings
) -> FilterState:
    """The state with the noise between replays as two successive replays show it. rho, var : (N,) its correlation and variance so far.

    Residuals r are taken against the predicted level, which was estimated from similar residuals and is uncertain itself. With its
    variance L and its covariance C with the noise, as the filter has them (`shared`), and with white innovations:

        E[r²] = σ² + R + L + 2C,   E[rₖ·rₖ₋₁] = ρ·(σ² + C).

    L and C are as large as the noise that is believed, so what they explain is a share of what is seen: taken off as amounts, they
    would hide noise far below its prior, and would make it look correlated. Without these terms the uncertainty of level and wear rate
    would count as noise: in a joint that wears, as much as a sixth of σ².
    Outliers and replays without a temperature are left out, because one of them would weigh as much as a hundred others. Outliers count
    where they are so frequent that the noise must be larger than assumed.
    """
    shared, within = innovation.shared, innovation.within_var
    now = innovation.value + state.mean[:, NOISE]  # residuals are compared against a prediction without noise
    often = state.outliers >= np.maximum(OFTEN * (state.replays + state.outliers), FEWEST)
    informative = ((event == ORDINARY) | ((event == OUTLIER) & often)) & innovation.sensed
    usable = informative & np.isfinite(state.residual)
    before = np.where(usable, state.residual, 0.0)
    n = np.where(usable, np.minimum(state.noise_weight + 1.0, settings.memory_replays), state.noise_weight)
    limit = CLIPPED * np.sqrt(var + within)
    clipped, clipped_before = np.clip(now, -limit, limit), np.clip(before, -limit, limit)
    quiet = var * (1.0 - rho)
    half = (0.5 * (clipped - clipped_before) ** 2 - within) * quiet / (quiet + np.maximum(innovation.level_var + (2.0 - rho) * shared, 0.0))
    step_var = np.where(usable, state.step_var + (half - state.step_var) / n, state.step_var)
    alike = clipped * clipped_before * var / np.maximum(var + np.minimum(shared, 0.0), var / 3.0)
    product = np.where(usable, state.product + (alike - state.product) / n, state.product)
    activity = follow(state.activity, np.where(usable, half / step_var, np.nan), joints_per_arm)
    # the replays before and after a silent one are still compared with each other
    silent = (event == UNRESOLVED) | ((event == ORDINARY) & ~innovation.sensed)
    residual = np.where(silent, state.residual, np.where(informative, now, np.nan))
    floor = settings.between_floor**2
    # as it was seen: what the level's uncertainty takes off changes while the level is learnt, which would look like noise that calms down
    seen = 0.5 * (clipped - clipped_before) ** 2
    volatility = state.volatility.after(np.where(usable, seen * STEADY / state.activity, np.nan), np.maximum(2.0 * within, floor))
    return replace(
        state,
        step_var=np.maximum(step_var, floor),
        product=product,
        noise_weight=n,
        activity=activity,
        volatility=volatility,
        residual=residual,
    )
