"""Along which path friction rises: a mixture over slowing, straight and accelerating paths, fitted to the course of friction so far.

With z friction over that without wear, and s the usage since the onset of wear, each path is

    z = A + S·[a step] + C·g(s),   g(s) = s^p  or  e^(κ·s/s_now) − 1.

The shape of g, the onset and the day of the step are on a grid. For each point of it the posterior of (A, S, C) is Gaussian, since z is
linear in them; the component is weighted by its prior and by its marginal likelihood (O'Hagan, Kendall's Advanced Theory of Statistics 2B,
ch. 11; the size of the noise is integrated out). Observed are the blocks of `monitor.judge.friction.course`, corrected with the law and the
levels of today. Their noise is that of the kinds that the joint may have, with the doubt of that law and of the levels of other contexts.

Shapes: B blocks, P pairs of a shape and an onset, M components of the mixture.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from monitor.judge.friction.course import COUNT, DAYS, LAW_SUM, LEVEL_AT, USE, law_states
from monitor.judge.friction.prior import LIFE_RISE, WearPrior
from monitor.judge.friction.states import LEVEL, SETTLING, SLOPE
from monitor.judge.friction.step import FrictionModel, FrictionState
from monitor.recording import Array

POWERS = np.array([0.33, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, *[1.0] * 7])  # p of every shape
GROWTHS = np.array([*[0.0] * 7, 1.0, 1.75, 2.5, 3.5, 5.0, 7.0, 10.0])  # κ; 0 is a power. Friction rises e^κ times as fast as at the onset
SLOWING, STRAIGHT = POWERS < 1.0, (POWERS == 1.0) & (GROWTHS == 0.0)
ACCELERATING = ~(SLOWING | STRAIGHT)
# Weight of each shape within its family. A path that has hardly accelerated so far is like a straight one that began later; with even
# weights, such shapes made the date of exponential wear a quarter too late in the median, and missed a fifth to a third of such lives.
SHAPE_WEIGHTS = np.array([*[1.0] * 4, 0.25, 0.5, 0.8, 0.2, 0.6, 1.0, 1.4, 1.4, 1.3, 1.3])
# Prior of the three families, spread over their shapes. Wear that settles rises with the root of time, steady wear along a straight
# line, and towards the end of a gear's life it accelerates (the three phases of a wear curve). Before the curvature shows, the dangerous
# error is to miss the last: it has half of the weight or more.
FAMILIES, FAMILY_PRIOR = (SLOWING, STRAIGHT, ACCELERATING), (0.2, 0.14, 0.66)
LEAST_RISE_STD = 0.002  # of an expected rise, a fraction of friction: no path is known better
# Prior probability that a joint wears otherwise than its fleet, where a fleet's prior is set. With 0.4, P50 of joints of the fleet is as
# good as with 0.1, and a joint that accelerates in a fleet that does not is dated in time.
OTHERS = 0.4
ONSETS = 32  # of the grid, evenly over the history
STEPS_PER_BLOCK = 2  # days at which friction may have stepped
LIKELY_STEPS = 8  # of these, the likeliest along a straight path are tried with every path
STEP_PROBABILITY = 0.15  # prior, of a step beside the path
STEP_STD = 0.1  # prior of S, a fraction of friction …
RISE_STD = 0.3  # … of the rise C·g so far …
LEVEL_STD = 0.5  # … and of A, around 1
OTHER_LEVEL_STD = 1.0  # [log] of a level in another context than the one in force
WITHIN_STD = 0.003  # [log] of a replay, by its fit
# Prior of running-in beside wear, by `Priors.settling`. Few joints run in when they are taught, and to doubt all of them made every
# interval a third wider than the joints needed that do not.
RUNS_IN = 0.12
NOISE_BLOCKS = 20.0  # weight of the filters' noise beside the noise that the blocks show
FEWEST_BLOCKS = 8  # fewer show no path …
LEAST_DAYS = 5.0  # [usual days] … and so does less usage
KEPT = 0.995  # of the weight; the least likely components are left out
GAUSS = ((0.5 * np.sqrt(0.6), 5 / 18), (0.0, 8 / 18), (-0.5 * np.sqrt(0.6), 5 / 18))  # places in a block of width 1, and their weights


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WearPaths:
    """The mixture of one joint, (M, …) each."""

    weight: Array  # (M,) sum 1
    shape: np.ndarray  # (M,) index of POWERS and GROWTHS
    since: Array  # (M,) [usual days] of usage since the onset
    mean: Array  # (M, 3) of A, S and the rise so far C·g
    cov: Array  # (M, 3, 3)

    def reached(self, days: Array, limit_rise: float, wear_walk_per_sqrt_day: float) -> Array:
        """(D, M) probability that friction is above the limit after usual days (D,), by each component."""
        growth = path(self.shape, self.since, self.since + days[:, None]) / path(self.shape, self.since, self.since)  # (D, M)
        # the limit counts from the lowest level: that before a rise, and that after a fall
        now = np.stack([np.full_like(self.since, -limit_rise), np.where(self.mean[:, 1] < 0, -limit_rise, 1.0)], axis=1)
        above = np.sum(now * self.mean[:, :2], axis=1) + growth * self.mean[:, 2]
        fixed = np.einsum("mi,mij,mj->m", now, self.cov[:, :2, :2], now)
        shared = np.sum(now * self.cov[:, :2, 2], axis=1)
        var = fixed + 2.0 * growth * shared + growth**2 * self.cov[:, 2, 2] + (wear_walk_per_sqrt_day**2 * days)[:, None]
        reached: Array = scipy.special.ndtr(above / np.sqrt(var))
        return reached

    def rate(self) -> tuple[float, float]:
        """Mean and standard deviation of the wear rate now, a fraction of friction without wear in a usual day."""
        relative = _relative_rate(self.shape, self.since)
        each, var = relative * self.mean[:, 2], relative**2 * self.cov[:, 2, 2]
        mean = float(self.weight @ each)
        return mean, float(np.sqrt(self.weight @ (var + (each - mean) ** 2)))

    def probability(self, family: np.ndarray) -> float:
        """Probability that the path is one of a family of shapes: SLOWING, STRAIGHT or ACCELERATING."""
        return min(float(self.weight @ family[self.shape]), 1.0)  # the sum of the weights is rounded


class _Blocks(NamedTuple):
    """The course of friction of one joint, (B,) each."""

    use_age: Array  # [usual days]
    width: Array  # [usual days]
    friction: Array  # z, over the friction that the filters expect without wear
    settling: Array  # of running-in of the usual size
    cov: Array  # (B, B) of z, without running-in


def wear_paths(course: Array, state: FrictionState, n: int, model: FrictionModel, prior: WearPrior | None = None) -> WearPaths | None:
    """The mixture of channel n along its course (B, K); None while that is too short. prior : of the fleet."""
    blocks = _blocks(course, state, n, model)
    return None if blocks is None else _fit(blocks, prior)


def path(shape: np.ndarray, since: Array, s: Array) -> Array:
    """g(s) of shapes (M,) whose onset is `since` (M,) usual days ago; s : (…, M), 0 at the onset and before it."""
    s = np.maximum(s, 0.0)
    growth = GROWTHS[shape]
    g: Array = np.where(growth > 0, np.expm1(np.minimum(growth * s / since, 300.0)), s ** POWERS[shape])
    return g


def elasticity(shape: np.ndarray, since: Array, s: Array) -> Array:
    """(M,) s·g'/g at s: a life longer by one per cent asks for so many per cent less of a rise now."""
    return _elasticity(shape, GROWTHS[shape] * s / since)


