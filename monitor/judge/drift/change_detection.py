"""One replay through the filter: gate, look for sudden changes, update, learn the noise.

A sudden change is looked for among the last replays by its likelihood ratio (Willsky and Jones, 1976): had wear jumped by ν, or
its pace changed by ν, at replay k, the filter's later innovations would carry G·ν. Where one such change explains them far better
than chance does, it is believed with its size and doubt, back to when it began. That raises no alert: the posterior that
follows does, or does not.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from monitor.judge.drift.filter_state import (
    KINDS,
    LAG,
    NOISE,
    OLDEST,
    ORDINARY,
    OUTLIER,
    RATE,
    SETTLING,
    SLOPE,
    STEP,
    UNRESOLVED,
    WEAR,
    WINDOW,
    FilterState,
    open_slot,
)
from monitor.judge.drift.kalman import symmetric, update
from monitor.judge.drift.observation import DriftSettings, Observation
from monitor.recording import Array

CLIPPED = 3.0  # [σ] a single replay says no more than this of a change, however far it lies: noise has longer tails than Gauss's
GATED = 1.0  # [σ] and a wild one hardly anything; several in a row on one side are a step whatever they say of it
OFTEN, FEWEST = 0.1, 3  # share and number of wild replays from which they are not wild: that is how this joint's noise is
DENSE = 28  # of the youngest candidates none is forgotten: a step's first replay says most of it, so a day beside it is 5 % of its σ less
PACE_REPLAYS = 20
LEAST = 2.0  # [σ] whatever the age, nothing is believed of less
PACE_STD_PER_DAY = 0.01  # of a new pace of wear, before it is seen
STEP_STD = 0.2  # of a step, likewise
PACES_A_STEP = 3.0  # joints wear more often than they jump


def update_filter(state: FilterState, seen: Observation, slot: Array, arm: int, settings: DriftSettings) -> FilterState:
    """The track, aged to the replay, after it. `slot` (N,) is the context's, `arm` the joints of one arm."""
    shown = np.isfinite(seen.log_torque)
    sensed = np.isfinite(seen.temperature_c)
    t = np.where(sensed, seen.temperature_c - state.origin_c, 0.0)
    warming = np.where(np.isfinite(seen.warming_k_per_min), seen.warming_k_per_min, 0.0)
    blind = (state.mean[:, SLOPE] ** 2 + state.cov[:, SLOPE, SLOPE]) * settings.unknown_temperature_std_k**2
    # a joint that warms fast is not of one temperature: what the filter takes for its lag is a third wrong at best
    uneven = (settings.uneven_share * state.mean[:, LAG] * warming) ** 2
    within = np.where(shown, seen.variance + settings.between_floor**2 + uneven + np.where(sensed, 0.0, blind), 1.0)
    y = np.where(shown, seen.log_torque, 0.0)

    H = state.row(t, warming, slot)
    mean, cov = state.mean, state.cov
    nu = y - np.einsum("na,na->n", H, mean)
    PH = np.einsum("nab,nb->na", cov, H)
    S = np.einsum("na,na->n", H, PH) + within
    quiet = state.noise_var(arm, settings) + within
    z = nu / np.sqrt(S)
    shared = PH[:, NOISE] - cov[:, NOISE, NOISE]
    level_var = S - within - 2.0 * shared - cov[:, NOISE, NOISE]
    # only where a replay was foreseen well does its surprise tell of noise and shifts
    settling = level_var > 2.0 * quiet
    gated = np.abs(z) > settings.gate_sigma
    side = np.where(z >= 0, 1.0, -1.0)
    run = np.where(gated & shown, np.where(state.gate_run * side > 0, state.gate_run + side, side), np.where(shown, 0.0, state.gate_run))

    ages, responses, scores, raw_scores, informations = _candidates(state, shown)
    G = np.einsum("na,nkwa->nkw", H, responses)
    limit = np.where(gated, GATED, CLIPPED) * np.sqrt(S)
    nu_held = np.clip(nu, -limit, limit)
    counts = shown & ~settling
    telling = np.where(counts[:, None, None], G / S[:, None, None], 0.0)
    scores_now, informations_now = scores + telling * nu_held[:, None, None], informations + telling * G
    raw_scores_now = raw_scores + telling * nu[:, None, None]
    # a wild replay alone never proves a change; several in a row on one side do, from the first of them on
    in_a_row = gated & (np.abs(run) >= settings.gate_run)
    # what began when hardly anything was known is of the baseline; and a change is no single replay
    since = state.replays + np.where(in_a_row, np.abs(run) - 1.0, 0.0)  # those wild ones before this were not learnt from
    enough = (ages >= settings.gate_run - 1) & (ages <= (since - settings.baseline_replays)[:, None])
    said = np.where(in_a_row[:, None, None], raw_scores_now, scores_now)
    ratios, over = _ratios(said, informations_now, ages, enough, settings)
    found = ((np.max(over, axis=(1, 2)) > 1.0) | in_a_row) & counts & (in_a_row | ~gated)
    young = found & ~np.any(ratios > 0, axis=(1, 2))
    if young.any():  # nothing is known that could have worn: the level begins again
        fresh = open_slot(replace(state, mean=mean, cov=cov), slot, young)
        mean, cov = fresh.mean, fresh.cov
    grown = found & ~young
    jumped, agreeing = np.zeros(len(y)), np.ones(len(y))
    if grown.any():
        bank = _Bank(responses, ages, scores, raw_scores, informations)
        mean, cov, jumped, age = _change_posterior(mean, cov, bank, ratios, G, nu, S, grown, in_a_row)
        agreeing += age

    event = np.where(grown, STEP, np.where(gated, OUTLIER, np.where(settling, SETTLING, ORDINARY))).astype(float)
    event[(gated & settling & ~found) | young] = SETTLING
    event[~shown] = UNRESOLVED
    learnt = event <= STEP

    new_mean, new_cov = update(mean, cov, y, within, H)
    mean, cov = np.where(learnt[:, None], new_mean, mean), np.where(learnt[:, None, None], new_cov, cov)
    K = np.where(learnt[:, None], PH / S[:, None], 0.0)  # of the filter that knew of no change
    responses -= G[..., None] * K[:, None, None, :]
    for told in (responses, scores_now, raw_scores_now, informations_now):
        told[found] = 0.0
    return replace(
        _update_noise(state, nu, level_var, shared, within, event, sensed, arm, settings),
        mean=mean,
        cov=cov,
        replays=state.replays + learnt,
        consistency=np.where(event == ORDINARY, state.consistency + (z**2 - state.consistency) / 20.0, state.consistency),
        innovation=np.where(shown, nu, np.nan),
        normalised=np.where(shown, z, np.nan),
        event=event,
        gate_run=np.where(found, 0.0, run),
        outliers=state.outliers + (event == OUTLIER),
        ages=ages,
        responses=responses,
        glr_scores=scores_now,
        raw_glr_scores=raw_scores_now,
        glr_informations=informations_now,
        agreeing=agreeing,
        stepped=state.stepped + jumped,
    )


