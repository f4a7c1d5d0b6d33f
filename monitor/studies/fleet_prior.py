"""Partial pooling of what the filters of many arms have learnt. Pure.

The model of a figure x of one joint of one robot model: arm a has xₐ ~ N(μ, τ²), its filter says x̂ₐ ~ N(xₐ, sₐ²), and the family says
μ ~ N(m₀, τ₀²). τ² is found by moments (DerSimonian and Laird, 1986) from deviations that are bounded, and weighed against τ₀² with the
weight of `FAMILY_ARMS` arms. So few arms say little and stay near the family, and many arms speak for themselves, whatever other models do.

Shapes: A arms of one model, J joints.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson

from monitor import __version__
from monitor.errors import BadInput, MonitorError, StoreUnavailable
from monitor.judge.alerts.wear_paths import FAMILIES, FAMILY_PRIOR, GROWTHS, OTHERS, POWERS, RISE_STD, WearPaths, elasticity, wear_paths
from monitor.judge.belief import Belief, belief_from_document
from monitor.judge.friction.changes import ChangePriors
from monitor.judge.friction.figures import wear_and_rate
from monitor.judge.friction.noise import NoisePriors, noise_of_fleet
from monitor.judge.friction.prior import BOUNDS, FORMAT, LIFE_RISE, NOISE_STD, OF_WEAR, SHARES, VERSION, WearPrior
from monitor.judge.friction.settings import DriftSettings
from monitor.judge.friction.states import CURVE, LAG, LEVEL, SLOPE, Priors
from monitor.judge.friction.step import FrictionModel, FrictionState
from monitor.judge.temperature.laws import TemperatureSettings
from monitor.plant.database import Database
from monitor.plant.priors import ModelPrior
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S, Array
from monitor.service.history.assess_and_store import load_state
from monitor.store.backup import HISTORY
from monitor.store.store import Store
from monitor.studies import from_plant
from monitor.studies.from_plant import PlantArm, belief_of

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


# --- How the joints of a fleet wear once they do: along which paths, and how fast. Pure -----------------

SURE_SIGMAS = 1.645  # a wear rate further above 0 is surely positive: 95 %, as for remaining life
LEAST_RISE = 0.02  # [log] healthy joints are found within it, and a detected one is above
FAMILY_SPREAD = 0.7  # [log] of the lives of any joints that wear: half to twice the median
LEAST_WORN = 10  # joints; fewer say nothing that a new joint should be held to
WEAR_ROUNDS = 100  # of expectation and maximisation; three digits are reached after some thirty


class Joint(NamedTuple):
    """One joint that surely rises."""

    state: FrictionState  # of its arm
    n: int  # from 0


def rising(state: FrictionState) -> np.ndarray:
    """(J,) whether a joint's friction surely rises, and has risen by more than chance makes of a healthy joint."""
    mean, cov = wear_and_rate(state)
    sure: np.ndarray = (mean[:, 1] > SURE_SIGMAS * np.sqrt(cov[:, 1, 1])) & (mean[:, 0] > LEAST_RISE)
    return sure


def worn(state: FrictionState) -> np.ndarray:
    """(J,) whether a joint's wear has begun: its friction surely rises, or has stepped up."""
    begun: np.ndarray = rising(state) | state.of_joints(state.risen)
    return begun


