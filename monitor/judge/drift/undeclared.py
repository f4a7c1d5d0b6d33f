"""Changes of an arm that nobody declared: a payload, a mounting or a drive gain.

The rigid base parameters of every replay are compared with their mean over the replays before in the same context. Wear changes no rigid
parameter, so a difference is not wear, and the filter learns nothing while it lasts.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import compress
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
import scipy

from monitor.model.regressor import friction_columns
from monitor.model.robot import PER_JOINT
from monitor.reason import Reason, Sentence
from monitor.recording import Array

if TYPE_CHECKING:
    from monitor.identify.identification import Identification

MOUNTING, PAYLOAD, GAINS = "mounting_contradiction", "payload_contradiction", "gain_contradiction"  # what changed
MIN_REPLAYS = 3  # with fewer replays before, there is nothing to compare with
PRIOR_REPLAYS = 5.0  # [replays] weight of the prior scatter
PRIOR_STD = 2.0  # prior standard deviation from replay to replay, in standard deviations of the first fit
MEMORY = 50.0  # [replays] over which mean and scatter are averaged
EXPLAINED = 0.6  # share of the squared difference that a mass at the flange must explain to be called a payload
PRIOR_SCATTER = 2.0  # of replays beyond the covariance within them, as variance: this before replays have shown it
LEAST_EIGENVALUE = 1e-9  # of the correlation matrix of the weights: it may be singular to rounding
FRICTION_MASS_KG = 0.3  # a mass at the flange that changes friction of shoulder and elbow as wear does: less is hardly found as a change
MASS_PARAMETERS = 4  # m, mx, my, mz of the last link: what a mass at the flange changes

HEAVIER = Sentence("heavier", "the arm carries about {kg:.1f} kg more than in the replays before, and nobody declared it")
LIGHTER = Sentence("lighter", "the arm carries about {kg:.1f} kg less than in the replays before, and nobody declared it")
OTHER_WEIGHTS = Sentence(
    "other_weights",
    "weights differ from those of the replays before by {sigmas:.0f} standard deviations ({parameter} most), and no mass at the flange "
    "explains it: drive gains or the arm itself were changed",
)
DECLARED_MASS = Sentence("declared_mass", "{change}: payload_kg says {declared_kg:.1f} kg, and it weighs about {weighed_kg:.1f} kg")
OWN_LEVEL = Sentence("own_level", "{change}; wear is judged against a level of its own since {since_unix_s:day}")


class UndeclaredChange(NamedTuple):
    """What contradicts the declared context."""

    condition: str | None  # MOUNTING, PAYLOAD or GAINS; None: nothing
    reason: Reason
    kg: float | None = None  # mass at the flange beyond that of the replays before; None where no mass explains it
    own_level: bool = False  # whether the replay belongs to a level of friction of its own, see `undeclared_level`
    begins: bool = False  # whether that level begins with this replay
    same_mass: bool = False  # whether the weights exclude a mass of `FRICTION_MASS_KG`

    @property
    def withheld(self) -> bool:
        """Whether the filter must not learn from the replay."""
        return self.condition is not None and not self.own_level


NO_UNDECLARED_CHANGE = UndeclaredChange(None, Sentence("as_declared", "the arm is as it was declared")())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MassEstimate:
    """The rigid base parameters in one context, (R,) each."""

    columns: Annotated[Array, "R"]  # of the regressor
    mean: Annotated[Array, "R"]
    var: Annotated[Array, "R"]  # between replays
    replays: int
    covariance: Annotated[Array, "R R"] | None = None  # mean of those within the replays; None in beliefs of releases without it
    scatter: float = PRIOR_SCATTER  # mean χ² per degree of freedom of what neither a mass nor a common scale explains


def rigid_of(identification: "Identification") -> np.ndarray:
    """(B,) which base parameters are rigid: neither friction nor rotor inertia."""
    rigid: np.ndarray = _rigid_columns(len(identification.coulomb_nm))[np.asarray(identification.columns, dtype=int)]
    return rigid


@cache
def _rigid_columns(joints: int) -> np.ndarray:
    """(P,) which columns of the regressor are rigid."""
    rigid = np.ones(PER_JOINT * joints, dtype=bool)
    rigid[np.concatenate([*friction_columns(joints), np.arange(joints) * PER_JOINT + PER_JOINT - 1])] = False
    return rigid


class RigidFit(NamedTuple):
    """The rigid base parameters that one replay identified, (R,) each."""

    columns: Array  # of the regressor
    names: tuple[str, ...]
    values: Array
    covariance: Annotated[Array, "R R"]  # within the replay
    of_mass: Annotated[Array, "R 4"]  # what m, mx, my, mz of the last link add to them

    @property
    def variance(self) -> Array:
        """(R,) within the replay."""
        return np.diagonal(self.covariance)


def rigid_fit(identification: "Identification") -> RigidFit:
    """The rigid part of an identification."""
    rigid = rigid_of(identification)
    last_link = PER_JOINT * (len(identification.coulomb_nm) - 1)
    return RigidFit(
        columns=np.array(identification.columns, dtype=float)[rigid],
        names=tuple(compress(identification.names, rigid.tolist())),
        values=identification.values[rigid],
        covariance=identification.covariance[np.ix_(rigid, rigid)],
        of_mass=identification.combination[rigid][:, last_link : last_link + MASS_PARAMETERS],
    )


def another_gravity(identification: "Identification") -> UndeclaredChange:
    """What of a replay contradicts the declared mounting: identify compares it with gravity in the data."""
    contradictions = [warning for warning in identification.warnings if warning.code == MOUNTING]
    return UndeclaredChange(MOUNTING, contradictions[0]) if contradictions else NO_UNDECLARED_CHANGE


def misfit(fit: RigidFit, estimate: MassEstimate | None) -> float:
    """χ² of a replay's rigid parameters about those of the replays before; infinite where there are none."""
    if estimate is None or not np.array_equal(estimate.columns, fit.columns):
        return math.inf
    normalised, _, _ = _normalised(fit, estimate)
    return float(normalised @ normalised)


