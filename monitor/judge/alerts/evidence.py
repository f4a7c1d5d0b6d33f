"""Which tiers a joint's friction has reached, as arrays over the joints of one arm or of a fleet: what `verdict` speaks about.

A tier asks for statistical evidence, for practical relevance (the rise itself), for replays on several days inside the learnt
temperatures, and that not all joints rise together.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from monitor.judge.alerts.settings import HealthSettings
from monitor.recording import Array

CONDITIONS = 4  # rising to each of the three tiers, and falling
FALLING = 3
CROSSINGS_PER_YEAR = 0.25  # of its mean, upwards, by a healthy joint's estimated wear: measured on the fleet, see `rehearse`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Counts:
    """Replays in a row that agree, the UTC days they lie on, and the last of these; for every joint (N, 4) and arm (A,)."""

    replays: Array
    days: Array
    last_day: Array
    arm_replays: Array
    arm_days: Array
    arm_last_day: Array


class Evidence(NamedTuple):
    """What the evidence amounts to after a replay."""

    counts: Counts
    excess: Array  # (N,) wear beyond what all joints share, log
    common: Array  # (A,) how much they rose together, log; 0 where they did not
    fallen: Array  # (A,) how much they fell together, log, negative; 0 where they did not
    above: Array  # (N, 3) P(wear > rise of the tier)
    below: Array  # (N,) P(wear < −rise of the wear tier), beyond what all fell
    sigmas: Array  # (N,) of the excess
    raises: Array  # (N,) highest tier that may be raised; −1 for none
    falls: np.ndarray  # (N,) falling friction may be raised
    together: np.ndarray  # (A,) rise or fall of all joints may be raised


def nothing_counted(joints: int, arms: int) -> Counts:
    """Before the first replay."""
    return Counts(
        replays=np.zeros((joints, CONDITIONS)),
        days=np.zeros((joints, CONDITIONS)),
        last_day=np.full((joints, CONDITIONS), -1.0),
        arm_replays=np.zeros(arms),
        arm_days=np.zeros(arms),
        arm_last_day=np.full(arms, -1.0),
    )


def advisory_sigmas(joints: int, settings: HealthSettings) -> float:
    """How many of its standard deviations wear must be from 0, so that chance tells no more advisories a robot-year than allowed.

    A smooth Gaussian process that crosses its mean upwards f₀ times a year crosses z of its standard deviations f₀·exp(−z²/2) times
    (Rice, 1945).
    """
    return math.sqrt(2.0 * math.log(max(joints * CROSSINGS_PER_YEAR / settings.false_alarms_per_year, 2.0)))


def weigh_evidence(
    wear: Array,
    wear_std: Array,
    seen: np.ndarray,
    usable: np.ndarray,
    day: Array,
    agreeing: Array,
    cadence_days: Array,
    before: Counts,
    arm: int,
    settings: HealthSettings,
) -> Evidence:
    """What is to be said after a replay on `day` (N,), by wear and its std (N,), `arm` joints an arm.

    agreeing : (N,) replays, this one included, that are known to agree with it, `cadence_days` apart.
    seen : (N,) joints ever learnt from; usable : (N,) whether this replay counts, for or against.
    """
    doubt = np.maximum(wear_std, 1e-9)
    common = _common(wear, doubt, seen, arm, settings, math.log1p(settings.advisory_rise))
    fallen = -_common(-wear, doubt, seen, arm, settings, -math.log1p(-settings.wear_rise))  # a fall is told from where a joint's is
    together_now = (common > 0) | (fallen < 0)
    excess = wear - np.repeat(common, arm)
    rises = np.log1p(settings.rises)
    above = ndtr((excess[:, None] - rises) / doubt[:, None])  # (N, 3)
    below = ndtr((math.log1p(-settings.wear_rise) + np.repeat(fallen, arm) - wear) / doubt)  # (N,)
    sigmas = excess / doubt
    agree = np.empty((len(wear), CONDITIONS), dtype=bool)
    sure = sigmas >= advisory_sigmas(arm, settings)
    agree[:, 0] = sure & (excess >= rises[0])
    agree[:, 1] = sure & (above[:, 1] >= settings.wear_sure)
    agree[:, 2] = sure & (above[:, 2] >= settings.limit_sure)
    agree[:, FALLING] = below >= settings.wear_sure

    on_days = np.maximum(1.0, np.round(agreeing * np.minimum(cadence_days, 1.0)))
    replays, days, last_day = _counted(
        before.replays, before.days, before.last_day, agree, usable[:, None], day[:, None], agreeing[:, None], on_days[:, None]
    )
    enough = (replays >= settings.min_replays) & (days >= settings.min_days)
    arm_usable = 2 * usable.reshape(-1, arm).sum(axis=1) >= arm  # as for a joint: an unusable replay says nothing
    once = np.ones(len(together_now))
    arm_counts = _counted(before.arm_replays, before.arm_days, before.arm_last_day, together_now, arm_usable, day[::arm], once, once)
    counts = Counts(
        replays=replays, days=days, last_day=last_day, arm_replays=arm_counts[0], arm_days=arm_counts[1], arm_last_day=arm_counts[2]
    )
    raises = np.max(np.where(enough[:, :FALLING], np.arange(FALLING), -1), axis=1)
    together = (arm_counts[0] >= settings.min_replays) & (arm_counts[1] >= settings.min_days)
    return Evidence(counts, excess, common, fallen, above, below, sigmas, raises, enough[:, FALLING], together)


def _counted(
    replays: Array, days: Array, last: Array, agree: np.ndarray, usable: np.ndarray, day: Array, weight: Array, on_days: Array
) -> tuple[Array, Array, Array]:
    """Confirmations with one more replay: it grows where the replay agrees, and begins again where it does not."""
    more, gone = agree & usable, ~agree & usable
    new_days = np.where(gone, 0.0, days + (more & (last != day)) * on_days)
    return np.where(gone, 0.0, replays + more * weight), new_days, np.where(gone, -1.0, np.where(more, day, last))


def _common(wear: Array, doubt: Array, seen: np.ndarray, arm: int, settings: HealthSettings, least: float) -> Array:
    """How much all joints of an arm have risen together (A,), log; 0 where they have not, or by less than `least`.

    Two joints share nothing that one can tell.
    """
    known = seen.reshape(-1, arm)
    shown = np.where(known, wear.reshape(-1, arm), np.nan)
    count = known.sum(axis=1)
    rising = (ndtr((wear / doubt).reshape(-1, arm)) >= settings.common_sure) & known
    shift = np.zeros(len(count))
    together = (count >= 3) & (rising.sum(axis=1) >= settings.common_share * count)
    if together.any():
        shift[together] = np.nanmedian(shown[together], axis=1)
    return np.where(shift >= least, shift, 0.0)