def _candidates(state: FilterState, shown: np.ndarray) -> tuple[Array, Array, Array, Array, Array]:
    """One more replay at which a change may have begun, one of the others forgotten; only for joints that are shown.

    The ages stay about geometric: the one goes that leaves the smallest gap for its age. A change found among them is late by little.
    """
    n = np.flatnonzero(shown)
    ages = state.ages + shown[:, None]
    gaps = (ages[:, 2:] - ages[:, :-2]) / ages[:, 1:-1]  # of those between the first and the last
    gaps[:, :DENSE] = np.inf
    last = np.where(ages[:, -1:] > OLDEST, 0.0, np.inf)
    gone = DENSE + 1 + np.argmin(np.concatenate([gaps, last], axis=1)[:, DENSE:], axis=1)  # (N,)
    # everything younger than the one that goes moves up by a place
    places = np.arange(WINDOW)
    source = np.where((places <= gone[:, None]) & shown[:, None], np.maximum(places - 1, 0), places)  # (N, W)
    ages = np.take_along_axis(ages, source, axis=1)
    ages[n, 0] = 0.0
    rows = (np.arange(len(ages))[:, None, None] * KINDS + np.arange(KINDS)[:, None]) * WINDOW + source[:, None, :]  # (N, 2, W)

    def moved(old: Array) -> Array:
        new: Array = np.take(old.reshape(rows.size, -1), rows.ravel(), axis=0).reshape(old.shape)
        new[n, :, 0] = 0.0
        return new

    responses = moved(state.responses)
    responses[n, 0, 0, WEAR] = 1.0
    responses[n, 1, 0, RATE] = 1.0
    responses[n, 1, 0, WEAR] = state.interval_days[n]  # a pace that began after the last replay has done a replay's work
    return ages, responses, moved(state.glr_scores), moved(state.raw_glr_scores), moved(state.glr_informations)