def _normalised(fit: RigidFit, estimate: MassEstimate) -> tuple[Array, Array, np.ndarray]:
    """How far a replay is from those before, in standard deviations; these; and of which parameters they are known, (R,)."""
    var = fit.variance + estimate.var * (1.0 + 1.0 / estimate.replays)
    known = np.isfinite(var) & (var > 0)
    std = np.sqrt(var[known])
    return (fit.values - estimate.mean)[known] / std, std, known


def compare_weights(
    fit: RigidFit, estimate: MassEstimate | None, *, sigma: float, mass_kg: float, left: "Left | None" = None
) -> UndeclaredChange:
    """What of a replay's rigid parameters contradicts those of the replays before.

    estimate : of the replays before in the same context; None before the first. sigma : how many standard deviations are a contradiction.
    mass_kg : smallest mass at the flange that is called a payload. left : `what_is_left` of both, where somebody else asks for it too.
    """
    if estimate is None or estimate.replays < MIN_REPLAYS or not np.array_equal(estimate.columns, fit.columns):
        return NO_UNDECLARED_CHANGE
    normalised, std, known = _normalised(fit, estimate)
    squares = float(normalised @ normalised)  # χ² of `degrees` if nothing changed
    degrees = len(normalised)
    X = fit.of_mass[known] / std[:, None]
    load, *_ = np.linalg.lstsq(X, normalised, rcond=1e-9)  # (m, mx, my, mz) of the mass that explains most of it
    rest = normalised - X @ load
    squares_left = float(rest @ rest)
    explained = 1.0 - squares_left / max(squares, 1e-300)
    if squares - squares_left > sigma**2 and explained >= EXPLAINED and abs(load[0]) >= mass_kg:
        return _payload(float(load[0]))
    if explained < EXPLAINED and squares > degrees * sigma**2:
        return _gains(np.sqrt(squares / degrees), _worst(fit, known, normalised))
    together = (left or what_is_left(fit, estimate))()
    chi2 = together.chi2 / max(estimate.scatter, 1.0)
    if chi2 > _chi2_limit(together.degrees, sigma):
        return _gains(np.sqrt(chi2 / together.degrees), _worst(fit, known, normalised))
    return NO_UNDECLARED_CHANGE._replace(same_mass=abs(load[0]) + sigma * _mass_std_kg(X) <= FRICTION_MASS_KG)


def _mass_std_kg(X: Array) -> float:
    """Standard deviation of a mass at the flange whose place is unknown; X : (K, 4) what m, mx, my, mz add, in standard deviations."""
    mass, place = X[:, 0], X[:, 1:]
    own = mass - place @ np.linalg.lstsq(place, mass, rcond=1e-9)[0]  # what no place of another mass does as well
    size, least = float(np.linalg.norm(own)), 1e-6 * float(np.linalg.norm(mass))
    return 1.0 / size if size > least else math.inf


