"""One replay through the filter: gate, look for sudden changes, update, learn the noise.

A sudden change is looked for among the last replays by its likelihood ratio (Willsky and Jones, 1976): had wear jumped by ν, or
its pace changed by ν, at replay k, the filter's later innovations would carry G·ν. Where one such change explains them far better
than chance does, it is believed with its size and doubt, back to when it began. That raises no alert: the posterior that
follows does, or does not.
"""

from dataclasses import replace

import numpy as np

from monitor.judge.evidence import DriftSettings, Observation
from monitor.judge.kalman import updated
from monitor.judge.track import (
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
    UNSEEN,
    WEAR,
    WINDOW,
    Track,
    in_new_slot,
)
from monitor.recording import Array

CLIPPED = 3.0  # [σ] a single replay says no more than this of a sudden change, however far it lies
GATED = 1.0  # [σ] and a wild one hardly anything; several in a row on one side are a step whatever they say of it
DENSE = 8  # of the youngest candidates none is forgotten
SLOW_REPLAYS = 45  # replays; a pace that began before that changes slowly
SELECTED = 1.2  # the likeliest of many candidates is less sure than if it had been the only one: in variance
PACE_STD_PER_DAY = 0.01  # of a new pace of wear, before it is seen
STEP_STD = 0.2  # of a step, likewise


def followed(track: Track, seen: Observation, slot: Array, arm: int, settings: DriftSettings) -> Track:
    """The track, aged to the replay, after it. `slot` (N,) is the context's, `arm` the joints of one arm."""
    shown = np.isfinite(seen.log_torque)
    sensed = np.isfinite(seen.temperature_c)
    t = np.where(sensed, seen.temperature_c - track.origin_c, 0.0)
    warming = np.where(np.isfinite(seen.warming_k_per_min), seen.warming_k_per_min, 0.0)
    blind = (track.mean[:, SLOPE] ** 2 + track.cov[:, SLOPE, SLOPE]) * settings.unknown_temperature_std_k**2
    # a joint that warms fast is not of one temperature: what the filter takes for its lag is a third wrong at best
    uneven = (settings.uneven_share * track.mean[:, LAG] * warming) ** 2
    within = np.where(shown, seen.variance + settings.between_floor**2 + uneven + np.where(sensed, 0.0, blind), 1.0)
    y = np.where(shown, seen.log_torque, 0.0)

    H = track.row(t, warming, slot)
    mean, cov = track.mean, track.cov
    nu = y - np.einsum("na,na->n", H, mean)
    PH = np.einsum("nab,nb->na", cov, H)
    S = np.einsum("na,na->n", H, PH) + within
    quiet = track.noise_var(arm, settings) + within
    z = nu / np.sqrt(S)
    level_var = S - within - 2.0 * PH[:, NOISE] + cov[:, NOISE, NOISE]
    # only where a replay was foreseen well does its surprise tell of noise and shifts
    settling = level_var > 2.0 * quiet
    gated = np.abs(z) > settings.gate_sigma
    side = np.where(z >= 0, 1.0, -1.0)
    run = np.where(gated & shown, np.where(track.gate_run * side > 0, track.gate_run + side, side), np.where(shown, 0.0, track.gate_run))

    ages, responses, scores, raw_scores, informations = _candidates(track, shown)
    G = np.einsum("na,nkwa->nkw", H, responses)
    limit = np.where(gated, GATED, CLIPPED) * np.sqrt(S)
    nu_clipped = np.clip(nu, -limit, limit)
    counts = shown & ~settling
    telling = np.where(counts[:, None, None], G / S[:, None, None], 0.0)
    scores_now, informations_now = scores + telling * nu_clipped[:, None, None], informations + telling * G
    raw_scores_now = raw_scores + telling * nu[:, None, None]
    ratios = _ratios(scores_now, informations_now, ages, settings)
    # a wild replay alone never proves a change; several in a row on one side do, from the first of them on
    in_a_row = gated & (np.abs(run) >= settings.gate_run)
    ratios[in_a_row, 0, min(settings.gate_run, DENSE) - 1] = np.inf
    found = (np.max(ratios, axis=(1, 2)) > 1.0) & counts & (in_a_row | ~gated)
    young = found & (track.replays < settings.baseline_replays)
    if young.any():  # nothing is known that could have worn: the level begins again
        fresh = in_new_slot(replace(track, mean=mean, cov=cov), slot, young)
        mean, cov = fresh.mean, fresh.cov
    grown = found & ~young
    jumped, agreeing = np.zeros(len(y)), np.ones(len(y))
    if grown.any():
        mean, cov, jumped, age = _believed(mean, cov, responses, scores, raw_scores, informations, ratios, G, nu, S, grown)
        agreeing[grown] += ages[grown, age]

    event = np.where(grown, STEP, np.where(gated, OUTLIER, np.where(settling, SETTLING, ORDINARY))).astype(float)
    event[(gated & settling & ~found) | young] = SETTLING
    event[~shown] = UNSEEN
    learnt = event <= STEP

    new_mean, new_cov = updated(mean, cov, y, within, H)
    mean, cov = np.where(learnt[:, None], new_mean, mean), np.where(learnt[:, None, None], new_cov, cov)
    K = np.where(learnt[:, None], PH / S[:, None], 0.0)  # of the filter that knew of no change
    responses = responses - G[..., None] * K[:, None, None, :]
    forget = found[:, None, None]
    return replace(
        _with_noise(track, nu, level_var, within, event, settings),
        mean=mean,
        cov=cov,
        replays=track.replays + learnt,
        consistency=np.where(event == ORDINARY, track.consistency + (z**2 - track.consistency) / 20.0, track.consistency),
        innovation=np.where(shown, nu, np.nan),
        normalised=np.where(shown, z, np.nan),
        event=event,
        gate_run=np.where(found, 0.0, run),
        outliers=track.outliers + (event == OUTLIER),
        ages=ages,
        responses=np.where(forget[..., None], 0.0, responses),
        scores=np.where(forget, 0.0, scores_now),
        raw_scores=np.where(forget, 0.0, raw_scores_now),
        informations=np.where(forget, 0.0, informations_now),
        agreeing=agreeing,
        stepped=track.stepped + jumped,
    )


