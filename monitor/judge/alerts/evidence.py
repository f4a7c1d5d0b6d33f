"""The evidence that friction of joints has risen or fallen: what the model found of F(v*), and of the series beside it.

That a change was found is the model's decision, by its odds. Here its size becomes tiers. A joint that needs 10 % more torque at low speed
is worn though it needs none more at v*: so the largest rise over the speeds counts. For wear at one place of the joint the torque that came
to the unexplained one is compared with friction, as RMS over the replay. No series beside F(v*) raises the limit tier: that is of F(v*).

Shapes: A arms, N joints.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import scipy

from monitor.identify.settings import PLACE_RAD
from monitor.judge.drift.step import DriftState
from monitor.judge.friction.beside import RIPPLE, model_beside
from monitor.judge.friction.figures import fallen, found_wear, level_in_force, wear_above
from monitor.judge.friction.observation import FAST_RAD_S, RIPPLE_FLOOR, SLOW_RAD_S
from monitor.judge.friction.posterior import over_kinds
from monitor.judge.friction.states import WEAR
from monitor.judge.friction.step import FrictionState
from monitor.judge.settings import HealthSettings
from monitor.reason import Reason, Sentence, together
from monitor.recording import Array

REFERENCE_RAD_S = 0.4  # the speed at which friction is unchanged while the contrast turns; the rises depend on it weakly
SPEEDS_RAD_S = (SLOW_RAD_S, FAST_RAD_S, None)  # at which a series finds a rise; None: at one place of the joint, at any speed
NOISIER_LOG = float(np.log(1.2))  # of the current's noise that may have grown by more, the residual may have grown, and nobody wears
LEAST_STD = 0.01  # [log] a straight line is no law of friction: what it says of another speed is not better known than this
NOTHING = -np.inf  # [log] rise where no series found a change

AT_ONE_PLACE = Sentence(
    "rise_at_place",
    "torque that the fit does not explain is {ratio:.1f} times that of before, {change:+z.0%} ± {std:.0%} of friction: wear at one place",
)
AT_SPEED = Sentence(
    "rise_at_speed", "friction at {speed_rad_s:g} rad/s rose by {change:+z.0%} ± {std:.0%} against friction at {reference_rad_s:g} rad/s"
)
FOUND = Sentence("channel_found", "{joint:joint}: {finding}.")
FOUND_BETWEEN = Sentence("channel_found_between", "{joint:joint}: {finding}, now largest between {low_rad:.1f} and {high_rad:.1f} rad.")


class RiseBeside(NamedTuple):
    """The largest rise that a series beside F(v*) found, (N,) each."""

    rise: Array  # [log] of friction at that speed or place over that at v*; −∞ where nothing was found
    std: Array
    at: Array  # index into `SPEEDS_RAD_S`
    ratio: Array  # of the residual's RMS to that of before; 1 where it did not change


class JointRiseBeside(NamedTuple):
    """What the series beside F(v*) found of one joint."""

    rise: float  # [log] −∞ where nothing was found, or where F(v*) itself rose by more
    std: float
    speed_rad_s: float | None  # None: at one place of the joint
    ratio: float

    @property
    def found(self) -> bool:
        """Whether a series found more than friction at the reference speed shows."""
        return bool(np.isfinite(self.rise))

    def above(self, settings: HealthSettings) -> Array:
        """(3,) probability that the rise is above that of each tier."""
        if not self.found:
            return np.zeros(3)
        probability: Array = scipy.special.ndtr((self.rise - np.log1p(settings.rises)) / max(self.std, 1e-9))
        return probability

    @property
    def finding(self) -> Reason:
        """What the series found, as a clause."""
        figures = {"change": np.expm1(self.rise), "std": np.exp(self.rise) * self.std}
        if self.speed_rad_s is None:
            return AT_ONE_PLACE(ratio=self.ratio, **figures)
        return AT_SPEED(speed_rad_s=self.speed_rad_s, reference_rad_s=REFERENCE_RAD_S, **figures)

    def text(self, j: int, of_reference: Callable[[], Reason], peak_rad: Array | None = None) -> Reason:
        """The alert's text: of the series where one found more than F(v*) shows, and of F(v*).

        peak_rad : (J,) where the residual of the last replay is largest; None where nobody knows.
        """
        if not self.found:
            return of_reference()
        if self.speed_rad_s is None and peak_rad is not None and np.isfinite(peak_rad[j]):
            low, high = peak_rad[j] - PLACE_RAD / 2, peak_rad[j] + PLACE_RAD / 2
            return together(FOUND_BETWEEN(joint=j + 1, finding=self.finding, low_rad=low, high_rad=high), of_reference())
        return together(FOUND(joint=j + 1, finding=self.finding), of_reference())


class Evidence(NamedTuple):
    """What the replays so far say about changed friction."""

    wear: Array  # (N,) [log] that was found, over the level that it counts from
    wear_std: Array  # (N,)
    above: Array  # (N, 3) probability that it is above the rise of each tier
    raises: Array  # (N,) index of the highest tier that may be raised; −1: none
    fall: Array  # (N,) friction over that at the beginning [log], without running-in and without what joints changed together
    fall_std: Array  # (N,)
    below: Array  # (N,) probability that it fell by more than the wear tier's rise
    falls: np.ndarray  # (N,) whether fallen friction may be raised
    common: Array  # (A,) what most joints changed together [log]; 0 where that was not found
    common_std: Array  # (A,)
    together: np.ndarray  # (A,) whether that may be raised
    beside: RiseBeside | None = None  # what the series beside F(v*) found


def weigh_evidence(state: DriftState, settings: HealthSettings) -> Evidence:
    """The evidence after an observation."""
    friction, rises = state.friction, np.log1p(settings.rises)
    wear, wear_std = found_wear(friction)
    above = wear_above(friction, rises)
    risen: np.ndarray = friction.of_joints(friction.risen)
    beside = rise_beside(state)
    tiers = np.stack([risen, risen & (above[:, 1] >= settings.wear_sure), risen & (above[:, 2] >= settings.limit_sure)], axis=1)
    tiers |= _tiers_beside(beside, wear, settings)
    fall, fall_std = fallen(friction)
    least = np.log1p(-settings.wear_rise)
    below = scipy.special.ndtr((least - fall) / np.maximum(fall_std, 1e-9))
    common, common_std = _together(friction)
    up = friction.of_arms(friction.risen)
    down = friction.of_arms(friction.fell) & (scipy.special.ndtr((least - common) / np.maximum(common_std, 1e-9)) >= settings.wear_sure)
    return Evidence(
        wear=wear,
        wear_std=wear_std,
        above=above,
        raises=np.max(np.where(tiers, np.arange(tiers.shape[1]), -1), axis=1),
        fall=fall,
        fall_std=fall_std,
        below=below,
        falls=friction.of_joints(friction.fell) & (below >= settings.wear_sure),
        common=common,
        common_std=common_std,
        together=up | down,
        beside=beside,
    )


def _together(friction: FrictionState) -> tuple[Array, Array]:
    """Mean and standard deviation (A,) of what the means of the arms have changed by since the beginning [log], as found."""
    mean, var = over_kinds(friction.p, friction.x[:, WEAR], friction.P[:, WEAR, WEAR])
    return friction.of_arms(mean + friction.moved), np.sqrt(friction.of_arms(var + friction.moved_var))


def raised_by_production(raises: Array) -> Array:
    """(N,) the tiers to which production alone may raise an alert, an advisory at most: one replay shall confirm whatever is graver."""
    return np.minimum(raises, 0)


# --- The series beside F(v*) ---


def risen_beside(state: DriftState, name: str) -> np.ndarray:
    """(N,) whether a series has risen, by the model of its own."""
    series = state.beside.get(name)
    return np.zeros(state.joints, dtype=bool) if series is None else series.of_joints(series.risen)


def shift_beside(state: DriftState, name: str) -> tuple[Array, Array]:
    """Mean and standard deviation (N,) of what a series has changed by, as found [log]; 0 where it was never measured."""
    series = state.beside.get(name)
    return (np.zeros(state.joints),) * 2 if series is None else found_wear(series)


def noisier(state: DriftState) -> np.ndarray:
    """(N,) whether a joint's current is noisier than it was, and the others' are not as much."""
    return risen_beside(state, "noise")


class RippleRise(NamedTuple):
    """The gear ripple that rose most in each joint, (N,) each, by how often it comes in a turn of the motor."""

    found: np.ndarray
    cycles: np.ndarray  # in a turn of the motor
    before: Array  # amplitude over friction
    now: Array


def ripple_rise(state: DriftState) -> RippleRise:
    """What the ripple of each joint's gear has risen by, and that of the others has not as much."""
    found = np.stack([risen_beside(state, name) for name in RIPPLE])  # (2, N)
    level = np.stack([_level(state.beside.get(name), state.joints) for name in RIPPLE])
    shift = np.stack([shift_beside(state, name)[0] for name in RIPPLE])
    order = np.argmax(np.where(found, shift, NOTHING), axis=0)
    joints = np.arange(state.joints)
    before, now = (np.maximum(np.exp(each[order, joints]) - RIPPLE_FLOOR, 0.0) for each in (level, level + shift))
    return RippleRise(found.max(axis=0), 1 + order, before, now)


