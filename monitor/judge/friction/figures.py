"""What is read off a state, of the joints of all arms in turn, (N,) each: what was found, what temperature does, what is unseen.

Of what was found, the mixture is that over kinds of noise alone: a change that was not found is no part of it. What a person reads
beside it is `change_with_unfound`, in which joints may have changed and nobody has noticed yet.
"""

from typing import NamedTuple

import numpy as np
import scipy

from monitor.judge.friction.changes import STEP
from monitor.judge.friction.posterior import over_kinds
from monitor.judge.friction.states import CUBE, CURVE, LAG, LEVEL, RATE, SLOPE, VOGEL_C, WEAR, row, saturating, viscous_distance
from monitor.judge.friction.step import FrictionModel, FrictionState
from monitor.recording import Array

FRESH_DAYS = 10.0  # a step of so many days ago is what `unseen_step` is about: replays since say something of it, and not yet enough
NOTHING_KNOWN = 1.0  # [log] where even a larger step may be unseen, the level itself is not known yet
NINE_OF_TEN = 1.28  # standard deviations by which a step passes the threshold in nine of ten …
DOUBTED = 1.3  # … if noise were known and had no outliers; as it is, so many times the step is found in nine of ten, by simulation
LEAST_VAR = 1e-12


class WearAndRate(NamedTuple):
    """What was found of wear [log] and its rate [1/usual day]."""

    mean: Array  # (N, 2)
    cov: Array  # (N, 2, 2)


class UnseenStep(NamedTuple):
    """The largest step that may still be unseen some days after it came, (N,) each; NaN where nothing is known of so short a time."""

    log_rise: Array  # a larger one is found by then in nine of ten
    days: Array  # since the step


def found_wear(state: FrictionState) -> tuple[Array, Array]:
    """Mean and standard deviation of wear [log] over the level that it counts from."""
    mean, var = (state.of_joints(each) for each in over_kinds(state.p, state.x[:, WEAR], state.P[:, WEAR, WEAR]))
    return mean, np.sqrt(var)


def wear_above(state: FrictionState, rises: Array) -> Array:
    """(N, R) probability that the wear that was found is above each of the rises (R,) [log]."""
    x, P, p = (state.of_joints(each)[..., None] for each in (state.x[:, WEAR], state.P[:, WEAR, WEAR], state.p))
    probability: Array = (p * scipy.special.ndtr((x - rises) / np.sqrt(np.maximum(P, LEAST_VAR)))).sum(axis=0)
    return probability


def wear_and_rate(state: FrictionState) -> WearAndRate:
    """Wear and its rate, as found."""
    pair = [WEAR, RATE]
    x, P, p = state.of_joints(state.x[:, pair]), state.of_joints(state.P[:, pair][:, :, pair]), state.of_joints(state.p)
    mean = np.einsum("hn,hin->in", p, x)
    off = x - mean
    cov = np.einsum("hn,hijn->nij", p, P + off[:, :, None] * off[:, None])
    return WearAndRate(mean.T, cov)


def change_found(state: FrictionState) -> Array:
    """(N,) log of friction over that at the beginning, as found: wear, and what was moved out of it since."""
    change: Array = found_wear(state)[0] + state.of_joints(state.moved)
    return change


def change_with_unfound(state: FrictionState, model: FrictionModel) -> tuple[Array, Array]:
    """Mean and standard deviation of friction over that at the beginning [log], changes that were not found included."""
    mean, var = (state.of_joints(each) for each in state.wear(model).moments())
    return mean + state.of_joints(state.moved), np.sqrt(var + state.of_joints(state.moved_var))


def fallen(state: FrictionState) -> tuple[Array, Array]:
    """Mean and standard deviation of friction over that at the beginning [log], as found; running-in is a state of its own."""
    wear, std = found_wear(state)
    return wear + state.of_joints(state.moved), np.sqrt(std**2 + state.of_joints(state.moved_var))


def slope_per_k(state: FrictionState, temperature_c: Array) -> Array:
    """(N,) −∂log F/∂T [1/K] at temperatures (N,)."""
    origin = state.of_joints(state.origin_c)
    away = temperature_c - origin
    t = viscous_distance(temperature_c, origin)
    b, c, d = ((state.of_joints(state.p * state.x[:, k])).sum(axis=0) for k in (SLOPE, CURVE, CUBE))
    slope: Array = -(b + 2.0 * c * t + 3.0 * d * t**2) / (1.0 + away / (origin + VOGEL_C)) ** 2
    return slope