def _relative_rate(shape: np.ndarray, since: Array) -> Array:
    """(M,) g'/g now, at s = `since` [1/usual day]."""
    return _elasticity(shape, GROWTHS[shape]) / since


def _elasticity(shape: np.ndarray, growth: Array) -> Array:
    """(M,) `elasticity`; growth : (M,) exponent of the paths that are exponential, 0 of the others."""
    found: Array = np.where(growth > 0, growth / -np.expm1(-np.maximum(growth, 1e-9)), POWERS[shape])
    return found


def _blocks(course: Array, state: FrictionState, n: int, model: FrictionModel) -> _Blocks | None:
    """The blocks of channel n, corrected; None where there are too few."""
    kept = course[course[:, COUNT] > 0]
    if len(kept) < FEWEST_BLOCKS:
        return None
    count = kept[:, COUNT]
    sums = kept / count[:, None]
    age, use_age, rows = state.age_days[n] - sums[:, DAYS], state.use[n] - sums[:, USE], sums[:, LAW_SUM:-1]
    if not use_age.max() >= LEAST_DAYS:
        return None
    mean, doubt = _law(state, n)
    settling = SETTLING - SLOPE
    mean[settling] = doubt[settling] = doubt[:, settling] = 0.0  # the filters have learnt it as if no path were bent
    friction = np.exp(sums[:, -1] - rows @ mean)
    interval_days = max(float(np.ptp(age)) / (count.sum() - 0.5 * (count[0] + count[-1])), 1e-3)
    V = np.diag(WITHIN_STD**2 / count) + rows @ doubt @ rows.T
    for kind, weight in zip(model.noise.kinds, state.p[:, n] * state.scale[:, n], strict=True):
        V += weight * _correlated(count, age / interval_days, kind.rho**interval_days)
        if kind.kappa > 0.0:
            apart = np.abs(age[:, None] - age)
            V += weight * kind.kappa**2 * np.exp(-apart / kind.memory_days) * np.cos(2.0 * np.pi * apart / kind.period_days)
    V *= friction[:, None] * friction
    width = np.maximum(count * interval_days * use_age[-1] / max(age[-1], 1e-9), 1e-3)
    return _Blocks(use_age, width, friction, float(np.hypot(*model.states.settling)) * rows[:, settling] * friction, V)