def _candidates(track: Track, shown: np.ndarray) -> tuple[Array, Array, Array, Array, Array]:
    """One more replay at which a change may have begun, one of the others forgotten; only for joints that are shown.

    The ages stay about geometric: the one goes that leaves the smallest gap for its age. A change found among them is late by little.
    """
    n = np.flatnonzero(shown)
    ages = track.ages + shown[:, None]
    gaps = (ages[:, 2:] - ages[:, :-2]) / ages[:, 1:-1]  # of those between the first and the last
    gaps[:, :DENSE] = np.inf
    last = np.where(ages[:, -1:] > OLDEST, 0.0, np.inf)
    gone = DENSE + 1 + np.argmin(np.concatenate([gaps, last], axis=1)[:, DENSE:], axis=1)  # (N,)
    # everything younger than the one that goes moves up by a place
    places = np.arange(WINDOW)
    source = np.where(places[None, :] <= gone[:, None], places - 1, places)[n]  # −1 is the new one
    rows = n[:, None]
    ages[n] = np.where(source < 0, 0.0, ages[rows, source])

    def moved(old: Array) -> Array:
        new = old.copy()
        new[n] = np.moveaxis(old[rows, :, source], 1, 2)
        new[n, :, 0] = 0.0
        return new

    responses = moved(track.responses)
    responses[n, 0, 0, WEAR] = 1.0
    responses[n, 1, 0, RATE] = 1.0
    responses[n, 1, 0, WEAR] = track.cadence_days[n]  # a pace that began after the last replay has done a replay's work
    return ages, responses, moved(track.scores), moved(track.raw_scores), moved(track.informations)