def expected_row(
    state: FrictionState, temperature_c: Array, warming_k_per_min: Array, model: FrictionModel, slot: Array | None = None
) -> Array:
    """(D, C) H of an observation of all channels at temperatures and warming rates of the joints (N,), noise between replays left out.

    slot : (N,) of contexts; None: those in force.
    """
    J = state.joints_per_arm

    def channels(joints: Array) -> Array:
        of_all = np.zeros((len(joints) // J, J + 1))
        of_all[:, :J] = joints.reshape(-1, J)
        return of_all.ravel()

    t = channels(viscous_distance(temperature_c, state.of_joints(state.origin_c)))
    places = state.slot if slot is None else channels(slot).astype(int)
    levels = state.x.shape[1] - LEVEL
    return row(t, channels(warming_k_per_min), state.age_days, places, levels, model.states, noise=0.0)


def expected(state: FrictionState, H: Array) -> tuple[Array, Array]:
    """Mean and variance of H·x as found, H (D, C) of `expected_row`."""
    mean = np.einsum("hdn,dn->hn", state.x, H)
    var = np.einsum("hijn,in,jn->hn", state.P, H, H)
    of_all = over_kinds(state.p, mean, var)
    return state.of_joints(of_all[0]), state.of_joints(of_all[1])


def level_in_force(state: FrictionState) -> Array:
    """(N,) level of the context in force at the origin, without wear [log]."""
    levels = state.x[:, LEVEL + state.slot, np.arange(len(state.slot))]
    level: Array = state.of_joints((state.p * levels).sum(axis=0))
    return level


def noise_var(state: FrictionState, model: FrictionModel) -> Array:
    """(N,) variance of log F between replays: of fast and slow noise of each kind, by how probable it is."""
    kappa = model.noise.column("kappa")
    var: Array = state.of_joints((state.p * state.scale * (1.0 + kappa**2)).sum(axis=0))
    return var


def uneven_std(state: FrictionState, warming_k_per_min: Array, model: FrictionModel) -> Array:
    """(N,) what of the lag's effect differs from replay to replay [log]; warming_k_per_min : (N,)."""
    lag = state.of_joints((state.p * state.x[:, LAG]).sum(axis=0))
    std: Array = model.states.uneven * np.abs(lag * saturating(warming_k_per_min))
    return std


def missed_var(state: FrictionState) -> Array:
    """(N,) variance of log F that an unknown temperature leaves in one replay."""
    x, P, p, usual = (state.of_joints(each) for each in (state.x[:, SLOPE], state.P[:, SLOPE, SLOPE], state.p, state.usual_c[:, 1]))
    var: Array = (p * (x**2 + P)).sum(axis=0) * usual
    return var


def suspected_rise(state: FrictionState, model: FrictionModel) -> np.ndarray:
    """(N,) whether a rise that was not found is likely enough to ask for a replay, which sound arms do `suspicions_per_year` times."""
    asked = model.decision.suspicious(state.joints_per_arm)
    suspected: np.ndarray = state.of_joints((state.odds[0] >= asked) & ~state.risen)
    return suspected


def unseen_step(state: FrictionState, model: FrictionModel) -> UnseenStep:
    """Which step some ten days ago would by now have been found in nine of ten; what replays told of its size decides, by kind of noise."""
    bank, n = state.bank, np.arange(len(state.replays))
    ago = np.where(bank.born[:, None] >= 0, state.age_days - bank.born_days, np.inf)  # (C, N)
    ago = np.where(bank.I[:, :, STEP].any(axis=0), ago, np.inf)
    old_enough = np.where(ago >= FRESH_DAYS - 1.0, ago, np.inf)
    c = np.argmin(old_enough, axis=0)
    days = old_enough[c, n]
    V = model.changes.variances[0, 0]
    information = bank.I[:, c, STEP, n]  # (H, N)
    precision = information + 1.0 / V
    counted = ~state.risen.reshape(-1, state.joints_per_arm + 1)[:, : state.joints_per_arm]
    needed = model.decision.needed(state.peaks, counted, state.joints_per_arm, state.age_days)[0]
    # R of a step of size s is about days·share·LR(s·I), over the days since it came
    least = np.log(needed / (np.where(np.isfinite(days), np.maximum(days, 1.0), 1.0) * model.changes.shares[0]))
    asked = np.sqrt(2.0 * np.maximum(least + 0.5 * np.log(V * precision), 0.0) * precision)
    size = (asked + NINE_OF_TEN * np.sqrt(information)) / np.maximum(information, LEAST_VAR)
    log_rise = DOUBTED * (state.p * size).sum(axis=0)
    known = np.isfinite(days) & (log_rise <= NOTHING_KNOWN)
    return UnseenStep(
        state.of_joints(np.where(known, log_rise, np.nan)), state.of_joints(np.where(known, np.where(known, days, 0.0), np.nan))
    )
