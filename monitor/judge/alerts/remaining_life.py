"""The days until friction reaches its limit, along the path that friction has taken so far.

By the joint's (wear, rate) alone, friction goes on along a straight line, and the days are the first passage of a Wiener process with
drift, averaged over the posterior of its rate: for one rate ν the time to rise by d is inverse Gaussian (Chhikara & Folks, 1989). The
posterior enters by a fixed lattice, so that the same posterior always gives the same result. With the joint's history, friction goes on
along a mixture of slowing, straight and accelerating paths (`wear_paths`). The result is when friction crosses a threshold; a gear may
break earlier or later.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy

from monitor.judge.alerts.wear_paths import ACCELERATING, SLOWING, STRAIGHT, WearPaths, wear_paths
from monitor.judge.friction.prior import WearPrior
from monitor.judge.friction.states import RATE, WEAR
from monitor.judge.friction.step import FrictionModel, FrictionState
from monitor.judge.settings import PrognosisSettings
from monitor.reason import Reason, Sentence, reason_at, together
from monitor.recording import Array

STRAIGHT_LINE = Sentence("straight_line", "if friction goes on along a straight line")()
PATHS = {
    "slowing": Sentence("path_slowing", "if friction slows down as it has so far (probability {percent:.0f} %)"),
    "straight": Sentence("path_straight", "if friction goes on along a straight line as it has so far (probability {percent:.0f} %)"),
    "accelerating": Sentence("path_accelerating", "if friction goes on accelerating as it has so far (probability {percent:.0f} %)"),
}
SOONER = Sentence(
    "path_or_sooner", "{path}; a path that accelerates (probability {percent:.0f} %) reaches the limit in {sooner_days:.0f} d"
)
LIMIT_IN = Sentence("limit_in", "{joint:joint}: the limit in {days:.0f} d {assumption}.")


def assumption_of(path: str, probability: float, accelerating: float, sooner_days: float | None) -> Reason:
    """What the days assume: the likeliest path, and when friction reaches the limit on one that accelerates.

    accelerating, sooner_days : probability of such a path, and its median; None where it is too unlikely to be told.
    """
    likeliest = PATHS[path](percent=100 * probability)
    if sooner_days is None or path == "accelerating":
        return likeliest
    return SOONER(path=likeliest, percent=100 * accelerating, sooner_days=sooner_days)


def assumptions(rows: Sequence[Mapping[str, Any]]) -> Reason | None:
    """One sentence for each joint with a date, from its rows of `friction`; None where no joint has one or none says what it assumes."""
    sentences = []
    for row in rows:
        life = row.get("remaining_life") or {}
        assumption = reason_at(life, "assumption")
        if life.get("p50_days") is not None and assumption is not None:
            sentences.append(LIMIT_IN(joint=row["joint"], days=life["p50_days"], assumption=assumption))
    return together(*sentences) if sentences else None


# --- The days until friction reaches its limit -----------------------------------------------------------

DAYS = np.geomspace(0.05, 20_000.0, 48)  # coarse table of the distribution; 20 000 days, or 54 years, are the longest prediction
FINE_POINTS = 96  # of the fine table, between the coarse points beside P10 and P90
# A golden-ratio lattice over (rate, wear given the rate) with equally likely points. With few Gauss nodes the mixture of nearly sharp
# passages would be a staircase, and its quantiles would be the steps.
NODES = 199
FAMILIES = {"slowing": SLOWING, "straight": STRAIGHT, "accelerating": ACCELERATING}
WORTH_TELLING = 0.05  # probability from which it is said when an accelerating path would reach the limit


class RemainingLife(NamedTuple):
    """Days until the limit; None beyond 20 000 days, and for all three quantiles where there is no trend. The names are published."""

    trend_probability: float  # P(wear rate > 0)
    p10_days: float | None
    p50_days: float | None
    p90_days: float | None
    verdict: str  # "trend" | "no_trend" | "reached"
    before_service_probability: float = 0.0  # that friction reaches the limit within `service_days`
    path: str | None = None  # the likeliest: slowing | straight | accelerating; None where no date is given
    path_probability: float | None = None  # of that one
    accelerating_probability: float | None = None  # None where only (wear, rate) are known: then the path is assumed to be straight
    accelerating_p50_days: float | None = None  # the median, should the path accelerate
    rate_per_day: float | None = None  # wear rate now, a fraction per usual day, averaged over the paths; None as the quantiles
    rate_std_per_day: float | None = None
    assumption: Reason | None = None  # what the days assume; None where no date is given


def remaining_life(
    mean: Array, cov: Array, *, wear_walk_per_sqrt_day: float, settings: PrognosisSettings, paths: WearPaths | None = None
) -> RemainingLife:
    """The remaining life of one joint.

    mean (2,), cov (2, 2) : posterior of wear w = log(F/F0) and of the wear rate, a fraction of F0 per usual day.
    paths : along which friction goes on, from the joint's history; without it, the same usage every day adds the same rise of friction, so
    that friction approaches the limit along a straight line, and the days of a joint that accelerates are too many: ask
    `remaining_life_of_joint` wherever there is a state.
    """
    mean, cov = as_rise(mean, cov)
    trend = float(scipy.special.ndtr(mean[1] / max(math.sqrt(cov[1, 1]), 1e-300)))
    if mean[0] >= settings.limit_rise:
        return RemainingLife(trend, 0.0, 0.0, 0.0, "reached", 1.0)

    def straight(days: Array) -> Array:
        return _mixture(mean, cov, days, wear_walk_per_sqrt_day, settings)

    if trend < settings.trend_sure:
        return RemainingLife(trend, None, None, None, "no_trend", float(straight(np.array([settings.service_days]))[0]))
    if paths is None:
        p10, p50, p90 = _quantiles(straight)
        service, rate = float(straight(np.array([settings.service_days]))[0]), (float(mean[1]), math.sqrt(cov[1, 1]))
        return RemainingLife(trend, p10, p50, p90, "trend", service, "straight", None, None, None, *rate, STRAIGHT_LINE)

    def reached(days: Array, weight: Array) -> Array:
        probability: Array = paths.reached(days, settings.limit_rise, wear_walk_per_sqrt_day) @ weight
        return np.minimum(np.maximum.accumulate(probability), 1.0)  # the sum of the weights is rounded

    p10, p50, p90 = _quantiles(lambda days: reached(days, paths.weight))
    probability = {name: paths.probability(family) for name, family in FAMILIES.items()}
    likeliest = max(probability, key=lambda name: probability[name])
    faster = paths.weight * ACCELERATING[paths.shape]
    sooner = _quantiles(lambda days: reached(days, faster / faster.sum()))[1] if probability["accelerating"] >= WORTH_TELLING else None
    rate = paths.rate()
    return RemainingLife(
        trend_probability=trend,
        p10_days=p10,
        p50_days=p50,
        p90_days=p90,
        verdict="trend",
        before_service_probability=float(reached(np.array([settings.service_days]), paths.weight)[0]),
        path=likeliest,
        path_probability=probability[likeliest],
        accelerating_probability=probability["accelerating"],
        accelerating_p50_days=sooner,
        rate_per_day=rate[0],
        rate_std_per_day=rate[1],
        assumption=assumption_of(likeliest, probability[likeliest], probability["accelerating"], sooner),
    )


def remaining_life_of_joint(
    state: FrictionState, n: int, model: FrictionModel, prognosis: PrognosisSettings, prior: WearPrior | None = None
) -> RemainingLife:
    """The remaining life of channel n of a state, along the path that its friction has taken so far. prior : of the fleet.

    A joint whose friction begins to rise on day 60, by 30 % in the square of the time to day 360, asked on day 300:

    >>> import numpy as np
    >>> from monitor.judge.friction.observation import Observation
    >>> from monitor.judge.friction.step import FrictionModel, initial_state, step
    >>> model, rng, state = FrictionModel(), np.random.default_rng(1), None
    >>> for day in range(300):
    ...     torque = 10.0 * np.exp(0.02 * rng.normal(size=6))
    ...     torque[1] *= 1.0 + 0.3 * (max(day - 60, 0) / 300) ** 2
    ...     observation = Observation(
    ...         log_torque=np.log(torque),
    ...         variance=np.full(6, 0.005**2),
    ...         temperature_c=30.0 + rng.normal(size=6),
    ...         viscous_share=np.full(6, 0.4),
    ...         warming_k_per_min=np.zeros(6),
    ...         coulomb_nm=0.6 * torque,
    ...         viscous_nm_s_per_rad=torque,
    ...     )
    ...     if state is None:
    ...         state = initial_state(observation, 6, model)
    ...     state = step(state, observation, np.array([float(day > 0)]), model, in_place=True)
    >>> life = remaining_life_of_joint(state, 1, model, PrognosisSettings())
    >>> life.path
    'accelerating'
    """
    mean, cov = state.of_kinds(np.array([WEAR, RATE]), n)
    walk = model.states.level_walk
    straight = remaining_life(mean, cov, wear_walk_per_sqrt_day=walk, settings=prognosis)
    if straight.verdict != "trend":
        return straight
    paths = wear_paths(state.course[n], state, n, model, prior)
    return remaining_life(mean, cov, wear_walk_per_sqrt_day=walk, settings=prognosis, paths=paths)


def as_rise(mean: Array, cov: Array) -> tuple[Array, Array]:
    """Mean and covariance of (rise, rise per day) as fractions, from those of (log(1 + rise), rise per day), to first order."""
    factor = math.exp(mean[0])
    M = np.diag([factor, 1.0])  # Jacobian
    return np.array([factor - 1.0, mean[1]]), M @ cov @ M.T


def first_passage(days: Array, rise: Array, rate: Array, walk: float) -> Array:
    """Probability that a Wiener process has risen by `rise` within `days`; 1 for a rise of 0 or less. Arguments are broadcast.

    rate : drift ν [1/d]; walk : σ [1/√d]. Chhikara & Folks (1989): Φ((νt−d)/(σ√t)) + exp(2νd/σ²)·Φ(−(d+νt)/(σ√t)). The second term is
    computed in logarithms, since its exponential overflows.
    """
    spread = walk * np.sqrt(days)
    second = 2.0 * rate * rise / walk**2 + scipy.special.log_ndtr(-(rise + rate * days) / spread)
    passed: Array = np.where(rise <= 0, 1.0, scipy.special.ndtr((rate * days - rise) / spread) + np.exp(np.minimum(second, 0.0)))
    return np.minimum(passed, 1.0)


@functools.cache
def _lattice() -> tuple[Array, Array]:
    """Standard normal quantiles for the rate and for the wear given the rate, (M,) each. Computed at first use: commands start faster."""
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    return scipy.special.ndtri((np.arange(NODES) + 0.5) / NODES), scipy.special.ndtri((np.arange(NODES) * golden + 0.5) % 1.0)


def _mixture(mean: Array, cov: Array, days: Array, walk: float, settings: PrognosisSettings) -> Array:
    """Probability that friction reaches the limit within days (D,), averaged over the posterior of (rise, rate)."""
    rate_std = math.sqrt(max(cov[1, 1], 1e-300))
    tilt = cov[0, 1] / rate_std
    rest_std = math.sqrt(max(cov[0, 0] - tilt**2, 0.0))
    rate_nodes, wear_nodes = _lattice()
    rate = mean[1] + rate_std * rate_nodes  # (M,)
    wear = mean[0] + tilt * rate_nodes + rest_std * wear_nodes  # (M,)
    rise = settings.limit_rise - wear
    mixed: Array = np.mean(first_passage(days[:, None], rise, rate, walk), axis=1)  # (D, M) → (D,)
    return mixed


def _quantiles(reached: Callable[[Array], Array]) -> tuple[float | None, float | None, float | None]:
    """P10, P50 and P90 [d] of a distribution function of days; None where it does not reach them within 20 000 days."""
    coarse = reached(DAYS)
    first, last = np.searchsorted(coarse, [0.1, 0.9])  # P10 and P90 lie between these points and the ones before
    days = np.geomspace(DAYS[max(first - 1, 0)], DAYS[min(last, len(DAYS) - 1)], FINE_POINTS)
    fine = reached(days)
    return _quantile(days, fine, 0.1), _quantile(days, fine, 0.5), _quantile(days, fine, 0.9)


def _quantile(days: Array, reached: Array, p: float) -> float | None:
    """Days at which the tabulated distribution reaches p, interpolated in the logarithm of days; None where it does not reach p."""
    if reached[-1] < p:
        return None
    i = int(np.searchsorted(reached, p))
    if i == 0:
        return float(days[0])
    share = (p - reached[i - 1]) / (reached[i] - reached[i - 1])
    return float(np.exp(np.log(days[i - 1]) + share * np.log(days[i] / days[i - 1])))
