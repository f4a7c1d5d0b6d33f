"""One replay's step of the model, over the joints of any number of arms: how one arm is judged, and how you judge a fleet of your own.

Shapes: A arms, J joints per arm, N = A·(J+1) channels: the joints of an arm, then their mean, arm by arm.
"""

from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np
import scipy

from monitor.judge.friction.changes import Bank, ChangePriors, absorb
from monitor.judge.friction.course import (
    LAW_SUM,
    LEVEL_AT,
    empty_course,
    forget_course,
    move_course,
    remember,
    rescale_course,
    settle_level,
)
from monitor.judge.friction.decision import Crossing, DecisionSettings, crossings, odds
from monitor.judge.friction.found import Found, nothing_found, remember_found
from monitor.judge.friction.kalman import update_kinds
from monitor.judge.friction.noise import NoisePriors, first_scale, follow_scale, pass_time, prior_by_arm, probabilities
from monitor.judge.friction.observation import VISCOUS_SHARE, Observation
from monitor.judge.friction.posterior import Mixture, mixture, over_kinds
from monitor.judge.friction.states import (
    LAG,
    LEVEL,
    NOISE,
    RATE,
    SLOPE,
    SLOW,
    SLOW_TURN,
    VOGEL_C,
    WEAR,
    Priors,
    grow,
    prior_of_states,
    row,
    saturating,
    viscous_distance,
)
from monitor.recording import Array

UNKNOWN_C = 25.0  # origin where no temperature was ever measured
LEAST_VARIANCE = 1e-8  # [log²] no fit is surer than 0.01 %
SETTLE_REPLAYS = 20  # of which the reference temperature is the mean
FALL_KNOWN_STD, FALL_KNOWN_DAYS = 0.01, 30.0  # [log], [days]: a fall of which so much is known, or so long ago, is of the level
CONSISTENT_REPLAYS = 20.0  # memory of whether noise is as it is believed


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionModel:
    """Every number of the model: priors, and the operating point."""

    states: Priors = field(default_factory=Priors)
    noise: NoisePriors = field(default_factory=NoisePriors)
    changes: ChangePriors = field(default_factory=ChangePriors)
    decision: DecisionSettings = field(default_factory=DecisionSettings)
    keeps_course: bool = True  # from which the path of wear is fitted
    by_filterpy: bool = True  # whether one arm goes through filterpy, and not through the same algebra on arrays
    onsets_per_year: float = 10.0  # of changes of a joint that were not found: the prior of the posterior, not of the decision