def _worst(fit: RigidFit, known: np.ndarray, normalised: Array) -> str:
    """The name of the parameter that is furthest from the replays before, of those that are known (R,)."""
    return fit.names[int(np.flatnonzero(known)[np.argmax(np.abs(normalised))])]


class Unexplained(NamedTuple):
    """Weights that neither a mass at the flange nor a common scale explains."""

    chi2: float  # without the scatter from replay to replay
    degrees: int  # of freedom; 0 where nothing is known


Left = Callable[[], Unexplained]
"""What of a replay's weights is left, computed when it is asked for first: a contradiction and the estimate's scatter both need it."""


def what_is_left(fit: RigidFit, estimate: MassEstimate) -> Left:
    """`unexplained` of both, computed once and only if it is asked for."""
    return cache(partial(unexplained, fit, estimate))


@cache
def _chi2_limit(degrees: int, sigma: float) -> float:
    """χ² that is as rare as `sigma` standard deviations of one normal variable; infinite without a degree of freedom."""
    return float(scipy.special.chdtri(degrees, 2.0 * scipy.special.ndtr(-sigma))) if degrees else math.inf


def unexplained(fit: RigidFit, estimate: MassEstimate) -> Unexplained:
    """What of a replay's weights another gain of one joint makes, by the covariance of all weights together.

    The gain of one joint turns weights that a replay knows well only in combinations, so it hardly shows in any single weight. A common
    scale is left out, because the magnets of all motors weaken as they warm, and so is a mass, which has a verdict of its own. The
    covariance is the mean over replays: that of a single one is too uncertain. A replay that fits worse than usual, as with friction at one
    place of a joint, is believed as much less.
    """
    if estimate.covariance is None:
        return Unexplained(0.0, 0)
    known = np.isfinite(np.diagonal(fit.covariance)) & (np.diagonal(estimate.covariance) > 0)
    within = estimate.covariance[np.ix_(known, known)]
    std = np.sqrt(np.diagonal(within))
    degrees = len(std) - 1 - MASS_PARAMETERS
    if degrees < 1 or not np.isfinite(within).all():
        return Unexplained(0.0, 0)
    root = np.linalg.cholesky(within / np.outer(std, std) + LEAST_EIGENVALUE * np.eye(len(std)))

    def whitened(X: Array) -> Array:
        result: Array = scipy.linalg.solve_triangular(root, X / std[:, None], lower=True, check_finite=False)
        return result

    own = np.diagonal(whitened(whitened(fit.covariance[np.ix_(known, known)]).T))
    noise = max(float(np.median(own)), 1.0) + 1.0 / min(estimate.replays, MEMORY)
    white = whitened(np.column_stack([fit.values - estimate.mean, estimate.mean, fit.of_mass])[known])
    moved, X = white[:, 0], white[:, 1:]
    explained, *_ = np.linalg.lstsq(X, moved, rcond=1e-9)
    left = moved - X @ explained
    return Unexplained(float(left @ left) / noise, degrees)


def update_mass_estimate(estimate: MassEstimate | None, fit: RigidFit, left: Left | None = None) -> MassEstimate:
    """The estimate after one more replay of the same context. left : as in `compare_weights`."""
    noise = np.nan_to_num(fit.variance)
    if estimate is None or not np.array_equal(estimate.columns, fit.columns):
        return MassEstimate(columns=fit.columns, mean=fit.values, var=noise * PRIOR_STD**2, replays=1, covariance=fit.covariance)
    n = min(estimate.replays + 1.0, MEMORY)
    moved = fit.values - estimate.mean
    var = estimate.var + (np.maximum(moved**2 * (n - 1.0) / n - noise, 0.0) - estimate.var) / (n + PRIOR_REPLAYS)
    covariance, scatter = estimate.covariance, estimate.scatter
    covariance = fit.covariance if covariance is None else covariance + (fit.covariance - covariance) / n
    if estimate.replays >= MIN_REPLAYS:
        together = (left or what_is_left(fit, estimate))()
        if together.degrees:
            scatter += (together.chi2 / together.degrees - scatter) / (n + PRIOR_REPLAYS)
    return replace(estimate, mean=estimate.mean + moved / n, var=var, replays=estimate.replays + 1, covariance=covariance, scatter=scatter)


def _payload(kg: float) -> UndeclaredChange:
    """A mass at the flange, negative where it was taken off."""
    return UndeclaredChange(PAYLOAD, (HEAVIER if kg > 0 else LIGHTER)(kg=abs(kg)), kg)


