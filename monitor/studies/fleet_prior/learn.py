"""From the filter states of a fleet's arms to the document of its prior. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.judge.drift.filter_state import CURVE, LAG, LEVELS, RATE, SLOPE, FilterState
from monitor.judge.drift.noise.size import DIFFERENCES
from monitor.judge.drift.prior import BOUNDS, FORMAT, VERSION
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.temperature.laws import TemperatureSettings
from monitor.recording import Array
from monitor.studies.fleet_prior.memory_of_noise import learn_memory
from monitor.studies.fleet_prior.pool import Pooled, digits, pool
from monitor.studies.fleet_prior.wear import Joint, learn_wear, rising, worn

LEAST_REPLAYS = 40  # an arm with fewer still says what it was told at its beginning
VISCOUS_SHARE = 0.5  # of friction at the reference speed, in the family's prior
NOISE_SPREAD = 0.5  # [log σ] standard deviation between arms of the family: 1.2 to 3.3 % around 2 %


class LearntArm(NamedTuple):
    """What is read of one arm's history."""

    name: str
    model: str
    state: FilterState
    days: float  # since the first replay
    reference_speed_rad_s: float = 0.4  # at which its friction was followed
    slot: int = 0  # of the filter, with the level of the context in force


def learn_prior(arms: Sequence[LearntArm], drift: DriftSettings, temperature: TemperatureSettings) -> dict[str, Any]:
    """The document of the prior of every model that has an arm with `LEAST_REPLAYS` replays of most joints.

    Raises BadInput where there is none, or where their reference speeds differ.
    """
    old = [arm for arm in arms if float(np.median(arm.state.replays)) >= LEAST_REPLAYS]
    if not old:
        most = max((float(np.median(arm.state.replays)) for arm in arms), default=0.0)
        raise BadInput(f"no arm with {LEAST_REPLAYS} replays to learn from: the longest history of {len(arms)} holds {most:.0f}")
    speeds = sorted({arm.reference_speed_rad_s for arm in old})
    if len(speeds) > 1:
        named = "; ".join(f"{speed:g} rad/s in {next(arm.name for arm in old if arm.reference_speed_rad_s == speed)}" for speed in speeds)
        raise BadInput(f"the arms' friction was followed at different speeds ({named}); expected one [drift] reference_speed_rad_s")
    by_model = {model: [arm for arm in old if arm.model == model] for model in sorted({arm.model for arm in old})}
    return {
        "format": FORMAT,
        "version": VERSION,
        "reference_speed_rad_s": speeds[0],
        "learnt_from": {
            "arms": len(old),
            "left_out": [f"{arm.name}: {np.median(arm.state.replays):.0f} replays" for arm in arms if arm not in old],
            "joint_years": round(sum(arm.days * arm.state.joints for arm in old) / 365.0, 2),
        },
        "models": {model: _of_model(of_it, drift, temperature) for model, of_it in by_model.items()},
    }


