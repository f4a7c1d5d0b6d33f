"""Series beside friction at the reference speed, each judged by the same model with other priors: wear that F(v*) does not show.

`contrast` is log fc − log fv; `slow` and `fast` are log friction at other speeds over F(v*), by a law richer than fc + fv·v; `residual` is
what the fit leaves unexplained, and `noise` that of the current's readings; `ripple-1` and `ripple-2` are the gear's ripple
once and twice a turn of the motor over F(v*), with a floor. Each is a logarithm, as friction is. None of them has a law of
temperature, only a slope that nobody knows; and there are fewer kinds of noise: a change of these series is told when it is large.
"""

from collections.abc import Mapping
from functools import cache

import numpy as np

from monitor.judge.friction.changes import ChangePriors
from monitor.judge.friction.decision import DecisionSettings
from monitor.judge.friction.noise import Kind, NoisePriors
from monitor.judge.friction.observation import Observation
from monitor.judge.friction.states import Priors
from monitor.judge.friction.step import FrictionModel
from monitor.recording import Array

KINDS = (
    *(Kind(rho, steady_replays=100.0, arm_steady_replays=15.0, weight=0.25) for rho in (0.0, 0.45, 0.75)),
    *(Kind(rho, weight=weight, alone=alone) for rho, weight, alone in ((0.9, 0.15, 1.0), (0.97, 0.1, 0.3), (0.99, 0.1, 0.3))),
    *(Kind(rho, 2.0, weight=0.05, alone=0.1) for rho in (0.0, 0.45)),  # wandering
)
RIPPLE = ("ripple-1", "ripple-2")
# [log] smaller changes are within the error of the fit and of the laws that it assumes; noise that grew by less is nothing to look at, and
# load, season and grease move the ripple of a sound gear by less
LEAST: Mapping[str, float] = {
    "contrast": 0.2,
    "slow": 0.06,
    "fast": 0.06,
    "residual": 0.2,
    **dict.fromkeys(("noise", *RIPPLE), np.log(2.0).item()),
}
NOISE_STD: Mapping[str, float] = dict.fromkeys(LEAST, 0.1) | {"slow": 0.02, "fast": 0.02}  # [log] prior


@cache
def model_beside(series: str) -> FrictionModel:
    """The model of one of the series, by its name in `LEAST`."""
    least = LEAST[series]
    states = Priors(slope_per_k=(0.0, 0.005, 0.0), curve_per_k2=(0.0, 5e-5), settling=(0.0, least))
    changes = ChangePriors(steps_std=(2.0 * least, 5.0 * least), rates_std=(5.0 * least / 365.0, 50.0 * least / 365.0))
    # both orders of the ripple are one question, and share what it may cost
    decision = DecisionSettings(false_alarms_per_year=0.05 / (len(RIPPLE) if series in RIPPLE else 1), least=least)
    noise = NoisePriors(kinds=KINDS, std=NOISE_STD[series])
    return FrictionModel(states=states, noise=noise, changes=changes, decision=decision, keeps_course=False, by_filterpy=False)


def values_beside(seen: Observation) -> dict[str, Array]:
    """(N,) each series of a replay [log]; NaN where a figure is missing or no friction."""
    N = len(seen.log_torque)

    def log(value: Array) -> Array:
        positive = np.isfinite(value) & (value > 0)
        return np.where(positive, np.log(np.where(positive, value, 1.0)), np.nan)

    def optional(value: Array) -> Array:
        return value if np.shape(value) == (N,) else np.full(N, np.nan)

    return {
        "contrast": log(seen.coulomb_nm) - log(seen.viscous_nm_s_per_rad),
        "slow": optional(seen.log_torque_slow) - seen.log_torque,
        "fast": optional(seen.log_torque_fast) - seen.log_torque,
        "residual": log(optional(seen.residual_rms_nm)),
        "noise": log(optional(seen.current_noise_a)),
        **{name: (seen.ripple[:, order] if seen.ripple.ndim > 1 else np.full(N, np.nan)) for order, name in enumerate(RIPPLE)},
    }


def observations_beside(seen: Observation) -> dict[str, Observation]:
    """The replay as the model sees each series that somebody measured."""
    N = len(seen.log_torque)
    one, nothing = np.ones(N), np.zeros(N)
    # a replay that does not resolve the ripple says less, and zeros in a row are no scatter of zero
    variance = {} if seen.ripple_variance.ndim < 2 else dict(zip(RIPPLE, np.nan_to_num(seen.ripple_variance).T, strict=True))
    return {
        name: Observation(
            log_torque=np.where(np.isfinite(seen.log_torque), values, np.nan),
            variance=variance.get(name, nothing),
            temperature_c=seen.temperature_c,
            viscous_share=one,
            warming_k_per_min=seen.warming_k_per_min,
            coulomb_nm=one,
            viscous_nm_s_per_rad=one,
        )
        for name, values in values_beside(seen).items()
        if np.isfinite(values).any()
    }