def learn_wear(joints: Sequence[Joint], model: FrictionModel) -> WearPrior | None:
    """What the joints of a fleet that wear say of the next one; None where fewer than `LEAST_WORN` show a path.

    Each joint's course has a mixture of paths, each with a life: the usual days from its onset to a rise by LIFE_RISE. The shares of the
    families of paths, and mean and spread of the lives' logarithms, are those under which all courses together are likeliest (empirical
    Bayes, by expectation and maximisation), with `FAMILY_ARMS` joints for what holds without a fleet. As in `wear_paths`, a joint may be
    none of the fleet: one that broke moves the fleet's figures little.
    """
    found = [wear_paths(state.course[n], state, n, model) for state, n in joints]
    courses = [_course(each) for each in found if each is not None]
    if len(courses) < LEAST_WORN:
        return None
    family = float(np.log(LIFE_RISE / model.changes.rates_std[0]))
    usual = np.array(FAMILY_PRIOR)
    shares, mean, var, of_fleet = usual, family, FAMILY_SPREAD**2, 0.0
    for _ in range(WEAR_ROUNDS):
        expected = sum((_expected(course, np.log(shares / usual), mean, var) for course in courses), np.zeros(5))
        of_fleet = float(expected[:3].sum())
        shares = (expected[:3] + FAMILY_ARMS * usual) / (of_fleet + FAMILY_ARMS)
        mean = float((expected[3] / var + family / FAMILY_SPREAD**2) / (of_fleet / var + FAMILY_SPREAD**-2.0))
        about_mean = expected[4] - 2.0 * mean * expected[3] + mean**2 * of_fleet
        var = float((about_mean + FAMILY_ARMS * FAMILY_SPREAD**2) / (of_fleet + FAMILY_ARMS))
    spread = np.sqrt(var + var / max(of_fleet, 1.0))
    figures = dict(zip(SHARES, shares, strict=True)) | {"life_days": np.exp(mean), "life_spread": spread}
    return WearPrior(joints=len(courses), **{name: float(np.clip(value, *OF_WEAR[name])) for name, value in figures.items()})


class _Course(NamedTuple):
    """The mixture of one joint's paths, (M,) each."""

    log_weight: Array  # of the likelihood: without what was expected of the rise
    family: np.ndarray  # index of FAMILIES
    life: Array  # log of the usual days from the onset to LIFE_RISE
    var: Array


def _course(paths: WearPaths) -> _Course:
    rise, shape = np.maximum(paths.mean[:, 2], 1e-4), paths.shape
    growth, ratio = GROWTHS[shape], LIFE_RISE / rise
    power = ratio ** (1.0 / POWERS[shape])
    accelerating = np.log1p(ratio * np.expm1(growth)) / np.maximum(growth, 1e-9)
    life = paths.since * np.where(growth > 0, accelerating, power)
    slope = elasticity(shape, paths.since, life)
    # the density that was expected of the logarithm of this life, by that of the rise
    expected = -0.5 * (rise / RISE_STD) ** 2 + np.log(2.0 / RISE_STD * slope * rise)
    family = np.argmax(np.stack([of[shape] for of in FAMILIES]), axis=0)
    return _Course(np.log(paths.weight) - expected, family, np.log(life), paths.cov[:, 2, 2] / (slope * rise) ** 2)


def _expected(course: _Course, log_odds: Array, mean: float, var: float) -> Array:
    """(5,) of one joint: the probability that it is one of the fleet and wears along each family, and its expected x and x² of the life."""
    spread = course.var + var
    log = course.log_weight + log_odds[course.family] - 0.5 * np.log(spread) - 0.5 * (course.life - mean) ** 2 / spread
    most = float(log.max())
    weight = np.exp(log - most)
    fleet = (1.0 - OTHERS) * weight.sum() * np.exp(min(most, 500.0))
    weight *= fleet / (fleet + OTHERS) / weight.sum()
    life, rest = (course.life * var + mean * course.var) / spread, course.var * var / spread
    families = np.bincount(course.family, weights=weight, minlength=3)
    return np.array([*families, weight @ life, weight @ (life**2 + rest)])


# --- From the states of a fleet's arms to the document of its prior. Pure ------------------------

SITE_ARMS = 10  # of a model at one site; with fewer, those of all sites say more of the next one there
LEAST_REPLAYS = 40  # an arm with fewer still says what it was told at its beginning
VISCOUS_SHARE = 0.5  # of friction at the reference speed, in the family's prior


class LearntArm(NamedTuple):
    """What is read of one arm's history."""

    name: str
    model: str
    state: FrictionState
    days: float  # since the first replay
    reference_speed_rad_s: float = 0.4  # at which its friction was followed


