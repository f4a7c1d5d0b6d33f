"""What the friction of a joint consists of: the states of the model, their priors, and how they change from replay to replay.

With y = log F at the reference speed, t the distance of the temperature T from that of the first replay (`viscous_distance`), Ṫ the rate at
which the joint warms, and s the days since the joint was new:

    y = level_c + w + β·t + γ·t² + δ·t³ + (λ + μ·t)·h(Ṫ) + ζ·e^(−s/30 d) + o + u + ε,      w⁺ = w + e^(−w)·ẇ·Δ

level_c of context c is unknown; wear w and its rate ẇ are 0 until a change makes them otherwise (`changes`). β … μ have the priors of
the robot family, ζ is running-in. o and u are noise between replays (`noise`), ε the noise within one, of the variance that its fit tells.

Shapes: H kinds of noise, D states, N channels (the joints of each arm, then the mean of the arm), which are last: steps run along them.
"""

from dataclasses import dataclass

import numpy as np

from monitor.recording import Array

# w [log], ẇ [log/usual day], β [1/K], γ [1/K²], δ [1/K³], λ [1/(K/min)], μ [1/(K²/min)], ζ [log], o [log], u and its quadrature [log];
# then a level a context [log]
WEAR, RATE, SLOPE, CURVE, CUBE, LAG, COLD_LAG, SETTLING, NOISE, SLOW, SLOW_TURN, LEVEL = range(12)


@dataclass(frozen=True, slots=True, kw_only=True)
class Priors:
    """What is believed of any joint before it has said anything."""

    level_std: float = 10.0  # [log] e^±10 covers every torque
    level_walk: float = 1e-4  # [log/√day] of a level: 0.2 % in a year, and no law of temperature is truer
    slope_per_k: tuple[float, float, float] = (-0.015, 0.007, 0.003)  # of viscous friction: mean, standard deviation; that of dry friction
    curve_per_k2: tuple[float, float] = (8e-5, 8e-5)  # mean, standard deviation: the part that is dry friction does not thin
    cube_per_k3: float = 3e-6  # standard deviation: 1 % at 15 K, as laws of greases and mixed films differ
    cold_lag_per_k: float = 0.03  # standard deviation of the share by which the lag's effect differs, 1 K away
    lag_min: tuple[float, float] = (8.0, 16.0)  # of the grease behind the motor, for h, which is about half of Ṫ: mean, standard deviation
    uneven: float = 0.35  # share of the lag's effect that differs from replay to replay: heat has several lags
    extrapolated: float = 1.0  # share of it by which the steady state is unsure
    settling: tuple[float, float] = (0.03, 0.025)  # [log] by which running-in lowers friction: mean, standard deviation …
    settling_days: float = 30.0  # … and in which it is e times less
    context_std: float = 1.0  # [log] by which the level of another context differs
    work_std: float = 0.5  # [log] by which work on a joint may move its friction: one of +60 % that is as new again is one of these
    other_grease: float = 0.15  # share of the slope by which that of another grease differs
    production_std: float = 0.02  # [log] of an observation from production …
    production_lasts: float = 3.0  # … whose noise is that of so many fewer observations: it lasts for days
    production_walk: float = 1e-3  # [log/√day] of production's level: 2 % in a year, as production changes little by little
    unknown_temperature_k: float = 5.0  # standard deviation of a temperature that nobody measured, about the joint's usual one


VOGEL_C = 95.0
FAST_K_PER_MIN = 0.1  # Ṫ at which h is half of Ṫ: heat nodes of lags of 3 to 30 min leave alike much of F there and at twice that


def saturating(warming_k_per_min: Array) -> Array:
    """h(Ṫ) [K/min] at warming rates (N,): odd, so that the noise of a rate about zero cancels."""
    slowed: Array = warming_k_per_min / (1.0 + np.abs(warming_k_per_min) / FAST_K_PER_MIN)
    return slowed


def viscous_distance(temperature_c: Array, origin_c: Array) -> Array:
    """T [K] in which the logarithm of a lubricant's viscosity is straight: T − origin, shortened where it is warm.

    log η = a + b/(T + 95 °C): Vogel (1921), with the constant of Cameron, The Principles of Lubrication (1966); 1 K a K at the origin.
    """
    away = temperature_c - origin_c
    distance: Array = away / (1.0 + away / (origin_c + VOGEL_C))
    return distance


def prior_of_states(level: Array, share: Array, levels: int, priors: Priors) -> tuple[Array, Array]:
    """Mean (D, N) and covariance (D, D, N) of channels that are new, noise left out.

    level : (N,) first value of y. share : (N,) viscous share of friction.
    """
    N, D = len(level), LEVEL + levels
    x, P = np.zeros((D, N)), np.zeros((D, D, N))
    per_k, std, dry_std = priors.slope_per_k
    x[LEVEL:], x[SLOPE], x[CURVE] = level, per_k * share, priors.curve_per_k2[0]
    x[LAG] = -per_k * share * priors.lag_min[0]
    states = np.arange(LEVEL, D)
    P[states, states] = priors.level_std**2
    P[SLOPE, SLOPE] = (std * share) ** 2 + dry_std**2
    P[CURVE, CURVE] = priors.curve_per_k2[1] ** 2
    P[CUBE, CUBE] = priors.cube_per_k3**2
    P[LAG, LAG] = (per_k * share * priors.lag_min[1]) ** 2
    P[COLD_LAG, COLD_LAG] = P[LAG, LAG] * priors.cold_lag_per_k**2
    x[SETTLING], P[SETTLING, SETTLING] = priors.settling[0], priors.settling[1] ** 2
    return x, P


def row(t: Array, warming_k_per_min: Array, age_days: Array, slot: Array, levels: int, priors: Priors, *, noise: float = 1.0) -> Array:
    """(D, N) H of a replay; noise : of o, 0 for friction itself."""
    H = np.zeros((LEVEL + levels, len(t)))
    H[WEAR] = H[SLOW] = 1.0
    h = saturating(warming_k_per_min)
    H[SLOPE], H[CURVE], H[CUBE], H[LAG], H[COLD_LAG] = t, t**2, t**3, h, t * h
    H[SETTLING], H[NOISE] = np.exp(-age_days / priors.settling_days), noise
    H[LEVEL + slot, np.arange(len(t))] = 1.0
    return H


def grow(x: Array, P: Array, B: Array, use: Array) -> None:
    """Let wear grow at its rate, in place. use : (N,) usual days. x (H, D, N), P (H, D, D, N), B (H, D, C, 2, N)."""
    slowed = np.exp(-np.clip(x[:, WEAR], -3.0, 3.0)) * use  # equal usage causes equal wear, and its logarithm grows ever more slowly
    x[:, WEAR] += x[:, RATE] * slowed
    P[:, WEAR] += slowed[:, None] * P[:, RATE]
    P[:, :, WEAR] += slowed[:, None] * P[:, :, RATE]
    B[:, WEAR] += B[:, RATE] * slowed[:, None, None].astype(np.float32)
