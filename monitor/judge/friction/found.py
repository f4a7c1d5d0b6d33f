"""How a change was found: its odds and what they had to be, when it began, whether it came at once, and how large it seemed."""

from dataclasses import dataclass

import numpy as np

from monitor.judge.friction.changes import NEW_RATE, SHAPES, Bank, ChangePriors
from monitor.recording import Array


@dataclass(slots=True, kw_only=True, eq=False)
class Found:
    """Of each channel's last change that was found, (N,) each."""

    odds: Array  # R when it was found [days]; 0: nothing was
    needed: Array  # … and that from which it was found
    ago_days: Array  # since it was found
    began_days: Array  # mean of the days between its beginning and its finding …
    began_std: Array  # … and how unsure that is
    at_once: Array  # probability that it was a step, and not a new rate


def nothing_found(channels: int) -> Found:
    """Before the first change."""
    return Found(**{name: np.zeros(channels) for name in Found.__dataclass_fields__})


def remember_found(
    found: Found, n: np.ndarray, R: Array, needed: Array, p: Array, bank: Bank, replays: Array, age_days: Array, priors: ChangePriors
) -> None:
    """The channels n have changed, in place. R, needed : (2, N); p : (H, N) of the kinds of noise; age_days : (N,)."""
    few = bank.of(n)
    odds, share = few.shares(replays[n], priors)
    weight = share * (p[:, n] * odds)[:, None, None]
    of_start, of_sort = weight.sum(axis=(0, 2)), weight.sum(axis=(0, 1))  # (C, n), (4, n)
    total = of_start.sum(axis=0)
    ago = age_days[n] - few.born_days
    mean = (of_start * ago).sum(axis=0) / total
    found.began_days[n] = mean
    found.began_std[n] = np.sqrt((of_start * (ago - mean) ** 2).sum(axis=0) / total)
    found.at_once[n] = of_sort[np.array(SHAPES) != NEW_RATE].sum(axis=0) / total
    row = np.argmax(R[:, n] / needed[:, n], axis=0)
    found.odds[n], found.needed[n], found.ago_days[n] = R[row, n], needed[row, n], 0.0