@dataclass(slots=True, kw_only=True, eq=False)
class FrictionState:
    """What the step carries from one replay to the next."""

    joints_per_arm: int
    x: Array  # (H, D, N) means of the states
    P: Array  # (H, D, D, N) their covariance
    bank: Bank
    scale: Array  # (H, N) σ²
    log_evidence: Array  # (H, N) log E
    p: Array  # (H, N) probability of each kind of noise
    number: int  # of the next replay
    replays: Array  # (N,) that the channel has learnt from
    informed: Array  # (H, N) how many of them told σ
    age_days: Array  # (N,) since the channel began
    use: Array  # (N,) usual days since it began
    slot: np.ndarray  # (N,) of the context
    known: np.ndarray  # (N, levels) contexts whose level was learnt
    of_production: bool  # whether the last of the levels is that of production
    origin_c: Array  # (N,) that t counts from; of means 0
    centre: Array  # (N,) first y of each joint, which the mean counts from; of means 0
    usual_c: Array  # (N, 2) mean and variance of t
    blind: Array  # (N,) replays in a row of which nobody measured the joint's temperature
    usual_warming: Array  # (N,) mean |h(Ṫ)|
    reference_c: Array  # (N,) T0
    odds: Array  # (2, N) R
    peaks: Array  # (2, N) highest R so far, that decays; 0 where that was found to be new grease [days]
    unchanged: Array  # (H, N) probability that nothing changed, by kind of noise: what changed is not noise
    risen: np.ndarray  # (N,) whether a rise is told, of a joint or of the mean of an arm
    fell: np.ndarray  # (N,) whose fall was told
    shared: Array  # (N,) log of what each joint changed when most of its arm changed together
    moved: Array  # (N,) log of what was moved out of wear into the level, since the beginning …
    moved_var: Array  # … and its variance
    held_days: Array  # (N,) since then; NaN: wear counts from the beginning
    innovation: Array  # (N,) of the last observation [log]; NaN: it did not show the channel
    normalised: Array  # … over its standard deviation
    consistency: Array  # (N,) mean ψ² over the last replays, of what is no change: 1 where noise is as it is believed
    production_var: Array  # (N,) σ² of observations from production, which have a level of their own: the last one
    periods: Array  # (N,) of production that the channel has learnt from
    unconfirmed: np.ndarray  # (N,) whose rise production alone has found
    found: Found  # of each channel's last change that was found
    course: Array  # (N, B, K) of replays since wear counts, see `course`
    told: Crossing

    @property
    def joints(self) -> np.ndarray:
        """(N,) whether a channel is a joint, and not the mean of an arm."""
        is_joint: np.ndarray = np.arange(len(self.replays)) % (self.joints_per_arm + 1) < self.joints_per_arm
        return is_joint

    def of_joints(self, channels: Array) -> Array:
        """(…, A·J) the joints of channels (…, N)."""
        J = self.joints_per_arm
        joints: Array = channels.reshape(*channels.shape[:-1], -1, J + 1)[..., :J].reshape(*channels.shape[:-1], -1)
        return joints

    def of_arms(self, channels: Array) -> Array:
        """(…, A) the means of the arms' joints, of channels (…, N)."""
        means: Array = channels.reshape(*channels.shape[:-1], -1, self.joints_per_arm + 1)[..., -1]
        return means

    def channels_of(self, joints: np.ndarray) -> np.ndarray:
        """Numbers of the channels of the joints in a mask (A·J,)."""
        n = np.flatnonzero(joints)
        numbers: np.ndarray = n + n // self.joints_per_arm
        return numbers

    def of(self, weights: Array, model: FrictionModel) -> Mixture:
        """What is believed of weights·states, weights (D, N)."""
        return mixture(weights, self.x, self.P, self.p, self.bank, self.replays, model.changes, model.onsets_per_year)

    def wear(self, model: FrictionModel) -> Mixture:
        """Wear of each channel [log], changes that were not told included."""
        return self.of(self._unit(WEAR), model)

    def of_kinds(self, states: np.ndarray, n: int) -> tuple[Array, Array]:
        """Mean (M,) and covariance (M, M) of states (M,) of channel n over kinds of noise, as far as changes were found."""
        p, x, P = self.p[:, n], self.x[:, states, n], self.P[:, states[:, None], states, n]
        mean = p @ x
        return mean, np.einsum("h,hij->ij", p, P) + np.einsum("h,hi,hj->ij", p, x - mean, x - mean)

    def friction(self, temperature_c: Array, model: FrictionModel) -> Mixture:
        """Log F of each channel at a temperature (N,), in the steady state, without noise between replays."""
        t = np.where(self.joints, viscous_distance(temperature_c, self.origin_c), temperature_c)
        levels = self.x.shape[1] - LEVEL
        H = row(t, np.zeros(len(t)), self.age_days, self.slot, levels, model.states, noise=0.0)
        without = H.copy()
        without[SLOW] = 0.0
        each = self.of(H, model), self.of(without, model)
        weight, mean, var = (np.stack([getattr(one, name) for one in each]) for name in ("weight", "mean", "var"))
        kinds = model.noise.column("of_friction")
        slow = np.concatenate([kinds, np.repeat(kinds, len(weight[0]) // len(kinds) - 1, axis=0)])  # as `mixture` puts its components
        weight = weight * np.stack([slow, 1.0 - slow])
        steady = (self.p * self.x[:, LAG]).sum(axis=0) * self.usual_warming  # that far the steady state is extrapolated
        var = var + (model.states.extrapolated * steady) ** 2
        return Mixture(**{name: part.reshape(-1, len(t)) for name, part in (("weight", weight), ("mean", mean), ("var", var))})

    def _unit(self, state: int) -> Array:
        weights = np.zeros(self.x.shape[1:])
        weights[state] = 1.0
        return weights


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """A replay of every channel, (N,) each; those that it does not show are NaN."""

    y: Array
    variance: Array
    t: Array
    warming: Array

    @property
    def shown(self) -> np.ndarray:
        """(N,) whether the replay shows the channel."""
        return np.isfinite(self.y)


def initial_state(observation: Observation, joints_per_arm: int, model: FrictionModel, levels: int = 1) -> FrictionState:
    """The state before the first replay; only origins and viscous shares come from it. levels : of contexts; `step` makes room for more."""
    J, H = joints_per_arm, len(model.noise.kinds)
    A = len(observation.log_torque) // J
    N = A * (J + 1)
    T = observation.temperature_c.reshape(A, J)
    origin = _beside(np.where(np.isfinite(T), T, UNKNOWN_C), np.zeros((A, 1)))
    D = LEVEL + levels
    state = FrictionState(
        joints_per_arm=J,
        x=np.zeros((H, D, N)),
        P=np.zeros((H, D, D, N)),
        bank=Bank.empty(H, N, D, model.changes),
        scale=np.zeros((H, N)),
        log_evidence=np.zeros((H, N)),
        p=np.repeat(model.noise.column("weight") / model.noise.column("weight").sum(), N, axis=1),
        number=0,
        replays=np.zeros(N),
        informed=np.zeros((H, N)),
        age_days=np.zeros(N),
        use=np.zeros(N),
        slot=np.zeros(N, dtype=int),
        known=np.zeros((N, levels), dtype=bool),
        of_production=False,
        origin_c=origin,
        centre=np.full(N, np.nan),
        usual_c=np.stack([np.zeros(N), np.full(N, model.states.unknown_temperature_k**2)], axis=1),
        blind=np.zeros(N),
        usual_warming=np.zeros(N),
        reference_c=origin.copy(),
        odds=np.zeros((2, N)),
        peaks=np.zeros((2, N)),
        unchanged=np.ones((H, N)),
        risen=np.zeros(N, dtype=bool),
        fell=np.zeros(N, dtype=bool),
        shared=np.zeros(N),
        moved=np.zeros(N),
        moved_var=np.zeros(N),
        held_days=np.full(N, np.nan),
        innovation=np.full(N, np.nan),
        normalised=np.full(N, np.nan),
        consistency=np.ones(N),
        production_var=np.full(N, model.states.production_std**2),
        periods=np.zeros(N),
        unconfirmed=np.zeros(N, dtype=bool),
        found=nothing_found(N),
        course=empty_course(N, levels if model.keeps_course else None),
        told=Crossing(np.zeros(N, dtype=bool), np.zeros(N, dtype=bool), np.zeros((2, A), dtype=bool)),
    )
    share = np.where(np.isfinite(observation.viscous_share), observation.viscous_share, VISCOUS_SHARE).reshape(A, J)
    begin(state, np.ones(N, dtype=bool), _beside(share, share.mean(axis=1, keepdims=True)), model)
    return state


def begin(state: FrictionState, new: np.ndarray, share: Array, model: FrictionModel) -> None:
    """Channels `new` (N,) of which nothing is known, in place. share : (N,) viscous share."""
    n = np.flatnonzero(new)
    levels = state.x.shape[1] - LEVEL
    x, P = prior_of_states(np.zeros(n.size), share[n], levels, model.states)
    alike = np.where(state.joints, 1, state.joints_per_arm)
    state.scale[:, n] = first_scale(alike, model.noise)[:, n]
    state.x[..., n], state.P[..., n] = x, P
    state.P[:, NOISE, NOISE, n] = state.scale[:, n]
    slow = model.noise.column("kappa") ** 2 * state.scale[:, n]
    state.P[:, SLOW, SLOW, n] = state.P[:, SLOW_TURN, SLOW_TURN, n] = slow
    state.found.odds[n] = 0.0
    for each in (state.replays, state.blind, state.periods, state.age_days, state.use, state.moved, state.moved_var, state.shared):
        each[n] = 0.0
    state.held_days[n], state.consistency[n] = np.nan, 1.0
    state.log_evidence[:, n] = state.informed[:, n] = 0.0
    state.known[n] = state.risen[n] = state.fell[n] = state.unconfirmed[n] = False
    state.production_var[n] = model.states.production_std**2
    state.centre[n] = np.nan
    state.peaks[:, n] = 0.0
    state.bank.forget(n)
    state.course = forget_course(state.course, n)


def step(
    state: FrictionState,
    observation: Observation,
    days: Array,
    model: FrictionModel,
    *,
    replayed: np.ndarray | None = None,
    slot: np.ndarray | None = None,
    opened: np.ndarray | None = None,
    replaced: np.ndarray | None = None,
    awaiting_proof: np.ndarray | None = None,
    withheld: np.ndarray | None = None,
    use: Array | None = None,
    production: bool = False,
    in_place: bool = False,
) -> FrictionState:
    """One replay of every arm: the state after it. `told` says whose change was found, `odds` how far R is from the threshold.

    observation : (A·J,) each. days : (A,) since an arm's last replay. replayed, opened, withheld : (A,) arms that replayed; in a context
    whose level is unknown; of whose replay nothing is learnt. slot : (A,) of contexts. replaced : (A·J,) joints. awaiting_proof : (A·J,)
    joints of which nothing is told, see `may_have_moved`. use : (A·J,) usual days.
    production : it is no replay, but what normal work tells: of a level of its own, the last of `levels`, and of noise of its own; `opened`
    is of that level. It finds rises of single joints alone. in_place : the state given is used up, which saves a fleet the copy.
    Raises ValueError where days are negative or unknown.

    Judging a fleet of your own, here three arms of which joint 2 of arm 2 steps by 20 % on day 40:

    >>> import numpy as np
    >>> from monitor.judge.friction.observation import Observation
    >>> from monitor.judge.friction.step import FrictionModel, initial_state, step
    >>> model, rng = FrictionModel(), np.random.default_rng(1)
    >>> A, J, state = 3, 6, None
    >>> for day in range(50):
    ...     torque = 10.0 * np.exp(0.02 * rng.normal(size=A * J))  # friction torque at the reference speed [N·m]
    ...     torque[J + 1] *= 1.2 if day >= 40 else 1.0
    ...     observation = Observation(
    ...         log_torque=np.log(torque),
    ...         variance=np.full(A * J, 0.005**2),  # of log_torque, from the fit of the replay
    ...         temperature_c=30.0 + rng.normal(size=A * J),
    ...         viscous_share=np.full(A * J, 0.4),
    ...         warming_k_per_min=np.zeros(A * J),
    ...         coulomb_nm=0.6 * torque,
    ...         viscous_nm_s_per_rad=torque,
    ...     )
    ...     if state is None:
    ...         state = initial_state(observation, J, model)
    ...     state = step(state, observation, np.full(A, float(day > 0)), model)
    >>> state.risen.reshape(A, J + 1)[:, :J].nonzero()
    (array([1]), array([1]))
    >>> wear, var = state.wear(model).moments()  # of the channels: six joints and their mean, arm by arm
    >>> bool(abs(wear[J + 1 + 1] - np.log(1.2)) < 3.0 * np.sqrt(var[J + 1 + 1]))
    True
    """
    wrong = np.flatnonzero((np.ones(len(days), dtype=bool) if replayed is None else replayed) & ~(days >= 0.0))
    if wrong.size:
        raise ValueError(f"days since the last replay of arm {wrong[0]} of {len(days)}: {days[wrong[0]]}; expected 0 or more")
    state = state if in_place else deepcopy(state)
    J = state.joints_per_arm
    A = len(days)
    here = np.ones(A, dtype=bool) if replayed is None else replayed
    _make_room(state, 1 if slot is None else 1 + int(np.max(slot)), production, model)
    of_replays = state.slot
    if production:
        state.slot = np.full(len(of_replays), state.x.shape[1] - LEVEL - 1)
    elif slot is not None:
        state.slot = np.repeat(np.where(here, slot, state.slot[:: J + 1]), J + 1)
    if replaced is not None and replaced.any():
        share = np.full((A, J), VISCOUS_SHARE)
        begin(state, _beside(replaced.reshape(A, J), np.zeros((A, 1), dtype=bool)), _beside(share, share[:, :1]), model)
        unsettle_means(state, state.channels_of(replaced), model)
    if opened is not None and (opened & here).any():
        n = np.flatnonzero(np.repeat(opened & here, J + 1))
        if not production:
            state.course = settle_level(state.course, n, state.slot[n], (state.p[:, n] * state.x[:, LEVEL + state.slot[n], n]).sum(axis=0))
        new_level(state, n, model.states.context_std**2)
    shown = here if withheld is None else here & ~withheld
    elapsed = np.repeat(np.where(here, days, 0.0), J + 1)
    usual = elapsed if use is None else _beside(use.reshape(A, J), use.reshape(A, J).mean(axis=1, keepdims=True))
    _age(state, elapsed, np.where(elapsed > 0, usual, 0.0), model)
    seen = _seen(state, observation, shown)
    if not production:
        _remember(state, seen)
    _learn(state, seen, model, production)
    waiting = np.zeros(A * J, dtype=bool) if awaiting_proof is None else awaiting_proof
    _judge(state, seen, model, production, _beside(waiting.reshape(A, J), np.zeros((A, 1), dtype=bool)))
    if production:
        state.slot = of_replays
    return state


def new_level(state: FrictionState, n: np.ndarray, var: float) -> None:
    """Channels n (numbers) whose level in the context in force differs from now on by an unknown amount that is no wear, in place."""
    at = LEVEL + state.slot[n]
    state.P[:, at, at, n] += var
    state.bank.forget(n)


def _make_room(state: FrictionState, levels: int, production: bool, model: FrictionModel) -> None:
    """Levels for so many contexts, and after them one of production, where there are fewer; in place."""
    have = state.x.shape[1] - LEVEL - state.of_production
    places = [LEVEL + have] * max(levels - have, 0) + [state.x.shape[1]] * (production and not state.of_production)
    if not places:
        return
    state.x = np.insert(state.x, places, 0.0, axis=1)
    state.P = np.insert(np.insert(state.P, places, 0.0, axis=1), places, 0.0, axis=2)
    state.bank.B = np.insert(state.bank.B, places, 0.0, axis=1)
    state.course = np.insert(state.course, [LAW_SUM + LEVEL_AT + place - LEVEL for place in places], 0.0, axis=2)
    state.known = np.insert(state.known, [place - LEVEL for place in places], False, axis=1)
    state.of_production |= production
    new = np.flatnonzero(state.P[0, :, :, 0].any(axis=1) == 0)
    new = new[new >= LEVEL]
    state.P[:, new, new] = model.states.level_std**2


def _age(state: FrictionState, days: Array, use: Array, model: FrictionModel) -> None:
    state.age_days += days
    state.found.ago_days += days
    state.held_days += days
    state.peaks *= np.exp(-days / model.decision.forgotten_days)
    state.use += use
    grow(state.x, state.P, state.bank.B, use)
    at, n = LEVEL + state.slot, np.arange(len(days))
    state.P[:, at, at, n] += model.states.level_walk**2 * days
    state.P[:, -1, -1] += model.states.production_walk**2 * np.where(state.periods > 0, days, 0.0)  # else it is a context's level
    pass_time(state.x, state.P, state.bank.B, state.scale, days, model.noise)
    state.bank.add(state.number, np.where(state.number == 0, 1.0, days), state.use, state.age_days)
    state.number += 1


def _seen(state: FrictionState, observation: Observation, shown: np.ndarray) -> Seen:
    """The replay by channels. An unknown temperature is the usual one, and less sure.

    It stays what it is for days: the nth such replay in a row counts with n times the standard deviation, so that all together say no more
    than two independent ones (Σ 1/n² = 1.6).
    """
    J = state.joints_per_arm
    A = len(shown)
    y = np.where(shown[:, None], observation.log_torque.reshape(A, J), np.nan)
    of_joint = {name: getattr(state, name).reshape(A, J + 1, -1)[:, :J] for name in ("origin_c", "centre", "usual_c", "risen", "blind")}
    T = observation.temperature_c.reshape(A, J)
    t = viscous_distance(T, of_joint["origin_c"][..., 0])
    p = state.p.reshape(len(state.p), A, J + 1)[:, :, :J]
    slope = (p * state.x[:, SLOPE].reshape(len(p), A, J + 1)[..., :J]).sum(axis=0)
    unknown = ~np.isfinite(t)
    t = np.where(unknown, of_joint["usual_c"][..., 0], t)
    blind = np.where(np.isfinite(y), np.where(unknown, of_joint["blind"][..., 0] + 1.0, 0.0), of_joint["blind"][..., 0])
    state.blind.reshape(A, J + 1)[:, :J] = blind
    var = observation.variance.reshape(A, J) + np.where(unknown, blind**2 * slope**2 * of_joint["usual_c"][..., 1], 0.0)
    warming = np.nan_to_num(observation.warming_k_per_min.reshape(A, J))
    first = ~np.isfinite(of_joint["centre"][..., 0]) & np.isfinite(y)
    state.centre.reshape(A, J + 1)[:, :J][first] = y[first]
    centre = state.centre.reshape(A, J + 1)[:, :J]
    w = np.isfinite(y) & ~of_joint["risen"][..., 0]
    w = w / np.maximum(w.sum(axis=1, keepdims=True), 1)
    absent = w.sum(axis=1, keepdims=True) == 0.0

    def mean(v: Array, power: int = 1) -> Array:
        value: Array = np.where(w > 0, np.nan_to_num(v) * w**power, 0.0).sum(axis=1, keepdims=True)
        return value

    return Seen(
        y=_beside(y, np.where(absent, np.nan, mean(y - centre))),
        variance=_beside(np.where(np.isfinite(var), var, 1.0), mean(var, 2)),
        t=_beside(t, mean(t)),
        warming=_beside(warming, mean(warming)),
    )


def _remember(state: FrictionState, seen: Seen) -> None:
    """The usual temperature of each channel, and the reference."""
    share = 1.0 / np.minimum(state.replays + 2.0, 100.0)
    off = np.where(seen.shown, seen.t - state.usual_c[:, 0], 0.0)
    state.usual_c[:, 0] += share * off
    state.usual_warming += np.where(seen.shown, share * (np.abs(saturating(seen.warming)) - state.usual_warming), 0.0)
    state.usual_c[:, 1] += np.where(seen.shown, share * (off**2 - state.usual_c[:, 1]), 0.0)
    settling = seen.shown & (state.replays < SETTLE_REPLAYS)
    T = np.where(state.joints, state.origin_c + seen.t / (1.0 - seen.t / (state.origin_c + VOGEL_C)), seen.t)
    state.reference_c += np.where(settling, (T - state.reference_c) / (state.replays + 1.0), 0.0)


def _learn(state: FrictionState, seen: Seen, model: FrictionModel, production: bool) -> None:
    """Every kind of noise learns from the replay for itself, as if nothing changed, and the candidates see what that leaves; in place."""
    x, P, shown = state.x, state.P, seen.shown
    levels = x.shape[1] - LEVEL
    new = np.flatnonzero(shown & ~state.known[np.arange(len(shown)), state.slot])
    at = LEVEL + state.slot[new]
    x[:, at, new] = np.where(state.replays[new] == 0, seen.y[new], x[:, at, new])
    state.known[new, state.slot[new]] = True
    H = row(seen.t, seen.warming, state.age_days, state.slot, levels, model.states, noise=float(not production))
    lag = H[LAG] * (state.p * x[:, LAG]).sum(axis=0)
    var = np.maximum(seen.variance, LEAST_VARIANCE) + (model.states.uneven * lag) ** 2
    of_production = model.states.production_lasts * state.production_var if production else np.zeros_like(var)
    var += of_production
    Ph = np.einsum("hijn,jn->hin", P, H)
    S = np.einsum("hin,in->hn", Ph, H) + var
    noise = of_production + np.zeros_like(S) if production else P[:, NOISE, NOISE].copy()
    e = np.where(shown, seen.y, 0.0) - np.einsum("hin,in->hn", x, H)
    root = np.sqrt(S)
    z = e / root
    state.innovation, state.normalised = (np.where(shown, (state.p * each).sum(axis=0), np.nan) for each in (e, z))
    w = model.noise.clip / np.maximum(np.abs(z), model.noise.clip)  # Huber's weight
    psi = w * z * shown
    state.log_evidence += np.where(shown, -np.log(root) - 0.5 * psi**2, 0.0)
    state.log_evidence -= state.log_evidence.max(axis=0)
    K = Ph / S[:, None] * shown
    if not production:
        clipped = seen.y - (state.p * (e - psi * root)).sum(axis=0)  # no outlier says more of the path than the filters believe
        remember(state.course, clipped, H, state.age_days, state.use, shown)
    update_kinds(
        x, P, H, seen.y, S / w - (S - var), shown, by_filterpy=model.by_filterpy
    )  # an outlier is an observation of so much more noise
    state.bank.learn(H, K, e, S, w, shown)
    told = np.minimum(noise / S, 1.0) * state.unchanged * shown  # share of the innovation's variance that is noise between replays
    if production:
        off = (state.p * told * (psi**2 - 1.0)).sum(axis=0) / (model.noise.std_replays + state.periods)
        state.production_var *= np.exp(np.clip(off, -1.0, 1.0))
        state.periods += shown
        return
    state.consistency += (state.p * state.unchanged * shown * (psi**2 - state.consistency)).sum(axis=0) / CONSISTENT_REPLAYS
    state.replays += shown
    state.informed += told
    state.scale = follow_scale(state.scale, state.informed, psi**2 - 1.0, told, state.joints_per_arm, model.noise)


def _judge(state: FrictionState, seen: Seen, model: FrictionModel, production: bool, waiting: np.ndarray) -> None:
    """Whether a change was found, in place; what was found becomes part of the filters."""
    J, N = state.joints_per_arm, len(state.replays)
    # what a joint says of noise, it says whether it has changed or not; else a change of several joints looks like noise that lasts
    prior = prior_by_arm(state.log_evidence - np.log(np.maximum(state.unchanged, 1e-30)), J, model.noise)
    known = model.noise.alike * state.replays + model.noise.std_replays
    state.p = probabilities(state.log_evidence, prior)
    of_change = odds(state.p, state.bank, known, state.use, J, model.changes, model.decision)
    state.odds, state.unchanged = of_change.R, of_change.unchanged
    counted = ~state.risen.reshape(-1, J + 1)[:, :J]
    learnt = seen.shown & (state.replays > model.decision.learning_replays) & ~waiting
    state.peaks = np.maximum(state.peaks, of_change.R * learnt)
    needed = model.decision.needed(state.peaks, counted, J, state.age_days)
    told = crossings(of_change, needed, learnt, counted, J, model.decision)
    if not production:  # a change among a joint's first replays belongs to the level that it begins with
        likely = of_change.R.max(axis=0) >= model.decision.suspicious(J)
        first = seen.shown & (state.replays <= model.decision.learning_replays) & likely
        new_level(state, np.flatnonzero(first), model.states.context_std**2)
    if production:  # what joints do together, and what falls, is for replays to say
        told = told._replace(falls=np.zeros_like(told.falls), common=np.zeros_like(told.common))
    else:
        state.unconfirmed &= ~seen.shown
    state.told = told
    mean = np.arange(N).reshape(-1, J + 1)[:, J]
    of_mean = np.zeros(N, dtype=bool)
    of_mean[mean] = told.common.any(axis=0)
    hit = np.flatnonzero(told.rises | told.falls | of_mean)
    if hit.size:
        fallen = (state.p * state.x[:, WEAR]).sum(axis=0) < 0.0
        refer(state, np.flatnonzero(told.rises & state.fell & fallen))  # a rise counts from the friction after the fall
        before = state.x[:, WEAR, hit].copy()
        remember_found(
            state.found,
            hit,
            of_change.R,
            needed,
            state.p,
            state.bank,
            known,
            state.age_days,
            model.changes,
        )
        absorb(state.x, state.P, state.log_evidence, state.bank, hit, known, model.changes)
        state.unchanged[:, hit] = 1.0
        state.p = probabilities(state.log_evidence, prior)
        shared = np.zeros(N)
        shared[hit] = (state.p[:, hit] * (state.x[:, WEAR, hit] - before)).sum(axis=0)
        if production:
            _doubt(state, hit, before)
        only_fell = told.falls & ~told.rises
        state.peaks[1, only_fell] = 0.0  # it was no chance, nor is
        state.peaks[np.repeat(told.common, J + 1, axis=1)] = 0.0  # … what all joints did together
        of_fall = np.zeros(N, dtype=bool)
        of_fall[mean] = told.common[1] & ~told.common[0]
        state.fell |= only_fell | of_fall
        together = np.flatnonzero(np.repeat(told.common.any(axis=0), J + 1) & state.joints & ~told.rises & ~told.falls)
        state.shared[together] += of_change.change[together]
        state.course[together] = move_course(state.course[together], np.repeat(shared[mean], J + 1)[together])
        new_level(state, together, model.changes.steps_std[1] ** 2)
        arms = (told.rises | told.falls).reshape(-1, J + 1).any(axis=1)  # the mean is of other joints, or of another level, from now on
        new_level(state, mean[arms], model.changes.steps_std[1] ** 2)
    if not production:
        _settle_falls(state, seen.shown & ~waiting)
    previously, state.risen = state.risen, np.where(waiting, state.risen, _told(state, model.decision))
    back = (previously & ~state.risen & state.joints).reshape(-1, J + 1).any(axis=1)  # the mean is of these joints again
    new_level(state, mean[back], model.changes.steps_std[1] ** 2)


def _settle_falls(state: FrictionState, shown: np.ndarray) -> None:
    """A fall that was found moves into the level, in place, as soon as replays have shown how large it is; its finding tells less."""
    n = np.flatnonzero(state.fell & shown & (state.P[0, WEAR, WEAR] > 0.0))
    if not n.size:
        return
    mean, var = over_kinds(state.p[:, n], state.x[:, WEAR, n], state.P[:, WEAR, WEAR, n])
    known = (np.sqrt(var) <= FALL_KNOWN_STD) | (state.found.ago_days[n] >= FALL_KNOWN_DAYS)
    refer(state, n[known & (mean < 0.0)])  # above 0 it is wear that slows down, which is wear still


def _doubt(state: FrictionState, n: np.ndarray, before: Array) -> None:
    """What production alone has found in the channels n may as well be of production itself: either is as likely, until a replay tells."""
    found = 0.5 * (state.x[:, WEAR, n] - before)
    for i, j, sign in ((WEAR, WEAR, 1.0), (WEAR, -1, -1.0), (-1, WEAR, -1.0), (-1, -1, 1.0)):
        state.P[:, i, j, n] += sign * found**2
    state.unconfirmed[n] = True


def _told(state: FrictionState, settings: DecisionSettings) -> np.ndarray:
    """(N,) whether wear that was found is likely above what is told; one that was told before, above a share of that."""
    changed = np.flatnonzero(state.P[0, WEAR, WEAR] > 0.0)
    w, std = state.x[:, WEAR, changed], np.sqrt(np.maximum(state.P[:, WEAR, WEAR, changed], 1e-12))
    least = settings.least * np.where(state.risen[changed], settings.cleared, 1.0)
    risen = np.zeros(len(state.replays), dtype=bool)
    risen[changed] = (state.p[:, changed] * scipy.special.ndtr((w - least) / std)).sum(axis=0) >= 0.5
    return risen


def may_have_moved(state: FrictionState, n: np.ndarray, model: FrictionModel) -> None:
    """Somebody has worked on the joints n, in place: their friction may be any now, and the slope of new grease another.

    Replays show what it is; until then nothing is to be told of them. `refer` makes what they show the level that wear counts from.
    """
    slope = state.x[:, SLOPE, n] * model.states.other_grease
    state.P[:, WEAR, WEAR, n] += model.states.work_std**2
    state.P[:, SLOPE, SLOPE, n] += slope**2
    state.bank.forget(n)
    unsettle_means(state, n, model)


def has_not_moved(state: FrictionState, n: np.ndarray) -> None:
    """Replays have shown that the joints n, which had no wear, have as much as before, in place: what `may_have_moved` added is taken back.

    What replays since then have said of wear they have said of the level.
    """
    x, P = state.x[..., n], state.P[..., n]
    doubted = np.maximum(P[:, WEAR, WEAR], 1e-12)
    gain = P[:, :, WEAR] / doubted[:, None]
    x -= gain * x[:, WEAR][:, None]
    P -= gain[:, :, None] * P[:, WEAR][:, None]
    for i in (WEAR, RATE):
        x[:, i] = P[:, i] = P[:, :, i] = 0.0
    state.x[..., n], state.P[..., n] = x, P


def unsettle_means(state: FrictionState, n: np.ndarray, model: FrictionModel) -> None:
    """The means of the arms of the joints n have another level from now on, in place: these joints are others, or were worked on."""
    means = np.unique(n // (state.joints_per_arm + 1)) * (state.joints_per_arm + 1) + state.joints_per_arm
    new_level(state, means, model.changes.steps_std[1] ** 2)


def rescale_use(state: FrictionState, factor: Array) -> None:
    """A usual day is `factor` (N,) times as much use as before, in place: so is a rate of wear, which is that of a usual day."""
    state.x[:, RATE] *= factor
    state.P[:, RATE] *= factor
    state.P[:, :, RATE] *= factor
    state.bank.B[:, RATE] *= factor.astype(np.float32)
    state.course = rescale_course(state.course, state.use, factor)
    state.bank.born_use = state.use - (state.use - state.bank.born_use) / factor


def refer(state: FrictionState, n: np.ndarray) -> None:
    """Wear of the channels n counts from their present level, as after new grease: their fall, its doubt included, is of the level."""
    x, P = state.x[..., n], state.P[..., n]
    mean, var = over_kinds(state.p[:, n], x[:, WEAR], P[:, WEAR, WEAR])
    state.moved[n] += mean
    state.moved_var[n] += var
    state.held_days[n] = 0.0
    for level in range(LEVEL, x.shape[1]):
        x[:, level] += x[:, WEAR]
        P[:, level] += P[:, WEAR]
        P[:, :, level] += P[:, :, WEAR]
    for i in (WEAR, RATE):
        x[:, i] = P[:, i] = P[:, :, i] = 0.0
    state.x[..., n], state.P[..., n] = x, P
    state.course = forget_course(state.course, n)


def count_from_here(state: FrictionState, n: np.ndarray) -> None:
    """The friction that the joints n have now is that of their beginning, in place: as after work on them that moved it."""
    refer(state, n)
    state.moved[n] = state.moved_var[n] = state.found.odds[n] = 0.0
    state.held_days[n] = np.nan
    state.risen[n] = state.fell[n] = state.unconfirmed[n] = False


def _beside(of_joints: Array, of_arm: Array) -> Array:
    """(N,) channels of (A, J) joints and (A, 1) means."""
    channels: Array = np.concatenate([of_joints, of_arm], axis=1).ravel()
    return channels
