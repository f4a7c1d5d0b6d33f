"""How well can anybody date a joint at a quarter of its life? `python -m tests.bench.quarter_of_life [--arms 400] [--spread 0.5]`.

An observer who knows the noise, the temperature law and that friction rises along a straight line finds the level, the day of the onset
and the rate, by their posterior on a grid: the median of the remaining life, against the truth. Nothing of the monitor is used: days,
noise and likelihood are made here. Every joint begins on day 60 and wears 30 % a year, × or ÷ e^spread, up to 30 %.
"""

import argparse
from typing import NamedTuple

import numpy as np

SIGMA, RHO, WITHIN, LIMIT, ONSET, ALPHA = 0.02, 0.5, 0.005, 0.3, 60, 0.2
MIDDLE = 0.3 / 365.0  # rate [1/d]
RATES = np.exp(np.linspace(np.log(0.02), np.log(4.0), 161)) / 365.0
MOST_ONSETS = 80


class Told(NamedTuple):
    """What the observer is told besides."""

    name: str
    lives: bool  # the fleet's lives
    onset: bool  # the day of the onset


OBSERVERS = (
    Told("finds onset and rate", lives=False, onset=False),
    Told("is told the fleet's lives", lives=True, onset=False),
    Told("is told the onset", lives=False, onset=True),
    Told("is told both", lives=True, onset=True),
)


def ratios(rng: np.random.Generator, rate: float, spread: float) -> list[float]:
    """The median of the remaining life over the truth, of one joint, for each observer."""
    days = np.arange(round(ONSET + 0.25 * LIMIT / rate) + 1)
    noise = SIGMA**2 * RHO ** np.abs(days[:, None] - days) + np.eye(len(days)) * WITHIN**2
    root = np.linalg.cholesky(noise)
    white = np.linalg.inv(root)
    seen = white @ (np.log1p(rate * np.maximum(days - ONSET, 0)) + root @ rng.normal(size=len(days)))
    level = white.sum(axis=1)
    truth = (LIMIT - rate * (days[-1] - ONSET)) / rate
    found = []
    for told in OBSERVERS:
        onsets = np.array([ONSET]) if told.onset else np.arange(0, len(days) - 1, max(1, len(days) // MOST_ONSETS))
        rise = np.log1p(RATES[:, None, None] * np.maximum(days - onsets[:, None], 0))  # (R, O, T)
        rest = seen - rise @ white.T
        log = -0.5 * (np.sum(rest**2, axis=2) - (rest @ level) ** 2 / (level @ level))  # the level is integrated out
        if told.lives:
            log -= 0.5 * (np.log(RATES / MIDDLE) / spread)[:, None] ** 2
        weight = np.exp(log - log.max()).ravel()
        left = np.maximum(LIMIT / RATES[:, None] - (days[-1] - onsets), 0.0).ravel()
        order = np.argsort(left)
        reached = np.cumsum(weight[order])
        found.append(float(left[order][np.searchsorted(reached, 0.5 * reached[-1])] / truth))
    return found


def main() -> None:
    """A line an observer."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.quarter_of_life", description=__doc__)
    parser.add_argument("--arms", type=int, default=400)
    parser.add_argument("--spread", type=float, default=0.5, help="standard deviation of the logarithm of the rates")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    rates = MIDDLE * np.exp(arguments.spread * rng.normal(size=arguments.arms))
    each = np.array([ratios(rng, rate, arguments.spread) for rate in rates])
    for told, ratio in zip(OBSERVERS, each.T, strict=True):
        near = float(np.mean(np.abs(ratio - 1.0) <= ALPHA))
        error = (near * (1.0 - near) / len(ratio)) ** 0.5
        print(f"{told.name}: {near:.0%} ± {error:.0%} within {ALPHA:.0%} of the truth, median ratio {np.median(ratio):.2f}", flush=True)


if __name__ == "__main__":
    main()