def _ratios(scores: Array, informations: Array, ages: Array, enough: np.ndarray, settings: DriftSettings) -> tuple[Array, Array]:
    """(N, 2, W) likelihood ratio of each change that is looked for, else 0, and the same over the one from which it is believed.

    enough : (N, W) whether a start has enough replays before it and since.

    What began n replays ago is a mean of n: chance carries it across z standard deviations n times as seldom, as e^(−z²/2)/n (Rice,
    1945). So that every age is as often wrong, what is old may be believed of less.
    """
    ratio = scores**2 / np.maximum(informations, 1e-12)
    by_age = 2.0 * np.log(np.maximum(ages, 1.0))  # (N, W)
    ratio = np.where(enough[:, None, :], ratio, 0.0)
    over = ratio.copy()
    over[:, 0] /= np.maximum(settings.shift_sigma**2 - by_age, LEAST**2)
    # a pace that began a few replays ago is hardly another thing than a step: it is looked for by the step's figure
    asked = np.where(ages >= PACE_REPLAYS, settings.pace_sigma, settings.shift_sigma) ** 2
    over[:, 1] /= np.maximum(asked - by_age, LEAST**2)
    return ratio, over


class _Bank(NamedTuple):
    """The changes that were looked for, before the last replay."""

    responses: Array  # (N, 2, W, S)
    ages: Array  # (N, W)
    glr_scores: Array  # (N, 2, W)
    raw_glr_scores: Array
    glr_informations: Array


