"""Partial pooling of what the filters of many arms have learnt. Pure.

The model of a figure x of one joint of one robot model: arm a has xₐ ~ N(μ, τ²), its filter says x̂ₐ ~ N(xₐ, sₐ²), and the family says
μ ~ N(m₀, τ₀²). τ² is found by moments (DerSimonian and Laird, 1986) from deviations that are bounded, and weighed against τ₀² with the
weight of `FAMILY_ARMS` arms. So few arms say little and stay near the family, and many arms speak for themselves, whatever other models do.

Shapes: A arms of one model, J joints.
"""

from typing import NamedTuple

import numpy as np

from monitor.recording import Array

FAMILY_ARMS = 4.0  # weight of the family's spread between arms, in arms
BOUND_SIGMA = 2.5  # an arm further away counts as one at this distance: one regreased or broken arm does not widen the prior
BOUNDED_VAR = 0.956  # of N(0, 1) bounded at ± 2.5
ROUNDS = 20  # of the fixed point; three digits are reached after some five


class Pooled(NamedTuple):
    """What is expected of the joint of a new arm, (J,) each."""

    mean: Array
    std: Array  # of a new arm about the mean, the doubt of the mean included
    between_std: Array  # τ, between arms


def pool(value: Array, variance: Array, family_mean: Array, family_std: Array) -> Pooled:
    """Value and variance (A, J) of the arms; mean and deviation (J,) among all arms of the family. NaN values are left out."""
    known = np.isfinite(value) & np.isfinite(variance)
    value, variance = np.where(known, value, 0.0), np.where(known, np.maximum(variance, 0.0), 1.0)
    number, of_family = known.sum(axis=0), family_std**2
    between, mean = of_family, np.asarray(family_mean, dtype=float)
    for _ in range(ROUNDS):
        spread = np.sqrt(between + variance)
        away = np.where(known, np.clip((value - mean) / spread, -BOUND_SIGMA, BOUND_SIGMA) * spread, 0.0)
        weight = np.where(known, 1.0 / spread**2, 0.0)
        mean = mean + (np.sum(weight * away, axis=0) + (family_mean - mean) / of_family) / (weight.sum(axis=0) + 1.0 / of_family)
        own = np.maximum(np.sum(np.where(known, away**2 / BOUNDED_VAR - variance, 0.0), axis=0), 0.0)
        between = (own + FAMILY_ARMS * of_family) / (number + FAMILY_ARMS)
    of_mean = 1.0 / (np.where(known, 1.0 / (between + variance), 0.0).sum(axis=0) + 1.0 / of_family)
    return Pooled(mean, np.sqrt(between + of_mean), np.sqrt(between))


def digits(value: float) -> float:
    """Six digits of a figure: the seventh differs between processors."""
    return float(f"{value:.6g}")