def _gains(sigmas: float, parameter: str) -> UndeclaredChange:
    """Weights that no mass explains; `parameter` differs most."""
    return UndeclaredChange(GAINS, OTHER_WEIGHTS(sigmas=sigmas, parameter=parameter))


# --- The level of friction of an arm whose weights contradict what is declared, in replay after replay by the same ---

LEVEL_REPLAYS = 20  # that agree with each other: an integrator who means to declare the change has done so in as many days


class UndeclaredLevel(NamedTuple):
    """Replays that contradict the declaration and agree with each other."""

    estimate: MassEstimate
    condition: str  # by which they contradict it
    reason: Reason  # what the change is
    kg: float | None  # mass at the flange beyond the declared one; None where no mass explains it
    since_unix_s: float | None  # when it had enough replays for a level of its own; None: not yet


class Weights(NamedTuple):
    """What the arm weighs in the context that is declared."""

    declared: MassEstimate | None = None  # in the replays that contradict nothing
    level: UndeclaredLevel | None = None  # that has a level of friction of its own
    candidate: UndeclaredLevel | None = None  # that has not enough replays yet


class Weighed(NamedTuple):
    """The weights after one more replay, and what the replay contradicts."""

    weights: Weights
    undeclared: UndeclaredChange


def weigh(weights: Weights, fit: RigidFit, at_unix_s: float, *, sigma: float, mass_kg: float, declared_kg: float | None = None) -> Weighed:
    """What the weights of one more replay contradict, and the weights after it.

    sigma, mass_kg : as in `compare_weights`. declared_kg : payload as declared, for the text; None where nobody declares one.
    """
    left = None if weights.declared is None else what_is_left(fit, weights.declared)
    found = compare_weights(fit, weights.declared, sigma=sigma, mass_kg=mass_kg, left=left)
    level = weights.level
    nearer = level is not None and (found.condition is not None or misfit(fit, level.estimate) < misfit(fit, weights.declared))
    if level is not None and nearer and _is_of(level, fit, sigma=sigma, mass_kg=mass_kg):
        level = level._replace(estimate=update_mass_estimate(level.estimate, fit))
        return Weighed(weights._replace(level=level), _standing(level, declared_kg))
    if found.condition is None:
        return Weighed(weights._replace(declared=update_mass_estimate(weights.declared, fit, left)), found)
    before = weights.candidate
    agree = before is not None and before.condition == found.condition and _is_of(before, fit, sigma=sigma, mass_kg=mass_kg)
    estimate = update_mass_estimate(before.estimate if agree and before is not None else None, fit)
    candidate = UndeclaredLevel(estimate, str(found.condition), found.reason, found.kg, None)
    if estimate.replays < LEVEL_REPLAYS:
        return Weighed(weights._replace(candidate=candidate), found)
    mean = compare_weights(fit._replace(values=estimate.mean), weights.declared, sigma=sigma, mass_kg=mass_kg)
    if mean.condition == found.condition:  # the mean of so many replays says it better than the last one
        candidate = candidate._replace(reason=mean.reason, kg=mean.kg)
    level = candidate._replace(since_unix_s=at_unix_s)
    return Weighed(weights._replace(level=level, candidate=None), _standing(level, declared_kg)._replace(begins=True))


def declares_level(weights: Weights, fit: RigidFit, *, sigma: float, mass_kg: float) -> bool:
    """Whether the first replay of a context with another payload weighs what the undeclared level does: then they are the same."""
    level = weights.level
    return level is not None and level.condition == PAYLOAD and _is_of(level, fit, sigma=sigma, mass_kg=mass_kg)


def _is_of(level: UndeclaredLevel, fit: RigidFit, *, sigma: float, mass_kg: float) -> bool:
    """Whether a replay weighs what those of a level do."""
    same_columns = np.array_equal(level.estimate.columns, fit.columns)
    return same_columns and compare_weights(fit, level.estimate, sigma=sigma, mass_kg=mass_kg).condition is None


def _standing(level: UndeclaredLevel, declared_kg: float | None) -> UndeclaredChange:
    """The contradiction of a replay that belongs to a level of its own."""
    reason = level.reason
    if level.kg is not None and declared_kg is not None:
        reason = DECLARED_MASS(change=reason, declared_kg=declared_kg, weighed_kg=max(declared_kg + level.kg, 0.0))
    return UndeclaredChange(level.condition, OWN_LEVEL(change=reason, since_unix_s=level.since_unix_s or 0.0), level.kg, own_level=True)