def _of_model(arms: Sequence[LearntArm], drift: DriftSettings, temperature: TemperatureSettings) -> dict[str, Any]:
    """The prior of one model."""
    J = arms[0].state.joints
    states = [arm.state for arm in arms]
    family = _family(drift, temperature)
    pooled = {name: _pooled(states, entry, *family[name], J) for name, entry in (("slope", SLOPE), ("curve", CURVE), ("lag", LAG))}
    replays = np.array([state.replays for state in states])
    rho = np.array([state.autocorrelation(J, drift) for state in states])
    sigma2 = np.array([state.noise_var(J, drift, of_arm) for state, of_arm in zip(states, rho, strict=True)])
    # the noise is the arm's: its joints are alike, and their number says how well it is known
    chance = DIFFERENCES / np.maximum(replays.sum(axis=1), 1.0)
    log_sigma = 0.5 * np.log(sigma2)
    noise = pool(log_sigma, np.repeat(0.25 * chance[:, None], J, axis=1), np.full(J, np.log(drift.between_std)), np.full(J, NOISE_SPREAD))
    # log γ₁ of n replays scatters by 3/n: a spread of 4·τ² of log σ² between arms is what so many replays would leave
    weight = DIFFERENCES / np.maximum(4.0 * noise.std**2, 1e-9)
    level = np.array([state.mean[:, LEVELS] for state in states])
    began, pace = _wear(states)
    wear = learn_wear([Joint(arm.state, int(n), arm.slot) for arm in arms for n in np.flatnonzero(rising(arm.state))], drift)
    years = sum(arm.days for arm in arms) * J / 365.0
    columns: Mapping[str, Array] = {
        "slope_per_k": pooled["slope"].mean,
        "slope_std_per_k": pooled["slope"].std,
        "curve_per_k2": pooled["curve"].mean,
        "curve_std_per_k2": pooled["curve"].std,
        "lag": pooled["lag"].mean,
        "lag_std": pooled["lag"].std,
        "noise_std": np.exp(noise.mean),
        "noise_correlation": np.mean(rho, axis=0),
        "noise_replays": weight,
    }
    bounded = {name: np.clip(column, *BOUNDS[name]) for name, column in columns.items()}
    median = np.median(level, axis=0)
    return {
        "arms": len(arms),
        "joint_years": round(years, 2),
        # a joint begins to wear so often: the setting that stands in counts as one beginning
        "onsets_per_year": digits((began + 1.0) / (years + 1.0 / max(drift.onsets_per_year, 1e-6))),
        "wear_per_year": digits(365.0 * pace) if np.isfinite(pace) else None,
        "chance": learn_memory(states),
        "wear": None if wear is None else {name: value if name == "joints" else digits(value) for name, value in asdict(wear).items()},
        "joints": [
            {
                "joint": j + 1,
                **{name: digits(column[j]) for name, column in bounded.items()},
                "friction_nm": digits(np.exp(median[j])),
                "friction_spread": digits(1.4826 * np.median(np.abs(level[:, j] - median[j]))),
            }
            for j in range(J)
        ],
    }


def _family(drift: DriftSettings, temperature: TemperatureSettings) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of slope, curve and lag among all arms of the family, as in `initial_filter`."""
    fall = temperature.viscous_fall_per_k
    slope = fall * VISCOUS_SHARE
    slope_std = float(np.hypot(temperature.viscous_fall_std_per_k * VISCOUS_SHARE, temperature.coulomb_fall_std_per_k))
    curve = 0.5 * fall**2 * VISCOUS_SHARE * (1.0 - VISCOUS_SHARE)
    lag_std = float(np.hypot(slope * drift.grease_lag_std_min, slope_std * drift.grease_lag_min))
    return {"slope": (slope, slope_std), "curve": (curve, max(curve, 1e-6)), "lag": (slope * drift.grease_lag_min, lag_std)}


def _pooled(states: Sequence[FilterState], entry: int, mean: float, std: float, joints: int) -> Pooled:
    """One entry of the filter's mean, pooled over the arms.

    The filter's estimate holds the family's prior already; what the replays alone say is the estimate with that prior taken out. Where
    they say next to nothing, the arm is left out.
    """
    value = np.array([state.mean[:, entry] for state in states])
    variance = np.array([state.cov[:, entry, entry] for state in states])

    information = 1.0 / np.maximum(variance, 1e-300) - 1.0 / std**2
    told = information * std**2 > 1.0
    own_variance = np.where(told, 1.0 / np.where(told, information, 1.0), np.nan)
    own_value = np.where(told, (value / np.maximum(variance, 1e-300) - mean / std**2) * own_variance, np.nan)
    return pool(own_value, own_variance, np.full(joints, mean), np.full(joints, std))


def _wear(states: Sequence[FilterState]) -> tuple[float, float]:
    """Number of joints whose friction surely rises or has stepped up, and the root mean square of the sure rates [1/usual day]."""
    began, rates = 0, []
    for state in states:
        began += int(np.sum(worn(state)))
        rates += state.mean[rising(state), RATE].tolist()
    return float(began), float(np.sqrt(np.mean(np.square(rates)))) if rates else float("nan")