def _law(state: FrictionState, n: int) -> tuple[Array, Array]:
    """Mean and covariance of the states of the law, over kinds of noise. The level in force is A: nothing is unsure of it here."""
    levels = np.arange(state.x.shape[1] - LEVEL)
    mean, doubt = state.of_kinds(law_states(len(levels)), n)
    doubt[LEVEL_AT:] = doubt[:, LEVEL_AT:] = 0.0
    others = LEVEL_AT + levels[levels != state.slot[n]]
    doubt[others, others] = OTHER_LEVEL_STD**2
    return mean, doubt


def _correlated(count: Array, age: Array, rho: float) -> Array:
    """(B, B) covariance of the means of blocks of a unit AR(1) process; count, age : (B,) number of replays, mean age in replays."""
    if rho < 1e-6:
        return np.diag(1.0 / count)
    tail = (1.0 - rho**count) / (1.0 - rho)  # 1 + ρ + … of a block
    apart = np.maximum(np.abs(age[:, None] - age) - 0.5 * (count[:, None] + count), 0.0)
    K = rho ** (apart + 1.0) * tail[:, None] * tail / (count[:, None] * count)
    K[np.diag_indices(len(count))] = (count * (1.0 + rho) / (1.0 - rho) - 2.0 * rho * tail / (1.0 - rho)) / count**2
    return K


class _Expected(NamedTuple):
    """What is expected of a joint that wears, before its own course is looked at."""

    shape: Array  # (P,) log of the prior of each path
    rise: tuple[Array, Array] | None  # (P,) each, mean and standard deviation of the rise so far C·g; None: 0 and RISE_STD


def shape_prior(families: tuple[float, float, float]) -> Array:
    """The probability of each shape, from those of slowing, straight and accelerating paths."""
    of_families = zip(FAMILIES, families, strict=True)
    each: Array = np.sum(
        [probability * SHAPE_WEIGHTS * family / (SHAPE_WEIGHTS * family).sum() for family, probability in of_families], axis=0
    )
    return each


def _expected(shape: np.ndarray, since: Array, fleet: WearPrior | None) -> list[_Expected]:
    """What any joint does, and with a fleet's prior mostly what its joints do; which of the two a joint is, its own course says.

    Of a joint of the fleet the rise so far is expected that leads to LIFE_RISE at the fleet's life, so that a rise of some height also
    says how long ago the onset was.
    """
    usual = np.log(shape_prior(FAMILY_PRIOR)[shape])
    if fleet is None:
        return [_Expected(usual, None)]
    shares = shape_prior((fleet.slowing, fleet.straight, fleet.accelerating))
    life = np.full_like(since, fleet.life_days)
    rise = LIFE_RISE * path(shape, since, since) / path(shape, since, life)
    rise_std = np.maximum(rise * elasticity(shape, since, life) * fleet.life_spread, LEAST_RISE_STD)
    return [_Expected(usual + np.log(OTHERS), None), _Expected(np.log((1.0 - OTHERS) * shares[shape]), (rise, rise_std))]


def _fit(blocks: _Blocks, fleet: WearPrior | None) -> WearPaths:
    """The mixture over shapes, onsets, steps, and whether the joint runs in."""
    age, width, oldest = blocks.use_age, blocks.width, float(blocks.use_age.max())
    shape = np.repeat(np.arange(len(POWERS)), ONSETS)  # (P,)
    since: Array = np.tile(oldest * (np.arange(ONSETS) + 0.5) / ONSETS, len(POWERS))  # (P,)
    at, of = (np.array(each)[:, None, None] for each in zip(*GAUSS, strict=True))
    grown = np.sum(of * path(shape, since, since - age[:, None] - at * width[:, None]), axis=0) / path(shape, since, since)  # (B, P)
    step_age = np.interp(np.arange(STEPS_PER_BLOCK * len(age)) / STEPS_PER_BLOCK, np.arange(len(age)) + 0.5, age)
    stepped = np.clip((step_age - age[:, None]) / width[:, None] + 0.5, 0.0, 1.0)  # (B, steps) share of each block since the step
    columns = np.concatenate([np.ones((len(age), 1)), blocks.friction[:, None] - 1.0, stepped, grown], axis=1)
    parts, courses = [], _expected(shape, since, fleet)
    running_in = np.outer(blocks.settling, blocks.settling)
    for beside, probability in ((0.0, 1.0 - RUNS_IN), (running_in, RUNS_IN)):
        root = np.linalg.cholesky(blocks.cov + beside)
        white = scipy.linalg.solve_triangular(root, columns, lower=True)
        for expected in courses:
            mean, cov, evidence = _with_steps(white, stepped.shape[1], STRAIGHT[shape], expected.rise)
            parts.append((mean, cov, evidence + expected.shape + np.log(probability) - np.sum(np.log(np.diag(root)))))
    mean, cov, evidence = (np.concatenate(each) for each in zip(*parts, strict=True))  # (5·K, P, …)
    order = np.argsort(evidence, axis=None)[::-1]
    weight = np.exp(evidence.ravel()[order] - evidence.max())
    likely = order[: np.searchsorted(np.cumsum(weight) / weight.sum(), KEPT) + 1]
    weight = weight[: len(likely)] / weight[: len(likely)].sum()
    k, m = np.unravel_index(likely, evidence.shape)
    centre = mean[k, m]
    centre[:, 0] += 1.0
    return WearPaths(weight=weight, shape=shape[m], since=since[m], mean=centre, cov=cov[k, m])