def _maybe_noisier(state: DriftState) -> np.ndarray:
    """(N,) whether a joint's current is likely noisier than it was, found or not yet: the residual may be found before its cause is."""
    series = state.beside.get("noise")
    if series is None:
        return np.zeros(state.joints, dtype=bool)
    grown: np.ndarray = series.wear(model_beside("noise")).below(np.full(len(series.replays), NOISIER_LOG)) < 0.5
    likely: np.ndarray = noisier(state) | series.of_joints(grown)
    return likely


def rise_beside(state: DriftState) -> RiseBeside | None:
    """The rise of each joint by the series beside F(v*); None where none was measured."""
    if not state.beside:
        return None
    found = {name: risen_beside(state, name) for name in ("contrast", "slow", "fast", "residual")}
    if found["residual"].any():
        found["residual"] = found["residual"] & ~_maybe_noisier(state)  # that grew because the current is noisier
    shifts = {name: shift_beside(state, name) for name in found}
    largest = _rises(state, found, {name: mean for name, (mean, _) in shifts.items()})
    lower = _rises(state, found, {name: mean - np.copysign(std, mean) for name, (mean, std) in shifts.items()})
    at = np.argmax(largest, axis=0)
    rise, less = (np.take_along_axis(each, at[None, :], axis=0)[0] for each in (largest, lower))
    known = np.isfinite(rise) & (rise > 0)
    return RiseBeside(
        rise=np.where(known, rise, NOTHING),
        std=np.where(known, np.maximum(np.where(known, rise, 0.0) - np.where(known, less, 0.0), LEAST_STD), 0.0),
        at=at,
        ratio=np.exp(np.where(found["residual"], shifts["residual"][0], 0.0)),
    )


