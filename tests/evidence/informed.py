"""Days to detection by an observer who knows a world's noise exactly, at an equal share of false advisories: what not knowing it costs.

It has friction at the reference speed, temperature and warming of the judge's replays. Level, temperature law and the effect of warming of
each joint it has to learn, from a broad prior; σ and ρ of the noise, that it is Gaussian and that nothing but wear and temperature moves
friction, it need not. It looks for a rise by a step or by a new rate that began on any day, by their generalised likelihood ratio (Willsky
and Jones, 1976), with one threshold. Healthy joints cross it as often as the judge raises false advisories: it looks for no falls.

It is one observer and not the best one: who knows as well how fast joints wear finds slow wear sooner. And it is nobody's monitor: another
world's noise would break it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from monitor.recording import Array
from monitor.studies.figures import DAYS_A_YEAR
from monitor.studies.rehearsal.play import LEARNING_DAYS
from monitor.studies.worlds.fleet import World, WorldFleet
from monitor.studies.worlds.laws import Correlated
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import days_document, fleets_of

TEN_K = 10.0  # [K] unit of the temperature's distance from its first mean
FIRST_REPLAYS = 20  # of which that mean is
# what is learnt of each joint, as prior mean and standard deviation: level [log], slope and curvature [log/10 K], effect of warming
# [log/(K/min)]; then the noise itself
MEAN = (0.0, -0.10, 0.0, 0.05)
STD = (10.0, 0.05, 0.02, 0.10)
LEARNT = len(MEAN)
BEFORE = 10  # [days] least before a change
CHUNK = 300  # joints at a time: their responses to every change take 13 MB


class Seen(NamedTuple):
    """All observations of N joints on D days, (D, N) each."""

    log_torque: Array  # NaN where there was no replay
    variance: Array
    temperature_c: Array
    warming_k_per_min: Array


def known_noise(world: World) -> tuple[float, float] | None:
    """σ and ρ of the noise, where they are all that an observer must know of a world; None elsewhere."""
    noise, lasting = world.noise, any(wear.life_years is not None for wear in world.wear)
    if not isinstance(noise, Correlated) or noise.degrees is not None or noise.common or world.changes or world.replays_a_day > 1:
        return None
    if lasting or any((wear.dry, wear.viscous) != (1.0, 1.0) for wear in world.wear):
        return None  # wear that is no step and no rate, or shows elsewhere than at the reference speed
    return (noise.std, noise.rho) if isinstance(noise.std, float) and isinstance(noise.rho, float) else None


def seen_of(fleet: WorldFleet, joints: np.ndarray) -> Seen:
    """What a fleet's replays show of some joints, (N,) of their numbers in 0 … A·J."""
    days = [fleet.morning(day).seen for day in range(fleet.days)]
    return Seen(*(np.array([getattr(seen, name)[joints] for seen in days]) for name in Seen._fields))


def evidence(seen: Seen, std: float, rho: float) -> Array:
    """(D, N) [χ² of one degree of freedom] of the clearest rise, of any beginning, after each day; 0 where nothing rises.

    A Kalman filter of what is learnt and of the noise, and what a change that began on each day would have left in it.
    """
    D, N = seen.log_torque.shape
    away = (seen.temperature_c - seen.temperature_c[:FIRST_REPLAYS].mean(axis=0)) / TEN_K
    ones = np.ones((D, N))
    rows = np.stack([ones, away, away**2, seen.warming_k_per_min, ones], axis=2)  # (D, N, S)
    mean = np.tile((*MEAN, 0.0), (N, 1))
    cov = np.tile(np.diag((*STD, std)) ** 2, (N, 1, 1))
    response = np.zeros((N, 2, D, LEARNT + 1), dtype=np.float32)  # of a unit step, and of a unit rate, that began on each day
    score, information, found = np.zeros((N, 2, D)), np.zeros((N, 2, D)), np.zeros((D, N))
    for day in range(D):
        if day:
            mean[:, -1] *= rho
            response[:, :, :day, -1] *= rho
            cov[:, -1, :] *= rho
            cov[:, :, -1] *= rho
            cov[:, -1, -1] += (1.0 - rho**2) * std**2
        row, here = rows[day], np.isfinite(seen.log_torque[day])
        with_row = np.einsum("nst,nt->ns", cov, row)
        var = np.einsum("ns,ns->n", with_row, row) + seen.variance[day]
        nu = np.where(here, seen.log_torque[day] - np.einsum("ns,ns->n", mean, row), 0.0)
        gain = np.where(here[:, None], with_row / var[:, None], 0.0)
        begun = day - np.arange(day + 1.0)
        unit = np.stack([np.ones(day + 1), begun / DAYS_A_YEAR])
        effect = unit - np.einsum("nkds,ns->nkd", response[:, :, : day + 1], row.astype(np.float32))
        weight = np.where(here, 1.0 / var, 0.0)[:, None, None]
        score[:, :, : day + 1] += effect * nu[:, None, None] * weight
        information[:, :, : day + 1] += effect**2 * weight
        response[:, :, : day + 1] += gain[:, None, None, :] * effect[..., None]
        mean += gain * nu[:, None]
        cov -= gain[:, :, None] * with_row[:, None, :]
        if day >= BEFORE:
            late = slice(BEFORE, day + 1)
            rise, told = np.maximum(score[:, :, late], 0.0), information[:, :, late]
            found[day] = np.max(np.where(told > 0.0, rise**2 / np.maximum(told, 1e-12), 0.0), axis=(1, 2))
    return found