def _ratios(scores: Array, informations: Array, ages: Array, settings: DriftSettings) -> Array:
    """(N, 2, W) likelihood ratio of each change that enough replays have seen, over the one from which it is believed."""
    ratio = scores**2 / np.maximum(informations, 1e-12)
    # a slow change may have begun at fewer places that differ than a sudden one: it asks for less
    slow = np.where(ages >= SLOW_REPLAYS, settings.pace_sigma, settings.shift_sigma)
    ratio[:, 0] /= settings.shift_sigma**2
    ratio[:, 1] /= slow**2
    told: Array = np.where(ages[:, None, :] >= settings.gate_run - 1, ratio, 0.0)
    return told


def _believed(
    mean: Array,
    cov: Array,
    responses: Array,
    scores: Array,
    raw_scores: Array,
    informations: Array,
    ratios: Array,
    G: Array,
    nu: Array,
    S: Array,
    found: np.ndarray,
) -> tuple[Array, Array, Array, Array]:
    """Mean and covariance as if the likeliest change had been foreseen, with its doubt; how much of it is a step (N,), and its place.

    The last replay is left to the update that follows. Where it disagrees with the size found so far, the doubt is widened until it
    does not.
    """
    best = np.argmax(ratios[found].reshape(-1, KINDS * WINDOW), axis=1)
    kind, age = np.divmod(best, WINDOW)
    n = np.flatnonzero(found)
    prior = np.where(kind == 0, STEP_STD, PACE_STD_PER_DAY) ** -2
    precision = informations[n, kind, age] + prior
    # where replays were clipped the size lies between what they say in full and what they say clipped
    clipped, full = scores[n, kind, age] / precision, raw_scores[n, kind, age] / precision
    clipped = np.where(np.isinf(ratios[n, kind, age]), full, clipped)  # but wild replays in a row mean what they say
    size = 0.5 * (clipped + full)
    g = responses[n, kind, age]  # (n, S)
    rest = nu[n] - G[n, kind, age] * size
    wider = np.maximum(rest**2 - CLIPPED**2 * S[n], 0.0) / np.maximum(G[n, kind, age] ** 2, 1e-12)
    var = np.minimum(SELECTED / precision + wider + 0.25 * (full - clipped) ** 2, 1.0 / prior)
    mean, cov = mean.copy(), cov.copy()
    mean[n] += g * size[:, None]
    cov[n] += var[:, None, None] * g[:, :, None] * g[:, None, :]
    jumped = np.zeros(len(mean))
    jumped[n] = np.where(kind == 0, size, 0.0)
    return mean, cov, jumped, age


def _with_noise(track: Track, nu: Array, level_var: Array, within: Array, event: Array, settings: DriftSettings) -> Track:
    """The noise between replays, learnt from two successive ones.

    Residuals are taken against a level that was fitted to their like: their product is short by the level's variance.
    """
    now = nu + track.mean[:, NOISE]  # what was foreseen without noise is what is compared
    usable = (event == ORDINARY) & np.isfinite(track.residual)
    before = np.where(usable, track.residual, 0.0)
    n = np.where(usable, np.minimum(track.noise_weight + 1.0, settings.memory_replays), track.noise_weight)
    limit = 3.0 * np.sqrt(np.maximum(track.step_var + track.product, 0.0) + within)  # one wild replay says no more than this
    clipped, clipped_before = np.clip(now, -limit, limit), np.clip(before, -limit, limit)
    half = 0.5 * (clipped - clipped_before) ** 2 - within
    step_var = np.where(usable, track.step_var + (half - track.step_var) / n, track.step_var)
    product = np.where(usable, track.product + (clipped * clipped_before + 0.4 * level_var - track.product) / n, track.product)
    residual = np.where(event == UNSEEN, track.residual, np.where((event == ORDINARY) | (event == OUTLIER), now, np.nan))
    return replace(
        track, step_var=np.maximum(step_var, settings.between_floor**2), product=product, noise_weight=n, residual=residual
    )  # fmt: skip