def _with_steps(white: Array, steps: int, straight: np.ndarray, rise: tuple[Array, Array] | None) -> tuple[Array, Array, Array]:
    """`_regressions` without a step and with each of the likeliest; white : (B, 2 + steps + P) columns 1, z, steps and paths, whitened."""
    one, z, of_steps, paths = white[:, 0], white[:, 1], white[:, 2 : 2 + steps], white[:, 2 + steps :]
    each = _regressions(one, z, of_steps, paths[:, straight], None)[2].max(axis=1)
    likely = np.argsort(each)[-LIKELY_STEPS:]
    without = _regressions(one, z, np.zeros((len(z), 1)), paths, rise)
    without[1][..., 1, :] = without[1][..., :, 1] = 0.0
    with_step = _regressions(one, z, of_steps[:, likely], paths, rise)
    odds = np.log(STEP_PROBABILITY / steps)
    return (
        np.concatenate([without[0], with_step[0]]),
        np.concatenate([without[1], with_step[1]]),
        np.concatenate([without[2] + np.log(1.0 - STEP_PROBABILITY), with_step[2] + odds]),
    )


def _regressions(one: Array, z: Array, steps: Array, paths: Array, rise: tuple[Array, Array] | None) -> tuple[Array, Array, Array]:
    """Mean, covariance and log evidence of (A − 1, S, C·g) for each step with each path: (K, P, …).

    one, z, steps, paths : (B,), (B,), (B, K), (B, P) columns and observation, whitened with the filters' noise. rise : as in `_Expected`.
    """
    K, P = steps.shape[1], paths.shape[1]
    X, b = np.zeros((K, P, 3, 3)), np.zeros((K, P, 3))  # the information and what it points to
    X[:] = np.diag(np.array([LEVEL_STD, STEP_STD, RISE_STD]) ** -2.0)
    X[..., 0, 0] += one @ one
    X[..., 0, 1] = X[..., 1, 0] = (one @ steps)[:, None]
    X[..., 1, 1] += np.sum(steps**2, axis=0)[:, None]
    X[..., 0, 2] = X[..., 2, 0] = one @ paths
    X[..., 1, 2] = X[..., 2, 1] = steps.T @ paths
    X[..., 2, 2] += np.sum(paths**2, axis=0)
    b[..., 0], b[..., 1], b[..., 2] = one @ z, (steps.T @ z)[:, None], z @ paths
    rest, usual = NOISE_BLOCKS + z @ z, np.zeros(P)
    if rise is not None:  # completing the square about the expected rise
        rise_mean, rise_std = rise
        away = rise_mean / rise_std
        X[..., 2, 2] += rise_std**-2.0 - RISE_STD**-2.0
        b[..., 2] += away / rise_std
        rest, usual = rest + away**2, np.log(rise_std / RISE_STD) + scipy.special.log_ndtr(away) - np.log(0.5)
    cov = np.asarray(np.linalg.inv(X), dtype=float)
    mean: Array = np.einsum("kpi,kpij->kpj", b, cov)
    rest = rest - np.sum(b * mean, axis=2)
    dof = NOISE_BLOCKS + len(z)
    evidence: Array = 0.5 * np.linalg.slogdet(cov)[1] - np.log(STEP_STD) - 0.5 * dof * np.log(rest) - usual
    cov *= (rest / (dof - 2.0))[..., None, None]  # variance of Student's t
    evidence += scipy.special.log_ndtr(mean[..., 2] / np.sqrt(cov[..., 2, 2]))  # friction rises along a path
    return mean, cov, evidence