def all_evidence(fleet: WorldFleet, joints: np.ndarray, noise: tuple[float, float]) -> Array:
    """(D, N) `evidence` of a fleet's joints."""
    seen = seen_of(fleet, joints)
    parts = [slice(k, k + CHUNK) for k in range(0, len(joints), CHUNK)]
    return np.concatenate([evidence(Seen(*(each[:, part] for each in seen)), *noise) for part in parts], axis=1)


def informed_beside(document: dict[str, Any], *, arms: int, days: int, seed: int, worn: int | None = None) -> list[dict[str, Any]]:
    """`informed_documents` beside the judge's document of a world: at its false advisories, and at as many as are asked for."""
    per_year = (document["false_advisories"]["counted"]["per_year"], document["goal"]["false_advisories"])
    return informed_documents(WORLDS[document["world"]], arms=arms, days=days, seed=seed, per_year=per_year, worn=worn)


def informed_documents(
    world: World, *, arms: int, days: int, seed: int, per_year: Sequence[float], worn: int | None = None
) -> list[dict[str, Any]]:
    """Days to detection of each kind of wear of a world, at so many false advisories a robot-year: on the arms of `play_world`.

    Counted as there: the first rise of every healthy joint; the first rise of a joint that wears. Empty where `known_noise` has none.
    """
    noise = known_noise(world)
    if noise is None:
        return []
    healthy, wearing = fleets_of(world, arms=arms, days=days, seed=seed, worn=worn)
    chance = all_evidence(healthy, np.arange(arms * healthy.joints), noise)[LEARNING_DAYS:].max(axis=0)
    highest, years = np.sort(chance)[::-1], arms * (days - LEARNING_DAYS) / DAYS_A_YEAR
    events = [min(round(rate * years), len(highest) - 1) for rate in per_year]
    rises = largest_of_arms(all_evidence(wearing, np.flatnonzero(wearing.worn), noise)[LEARNING_DAYS:], wearing)
    return [
        {
            "wear": wear.name,
            "false_per_year": rate,
            "false_advisories": count,
            "threshold": float(highest[count]),
            **days_to_crossing(rises[:, mine], wearing.onset_day[mine], float(highest[count])),
        }
        for k, wear in enumerate(world.wear)
        for mine in [wearing.group == k]
        for rate, count in zip(per_year, events, strict=True)
    ]


def largest_of_arms(each: Array, wearing: WorldFleet) -> Array:
    """(D, A) the largest of every arm's joints that wear; each : (D, n) of these joints alone, ascending. Every arm has one."""
    of_arm = np.searchsorted(np.flatnonzero(wearing.worn) // wearing.joints, np.arange(wearing.arms))
    largest: Array = np.maximum.reduceat(each, of_arm, axis=1)
    return largest


def days_to_crossing(rises: Array, onset_day: Array, threshold: float) -> dict[str, Any]:
    """`days_document` of the days from the onset to the first crossing, that day included; arms that crossed before are left out.

    rises : (D, A) from the end of learning on. onset_day : (A,).
    """
    over = rises > threshold
    first = np.where(over.any(axis=0), over.argmax(axis=0) + float(LEARNING_DAYS), np.inf)
    days = (first - onset_day + 1.0)[first >= onset_day]
    return days_document(days)