def _change_posterior(
    mean: Array, cov: Array, bank: _Bank, ratios: Array, G: Array, nu: Array, S: Array, found: np.ndarray, in_a_row: np.ndarray
) -> tuple[Array, Array, Array, Array]:
    """Mean and covariance as if the change had been foreseen; how much of it is a step (N,), and how old the likeliest is (N,).

    Which change it was, and since when, is as doubtful as the likelihoods of all of them say: what is believed is their mean, with the
    spread between them. The last replay is left to the update that follows; where it disagrees with the size found so far, the doubt is
    widened until it does not.
    """
    n = np.flatnonzero(found)
    M = KINDS * WINDOW
    ratio = ratios[n].reshape(-1, M)  # (n, M)
    information = bank.glr_informations[n].reshape(-1, M)
    precision = information + np.repeat(np.array([STEP_STD, PACE_STD_PER_DAY]) ** -2, WINDOW)
    # one candidate stands for all starts up to the next older one
    span = np.tile(np.diff(bank.ages[n], axis=1, append=bank.ages[n][:, -1:] + 1.0), KINDS)
    evidence = 0.5 * ratio + np.log(np.maximum(span, 1.0) / np.sqrt(precision)) - np.log(np.repeat([STEP_STD, PACE_STD_PER_DAY], WINDOW))
    evidence += np.repeat([0.0, math.log(PACES_A_STEP)], WINDOW)
    evidence = np.where(ratio > 0, evidence, -np.inf)
    weight = np.exp(evidence - evidence.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    # where replays were held down the size lies between what they say in full and what they say held down
    held, full = bank.glr_scores[n].reshape(-1, M) / precision, bank.raw_glr_scores[n].reshape(-1, M) / precision
    held = np.where(in_a_row[n, None], full, held)  # but wild replays in a row mean what they say
    size = 0.5 * (held + full)
    g = bank.responses[n].reshape(len(n), M, -1)  # (n, M, S)
    moved = g * size[:, :, None]
    shift = np.einsum("nm,nms->ns", weight, moved)
    best = np.argmax(weight, axis=1)
    row = np.arange(len(n))
    gain = G[n].reshape(-1, M)[row, best]
    rest = nu[n] - np.einsum("nm,nm->n", weight, G[n].reshape(-1, M) * size)
    wider = np.maximum(rest**2 - CLIPPED**2 * S[n], 0.0) / np.maximum(gain**2, 1e-12)
    var = 1.0 / precision + 0.25 * (full - held) ** 2
    var[row, best] += np.minimum(wider, np.where(best < WINDOW, STEP_STD, PACE_STD_PER_DAY) ** 2) / np.maximum(weight[row, best], 0.1)
    away = moved - shift[:, None, :]
    more = np.einsum("nm,nms,nmt->nst", weight * var, g, g) + np.einsum("nm,nms,nmt->nst", weight, away, away)
    mean, cov = mean.copy(), cov.copy()
    mean[n] += shift
    cov[n] += symmetric(more)
    jumped, age = np.zeros(len(mean)), np.zeros(len(mean))
    jumped[n] = (weight * size)[:, :WINDOW].sum(axis=1)
    age[n] = bank.ages[n, best % WINDOW]
    return mean, cov, jumped, age


def _update_noise(
    state: FilterState,
    nu: Array,
    level_var: Array,
    shared: Array,
    within: Array,
    event: Array,
    sensed: np.ndarray,
    arm: int,
    settings: DriftSettings,
) -> FilterState:
    """The noise between replays, learnt from two successive ones.

    Residuals are taken against a level L (wear and temperature in it) that was fitted to their like, and is in doubt itself. With its
    variance L and its covariance C with the noise, as the filter has them (`shared`), innovations being white:

        E[r²] = σ² + R + L + 2C,   E[rₖ·rₖ₋₁] = ρ·(σ² + C),

    so that what the doubt of level and pace adds is not taken for noise. In a joint that wears it is as much as a sixth of σ².
    Wild replays and those without a temperature are no part of it: one of them tells as much as a hundred others, and nothing of noise;
    unless they are many: then noise is larger than was supposed.
    """
    rho = state.autocorrelation(arm, settings)
    now = nu + state.mean[:, NOISE]  # what was foreseen without noise is what is compared
    often = state.outliers >= np.maximum(OFTEN * (state.replays + state.outliers), FEWEST)
    telling = ((event == ORDINARY) | ((event == OUTLIER) & often)) & sensed
    usable = telling & np.isfinite(state.residual)
    before = np.where(usable, state.residual, 0.0)
    n = np.where(usable, np.minimum(state.noise_weight + 1.0, settings.memory_replays), state.noise_weight)
    limit = 3.0 * np.sqrt(np.maximum(state.step_var + state.product, 0.0) + within)  # one replay says no more than this
    clipped, clipped_before = np.clip(now, -limit, limit), np.clip(before, -limit, limit)
    half = 0.5 * (clipped - clipped_before) ** 2 - within - np.maximum(level_var + (2.0 - rho) * shared, 0.0)
    step_var = np.where(usable, state.step_var + (half - state.step_var) / n, state.step_var)
    alike = clipped * clipped_before - rho * np.minimum(shared, 0.0)
    product = np.where(usable, state.product + (alike - state.product) / n, state.product)
    silent = (event == UNRESOLVED) | ((event == ORDINARY) & ~sensed)  # the one before it and the one after it still compare
    residual = np.where(silent, state.residual, np.where(telling, now, np.nan))
    return replace(
        state, step_var=np.maximum(step_var, settings.between_floor**2), product=product, noise_weight=n, residual=residual
    )  # fmt: skip