def learn_prior(
    arms: Sequence[LearntArm], drift: DriftSettings, temperature: TemperatureSettings, silent: Sequence[str] = ()
) -> dict[str, Any]:
    """The document of the prior of every model that has an arm with `LEAST_REPLAYS` replays of most joints.

    silent : a sentence for each history that says nothing. Raises BadInput where there is none, or where their reference speeds differ.
    """
    old = [arm for arm in arms if float(np.median(arm.state.of_joints(arm.state.replays))) >= LEAST_REPLAYS]
    if not old:
        why = [f"{len(silent)} say{'s' if len(silent) == 1 else ''} nothing, the first one: {silent[0]}"] if silent else []
        if arms or not silent:
            most = max((float(np.median(arm.state.of_joints(arm.state.replays))) for arm in arms), default=0.0)
            why.insert(0, f"the longest history of {len(arms)} holds {most:.0f}")
        raise BadInput(f"no arm with {LEAST_REPLAYS} replays to learn from: {'; '.join(why)}")
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
            "left_out": [f"{arm.name}: {np.median(arm.state.of_joints(arm.state.replays)):.0f} replays" for arm in arms if arm not in old],
            "joint_years": round(sum(arm.days * arm.state.joints_per_arm for arm in old) / 365.0, 2),
        },
        "models": {model: _of_model(of_it, drift, temperature) for model, of_it in by_model.items()},
    }