def joint_rise_beside(beside: RiseBeside | None, wear: Array, j: int) -> JointRiseBeside:
    """What the series found of joint j (from 0), with a fall of F(v*) taken from it."""
    if beside is None or not np.isfinite(beside.rise[j]):
        return JointRiseBeside(NOTHING, 0.0, None, 1.0)
    rise = float(beside.rise[j] + min(wear[j], 0.0))
    if rise <= wear[j]:
        return JointRiseBeside(NOTHING, 0.0, None, 1.0)
    return JointRiseBeside(rise, float(beside.std[j]), SPEEDS_RAD_S[int(beside.at[j])], float(beside.ratio[j]))


def _tiers_beside(beside: RiseBeside | None, wear: Array, settings: HealthSettings) -> np.ndarray:
    """(N, 3) whether a series shows the rise of each tier; a fall of F(v*) counts against the rise."""
    if beside is None:
        return np.zeros((len(wear), len(settings.rises)), dtype=bool)
    known = np.isfinite(beside.rise)
    rise = np.where(known, beside.rise, 0.0) + np.minimum(wear, 0.0)
    sure = scipy.special.ndtr((rise - np.log1p(settings.wear_rise)) / np.where(known, beside.std, 1.0)) >= settings.wear_sure
    return np.stack([known & (rise >= np.log1p(settings.advisory_rise)), known & sure, np.zeros_like(known)], axis=1)


def _level(series: FrictionState | None, joints: int) -> Array:
    """(N,) of a series in the context in force, without wear [log]; 0 where it was never measured."""
    return np.zeros(joints) if series is None else level_in_force(series)


def _rises(state: DriftState, found: Mapping[str, np.ndarray], shift: Mapping[str, Array]) -> Array:
    """(3, N) rise at low speed, at high speed and at one place [log]; −∞ where it was not found."""
    before = _level(state.beside.get("contrast"), state.joints)
    after = before + shift["contrast"]
    rises = []
    for name, v in (("slow", SLOW_RAD_S), ("fast", FAST_RAD_S)):
        line = np.where(found["contrast"], _to_reference(after, v) - _to_reference(before, v), NOTHING)
        rises.append(np.maximum(line, np.where(found[name], shift[name], NOTHING)))
    was = np.exp(2.0 * (_level(state.beside.get("residual"), state.joints) - _level(state.friction, state.joints)))  # of friction squared
    more = was * np.expm1(2.0 * np.maximum(shift["residual"], 0.0))
    return np.stack([*rises, np.where(found["residual"], np.log1p(np.sqrt(more)), NOTHING)])


def _to_reference(contrast: Array, speed_rad_s: float) -> Array:
    """Logarithm of friction at a speed over that at v*, by the line fc + fv·v and its contrast log fc − log fv."""
    dry = np.exp(np.clip(contrast, -20.0, 20.0))
    ratio: Array = np.log((dry + speed_rad_s) / (dry + REFERENCE_RAD_S))
    return ratio