def _of_model(arms: Sequence[LearntArm], drift: DriftSettings, temperature: TemperatureSettings) -> dict[str, Any]:
    """The prior of one model."""
    J = arms[0].state.joints_per_arm
    states = [arm.state for arm in arms]
    family = _family(temperature)
    pooled = {name: _pooled(states, entry, *family[name], J) for name, entry in (("slope", SLOPE), ("curve", CURVE), ("lag", LAG))}
    noise = noise_of_fleet(
        np.concatenate([state.p for state in states], axis=1),
        np.concatenate([state.scale for state in states], axis=1),
        J,
        NoisePriors(std=drift.between_std),
        prior_arms=FAMILY_ARMS,
    )
    level = np.array([state.of_joints((state.p * state.x[:, LEVEL]).sum(axis=0)) for state in states])
    began, pace = _wear(states)
    wear = learn_wear([Joint(arm.state, int(n)) for arm in arms for n in np.flatnonzero(rising(arm.state))], FrictionModel())
    years = sum(arm.days for arm in arms) * J / 365.0
    columns: Mapping[str, Array] = {
        "slope_per_k": pooled["slope"].mean,
        "slope_std_per_k": pooled["slope"].std,
        "curve_per_k2": pooled["curve"].mean,
        "curve_std_per_k2": pooled["curve"].std,
        "lag": pooled["lag"].mean,
        "lag_std": pooled["lag"].std,
    }
    bounded = {name: np.clip(column, *BOUNDS[name]) for name, column in columns.items()}
    median = np.median(level, axis=0)
    return {
        "arms": len(arms),
        "joint_years": round(years, 2),
        # a joint begins to wear so often: what stands in counts as one beginning
        "onsets_per_year": digits((began + 1.0) / (years + 1.0 / ChangePriors().a_year)),
        "wear_per_year": digits(365.0 * pace) if np.isfinite(pace) else None,
        "noise": {"std": digits(float(np.clip(noise.std, *NOISE_STD))), "weights": [digits(kind.weight) for kind in noise.kinds]},
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


def _family(temperature: TemperatureSettings) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of slope, curve and lag among all arms of the family, as in `prior_of_states`."""
    family = Priors()
    slope = temperature.viscous_fall_per_k * VISCOUS_SHARE
    slope_std = float(np.hypot(temperature.viscous_fall_std_per_k * VISCOUS_SHARE, temperature.coulomb_fall_std_per_k))
    lag, lag_std = family.lag_min
    return {"slope": (slope, slope_std), "curve": family.curve_per_k2, "lag": (slope * lag, slope * lag_std)}


def _pooled(states: Sequence[FrictionState], entry: int, mean: float, std: float, joints: int) -> Pooled:
    """One of the states, pooled over the arms; −β is the slope.

    The estimate holds the family's prior already; what the replays alone say is the estimate with that prior taken out. Where
    they say next to nothing, the arm is left out.
    """
    sign = -1.0 if entry == SLOPE else 1.0
    value = np.array([sign * state.of_joints((state.p * state.x[:, entry]).sum(axis=0)) for state in states])
    variance = np.array([state.of_joints((state.p * state.P[:, entry, entry]).sum(axis=0)) for state in states])
    information = 1.0 / np.maximum(variance, 1e-300) - 1.0 / std**2
    informative = information * std**2 > 1.0
    own_variance = np.where(informative, 1.0 / np.where(informative, information, 1.0), np.nan)
    own_value = np.where(informative, (value / np.maximum(variance, 1e-300) - mean / std**2) * own_variance, np.nan)
    return pool(own_value, own_variance, np.full(joints, mean), np.full(joints, std))


def _wear(states: Sequence[FrictionState]) -> tuple[float, float]:
    """Number of joints whose friction surely rises or has stepped up, and the root mean square of the sure rates [1/usual day]."""
    began, rates = 0, []
    for state in states:
        began += int(np.sum(worn(state)))
        rates += wear_and_rate(state).mean[rising(state), 1].tolist()
    return float(began), float(np.sqrt(np.mean(np.square(rates)))) if rates else float("nan")


# --- The arms of a fleet, read from their histories or from a plant. I/O ------------------------------------------------


def arms_of(folders: Sequence[Path]) -> tuple[list[LearntArm], list[str]]:
    """The arms whose histories lie in the folders or in folders of these, and a sentence for each history that says nothing.

    Raises BadInput where a folder holds no history.
    """

    def belief(place: Path) -> Belief | None:
        with Store.reader(place) as store:
            return load_state(store).belief

    return _learnt((str(place), partial(belief, place)) for place in _histories(folders))


def arms_of_plant(database: Database) -> tuple[list[LearntArm], list[str]]:
    """The arms of a plant, and a sentence for each one that says nothing. Raises StoreError."""

    def belief(arm: PlantArm) -> Belief | None:
        document = belief_of(database, arm)
        return None if document is None else belief_from_document(document)

    return _learnt((arm.name, partial(belief, arm)) for arm in from_plant.arms_of_plant(database))


def prior_document(arms: Sequence[LearntArm], silent: Sequence[str] = ()) -> dict[str, Any]:
    """The document of `joint-monitor prior`. silent : a sentence for each history that says nothing. Raises BadInput as `learn_prior`."""
    document = learn_prior(arms, DriftSettings(), TemperatureSettings(), silent)
    document["learnt_from"]["left_out"] += silent
    return {"made_at": rfc3339(time.time()), "software": f"joint-monitor {__version__}", **document}


def priors_of_plant(address: str | Path) -> list[ModelPrior]:
    """The prior of each model, of the whole plant, and of each site that has `SITE_ARMS` arms to learn it from. In a process of its own.

    Raises StoreError, BadInput where there is no arm to learn from.
    """
    database = Database(address)
    try:
        arms, _ = arms_of_plant(database)
    finally:
        database.close()
    found = _by_model(prior_document(arms), None)
    for site in sorted({arm.name.partition("/")[0] for arm in arms}):
        own = [arm for arm in arms if arm.name.partition("/")[0] == site]
        with suppress(BadInput):  # a site may be too young to say anything; the whole plant is not
            found += [prior for prior in _by_model(prior_document(own), site) if prior.arms >= SITE_ARMS]
    return found


def _by_model(document: dict[str, Any], site: str | None) -> list[ModelPrior]:
    """One document a model; who was left out is told by `prior --plant`."""
    found = []
    for model, own in document["models"].items():
        learnt_from = {"arms": own["arms"], "joint_years": own["joint_years"]}
        text = orjson.dumps({**document, "site": site, "learnt_from": learnt_from, "models": {model: own}}).decode()
        found.append(ModelPrior(site, model, own["arms"], document["made_at"], text))
    return found


def _learnt(places: Iterable[tuple[str, Callable[[], Belief | None]]]) -> tuple[list[LearntArm], list[str]]:
    arms, silent = [], []
    for name, read in places:
        try:
            belief = read()
        except StoreUnavailable:
            raise
        except MonitorError as error:
            silent.append(f"{name}: {error}")
            continue
        if belief is None:
            silent.append(f"{name}: nothing was assessed yet")
            continue
        days = (belief.at_unix_s - belief.began_at_unix_s) / DAY_S
        arms.append(LearntArm(name, belief.robot, belief.friction, days, belief.reference_speed_rad_s))
    return arms, silent


def _histories(folders: Sequence[Path]) -> list[Path]:
    """The folders that hold a history, each once."""
    found: dict[Path, Path] = {}
    for folder in folders:
        own = [folder] if (folder / HISTORY).is_file() else sorted(path.parent for path in folder.glob(f"*/{HISTORY}"))
        if not own:
            raise BadInput(f"{folder}: holds no {HISTORY}, nor does a folder in it; expected a daemon's state folder, or one of many")
        found |= {place.resolve(): place for place in own}
    return list(found.values())
