"""The evidence that friction of joints has risen or fallen, by F(v*) and by the channels beside it.

A tier requires statistical significance, practical relevance (the rise itself), consecutive replays on several days inside the learned
temperatures, and a rise beyond the common rise of all joints. It compares the largest rise over the speeds: a joint that needs 10 % more
torque at low speed is worn though it needs none more at v*. For wear at one place of the joint it compares the torque that came to the
unexplained one, as RMS over the replay, with friction. No channel raises the limit tier: the configured limit is one of F(v*).

Shapes: C channels, N joints.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from monitor.identify.settings import PLACE_RAD
from monitor.judge.alerts.health import TIERS, Health
from monitor.judge.belief import Belief
from monitor.judge.drift.channels import CONTRAST, FAST, NOISE, RESIDUAL, SLOW, ChannelState
from monitor.judge.drift.filter_state import FilterState
from monitor.judge.drift.observation import FAST_RAD_S, SLOW_RAD_S
from monitor.judge.drift.update.change_detection import LONG
from monitor.judge.settings import HealthSettings
from monitor.reason import Reason, Sentence, together
from monitor.recording import DAY_S, Array

REFERENCE_RAD_S = 0.4  # the speed at which friction is unchanged while the contrast turns; the rises depend on it weakly
SPEEDS_RAD_S = (SLOW_RAD_S, FAST_RAD_S, None)  # at which a channel finds a rise; None: at one place of the joint, at any speed
LEAST_STD = 0.01  # [log] a straight line is no law of friction: what it says of another speed is not better known than this
NOTHING = -np.inf  # [log] rise where no channel found a change

AT_ONE_PLACE = Sentence(
    "rise_at_place",
    "torque that the fit does not explain is {ratio:.1f} times that of before, {change:+z.0%} ± {std:.0%} of friction: wear at one place",
)
AT_SPEED = Sentence(
    "rise_at_speed", "friction at {speed_rad_s:g} rad/s rose by {change:+z.0%} ± {std:.0%} against friction at {reference_rad_s:g} rad/s"
)
FOUND = Sentence("channel_found", "{joint:joint}: {finding}.")
FOUND_BETWEEN = Sentence("channel_found_between", "{joint:joint}: {finding}, now largest between {low_rad:.1f} and {high_rad:.1f} rad.")


class ChannelRise(NamedTuple):
    """The largest rise that a channel found, (N,) each."""

    rise: Array  # [log] of friction at that speed or place over that at v*; −∞ where nothing was found
    std: Array
    at: Array  # index into `SPEEDS_RAD_S`
    ratio: Array  # of the residual's RMS to that of the baseline; 1 where it did not change


class JointChannelRise(NamedTuple):
    """What the channels found of one joint."""

    rise: float  # [log] −∞ where nothing was found, or where F(v*) itself rose by more
    std: float
    speed_rad_s: float | None  # None: at one place of the joint
    ratio: float

    @property
    def found(self) -> bool:
        """Whether a channel found more than friction at the reference speed shows."""
        return bool(np.isfinite(self.rise))

    def above(self, settings: HealthSettings) -> Array:
        """(3,) probability that the rise is above that of each tier."""
        if not self.found:
            return np.zeros(3)
        probability: Array = scipy.special.ndtr((self.rise - np.log1p(settings.rises)) / max(self.std, 1e-9))
        return probability

    @property
    def finding(self) -> Reason:
        """What the channel found, as a clause."""
        figures = {"change": np.expm1(self.rise), "std": np.exp(self.rise) * self.std}
        if self.speed_rad_s is None:
            return AT_ONE_PLACE(ratio=self.ratio, **figures)
        return AT_SPEED(speed_rad_s=self.speed_rad_s, reference_rad_s=REFERENCE_RAD_S, **figures)

    def text(self, j: int, of_reference: Callable[[], Reason], peak_rad: Array | None = None) -> Reason:
        """The alert's text: of the channel where one found more than F(v*) shows, and of F(v*).

        peak_rad : (J,) where the residual of the last replay is largest; None where nobody knows.
        """
        if not self.found:
            return of_reference()
        if self.speed_rad_s is None and peak_rad is not None and np.isfinite(peak_rad[j]):
            low, high = peak_rad[j] - PLACE_RAD / 2, peak_rad[j] + PLACE_RAD / 2
            return together(FOUND_BETWEEN(joint=j + 1, finding=self.finding, low_rad=low, high_rad=high), of_reference())
        return together(FOUND(joint=j + 1, finding=self.finding), of_reference())


def channel_rise(state: ChannelState | None) -> ChannelRise | None:
    """The rise of each joint by the channels' state; None without one."""
    if state is None:
        return None
    N = state.found.shape[1]
    if not state.found.any():  # as on nearly every day
        return ChannelRise(rise=np.full(N, NOTHING), std=np.zeros(N), at=np.zeros(N, dtype=int), ratio=np.ones(N))
    rises = np.stack([_rises(state, state.shift), _rises(state, state.shift - np.copysign(state.shift_std, state.shift))])
    found = np.stack([_found(state, CONTRAST) | _found(state, SLOW), _found(state, CONTRAST) | _found(state, FAST), _found_at_place(state)])
    rise = np.where(found, rises[0], NOTHING)
    at = np.argmax(rise, axis=0)
    largest, lower = (np.take_along_axis(each, at[None, :], axis=0)[0] for each in (rise, rises[1]))
    known = np.isfinite(largest) & (largest > 0)
    return ChannelRise(
        rise=np.where(known, largest, NOTHING),
        std=np.where(known, np.maximum(largest - lower, LEAST_STD), 0.0),
        at=at,
        ratio=np.exp(np.where(_found_at_place(state), state.shift[RESIDUAL], 0.0)),
    )


def channel_tiers(channels: ChannelRise | None, excess: Array, settings: HealthSettings) -> np.ndarray:
    """(N, 3) whether a channel shows the rise of each tier. excess : (N,) of F(v*) [log]; a fall of it counts against the rise."""
    if channels is None:
        return np.zeros((len(excess), len(settings.rises)), dtype=bool)
    known = np.isfinite(channels.rise)
    rise = np.where(known, channels.rise, 0.0) + np.minimum(excess, 0.0)
    wear = scipy.special.ndtr((rise - np.log1p(settings.wear_rise)) / np.where(known, channels.std, 1.0)) >= settings.wear_sure
    return np.stack([known & (rise >= np.log1p(settings.advisory_rise)), known & wear, np.zeros_like(known)], axis=1)


def joint_channel_rise(channels: ChannelRise | None, excess: Array, j: int) -> JointChannelRise:
    """What the channels found of joint j (from 0), with the fall of F(v*) taken from it."""
    if channels is None or not np.isfinite(channels.rise[j]):
        return JointChannelRise(NOTHING, 0.0, None, 1.0)
    rise = float(channels.rise[j] + min(excess[j], 0.0))
    if rise <= excess[j]:
        return JointChannelRise(NOTHING, 0.0, None, 1.0)
    return JointChannelRise(rise, float(channels.std[j]), SPEEDS_RAD_S[int(channels.at[j])], float(channels.ratio[j]))


def _found(state: ChannelState, channel: int) -> np.ndarray:
    found: np.ndarray = state.found[channel] > 0
    return found


def _found_at_place(state: ChannelState) -> np.ndarray:
    """(N,) whether the residual grew, and not because the current is noisier."""
    at_place: np.ndarray = _found(state, RESIDUAL) & ~noisier(state)
    return at_place


def noisier(state: ChannelState) -> np.ndarray:
    """(N,) whether a joint's current is noisier than it was, and the others' are not as much."""
    noise: np.ndarray = _found(state, NOISE) & (state.shift[NOISE] > 0)
    return noise


def _rises(state: ChannelState, shift: Array) -> Array:
    """(3, N) rise at low speed, at high speed and at one place [log], by shifts (C, N) of the channels from their baselines."""
    before = state.level[CONTRAST]
    after = before + np.where(_found(state, CONTRAST), shift[CONTRAST], 0.0)
    line = [np.nan_to_num(_to_reference(after, v) - _to_reference(before, v)) for v in (SLOW_RAD_S, FAST_RAD_S)]
    fitted = [np.where(_found(state, k), shift[k], -np.inf) for k in (SLOW, FAST)]
    was = np.exp(2.0 * state.level[RESIDUAL] - 2.0 * state.log_torque)  # (N,) of friction squared
    more = was * np.expm1(2.0 * np.maximum(shift[RESIDUAL], 0.0))
    return np.stack([np.maximum(line[0], fitted[0]), np.maximum(line[1], fitted[1]), np.log1p(np.sqrt(np.nan_to_num(more)))])


def _to_reference(contrast: Array, speed_rad_s: float) -> Array:
    """Logarithm of friction at a speed over that at v*, by the line fc + fv·v and its contrast log fc − log fv."""
    dry = np.exp(np.clip(contrast, -20.0, 20.0))
    ratio: Array = np.log((dry + speed_rad_s) / (dry + REFERENCE_RAD_S))
    return ratio


# --- The evidence of changed friction --------------------------------------------------------------------

FALLING = len(TIERS)  # column of `Counts` that counts fallen friction; the columns before it count risen friction, one a tier
COLUMNS = FALLING + 1
# Upward crossings of its mean by the estimated wear of a healthy joint. 0.25 was measured where no change was found. One that was found by
# chance is estimated anew with every replay, and its wear crosses more often: this leads to 3 σ, at which such an alert ends.
CROSSINGS_PER_YEAR = 0.75
# Share of the standard deviations that wear needs on the replay that finds a rise which began long ago: that it was found is evidence too.
# With all of them a fifth of slow wear waited for days; with fewer, joints whose noise lasts longer than their fellows' are told of.
FOUND_SHARE = 0.9
# The same as long as a rise is held that was found where production is observed. With all of them a quarter of slow wear waited for more
# than a month.
PRODUCTION_FOUND_SHARE = 5.0 / 6.0
# The same where no change was ever found. The filter lets wear of such a joint wander by little, and noise that lasts for months, or a
# sensor that drifts, is what it follows.
UNFOUND_SHARE = 1.18
PRODUCTION_SIGMAS = 4.0  # of a rise that production alone may raise as an advisory; a smaller one asks for a replay
MIN_WEAR_STD = 1e-9  # keeps the number of standard deviations finite
MIN_JOINTS_TOGETHER = 3  # two joints that rise do not show whether they rise for a common cause


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WearAfterReplay:
    """Estimated wear after a replay, and what the replay counts for, (N,) each: N joints of A arms, arm by arm."""

    wear: Array  # logarithm of friction torque over the lowest that the joint surely held
    wear_std: Array
    known: np.ndarray  # whether any replay has updated the joint
    usable: np.ndarray  # whether this replay counts, for or against a change
    day: Array  # UTC day of the replay, counted from 1970-01-01
    agreeing: Array  # replays, this one included, that are known to agree with it
    interval_days: Array  # usual time between replays [d]
    changed: np.ndarray  # whether a change was found since the joint was new; True in beliefs of releases that did not remember it
    risen: np.ndarray | None = None  # whether a rise was found and is held; None: the arm's production is not observed
    channels: ChannelRise | None = None  # what the channels beside F(v*) found; None: there are none
    # None of the following is 0: wear then counts from the beginning, and no joint ever changed together with the others
    fallen: Array | None = None  # logarithm of that lowest friction over that at the beginning, ≤ 0, running-in left out
    fallen_std: Array | None = None
    shared: Array | None = None  # what the joint changed together with most joints of its arm; not part of `wear`
    shared_std: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Counts:
    """Consecutive replays that agree, their UTC days, and the last of these days: (N, 4) for the joints, (A,) for the arms."""

    replays: Array
    days: Array
    last_day: Array
    arm_replays: Array
    arm_days: Array
    arm_last_day: Array


class Evidence(NamedTuple):
    """What the replays so far say about changed friction."""

    counts: Counts  # this replay included
    excess: Array  # (N,) wear beyond the common rise of the arm's joints, logarithm
    common: Array  # (A,) common rise of the arm's joints, logarithm; 0 where there is none
    fallen: Array  # (A,) common fall of the arm's joints, logarithm, negative; 0 where there is none
    above: Array  # (N, 3) probability that the excess is above the rise of each tier
    below: Array  # (N,) probability that friction fell by more than the wear tier's rise, beyond the common fall
    sigmas: Array  # (N,) the excess in standard deviations
    raises: Array  # (N,) index of the highest tier that may be raised; −1: none
    falls: np.ndarray  # (N,) whether fallen friction may be raised
    together: np.ndarray  # (A,) whether a common rise or fall may be raised
    risen: Array  # (N,) friction above the lowest held, what the joint changed together with the others included, logarithm
    fall: Array  # (N,) friction over that at the beginning, logarithm, without running-in and without what joints changed together
    channels: ChannelRise | None = None  # what the channels beside F(v*) found


def nothing_counted(joints: int, arms: int) -> Counts:
    """The counts before the first replay; `joints` is N."""
    return Counts(
        replays=np.zeros((joints, COLUMNS)),
        days=np.zeros((joints, COLUMNS)),
        last_day=np.full((joints, COLUMNS), -1.0),
        arm_replays=np.zeros(arms),
        arm_days=np.zeros(arms),
        arm_last_day=np.full(arms, -1.0),
    )


def counts_of(health: Health) -> Counts:
    """The counts of one arm from its health."""
    rows = [[*joint.rising, joint.falling] for joint in health.joints]
    return Counts(
        replays=np.array([[float(each.replays) for each in row] for row in rows]),
        days=np.array([[float(each.days) for each in row] for row in rows]),
        last_day=np.array([[float(each.last_day) for each in row] for row in rows]),
        arm_replays=np.array([float(health.common.replays)]),
        arm_days=np.array([float(health.common.days)]),
        arm_last_day=np.array([float(health.common.last_day)]),
    )


def wear_after_replay(belief: Belief, usable: np.ndarray) -> WearAfterReplay:
    """The wear of one arm after the belief's last replay; usable : (J,) as in `WearAfterReplay`."""
    return wear_of_state(belief.filter_state, usable, math.floor(belief.at_unix_s / DAY_S))


def wear_of_state(state: FilterState, usable: np.ndarray, day: float) -> WearAfterReplay:
    """The wear of the N joints of a filter state after a replay; usable : (N,), day : as in `WearAfterReplay`, the same for all joints."""
    reference = state.counted_from
    return WearAfterReplay(
        wear=state.wear,
        wear_std=state.wear_std,
        known=state.replays > 0,
        usable=usable,
        day=np.full(state.joints, float(day)),
        agreeing=state.agreeing,
        interval_days=state.interval_days,
        changed=state.chance.since < state.replays,
        risen=None if state.sources is None else state.sources.risen > 0,
        channels=channel_rise(state.channels),
        fallen=reference.fallen,
        fallen_std=np.sqrt(reference.fallen_var),
        shared=reference.shared,
        shared_std=np.sqrt(reference.shared_var),
    )


def advisory_sigmas(joints: int, settings: HealthSettings) -> float:
    """The standard deviations that wear must exceed, so that an arm of `joints` healthy joints causes no more advisories than allowed.

    A smooth Gaussian process that crosses its mean upwards f₀ times a year crosses z of its standard deviations f₀·exp(−z²/2) times
    (Rice, 1945).
    """
    return math.sqrt(2.0 * math.log(max(joints * CROSSINGS_PER_YEAR / settings.false_alarms_per_year, 2.0)))


def weigh_evidence(after: WearAfterReplay, before: Counts, joints_per_arm: int, settings: HealthSettings) -> Evidence:
    """The evidence after a replay; before : the counts after the replay before."""
    J, wear, std = joints_per_arm, after.wear, np.maximum(after.wear_std, MIN_WEAR_STD)
    zero = np.zeros(len(wear))
    shared = zero if after.shared is None else after.shared
    risen, risen_std = wear + shared, std if after.shared_std is None else np.hypot(std, after.shared_std)
    fall = wear if after.fallen is None else wear + after.fallen
    fall_std = std if after.fallen_std is None else np.hypot(std, after.fallen_std)
    least_fall = math.log1p(-settings.wear_rise)  # a common fall is reported from where the fall of one joint is
    least_rise = math.log1p(settings.advisory_rise)
    common = _common_rise(risen, risen_std, after.known, J, settings, least_rise)
    fallen = -_common_rise(-(fall + shared), np.hypot(fall_std, risen_std), after.known, J, settings, -least_fall)
    if after.shared is not None and after.shared_std is not None:  # most joints changed together, though not all of them as much
        largest = _largest_shared(shared, np.maximum(after.shared_std, MIN_WEAR_STD), J, settings)
        fallen = np.where((fallen == 0.0) & (largest <= least_fall), largest, fallen)
        common = np.where((common == 0.0) & (fallen == 0.0) & (largest >= least_rise), largest, common)
    excess, rises = wear - not_of_one_joint(wear, shared, after.known, J, settings.common_share), np.log1p(settings.rises)
    sigmas = excess / std
    above = scipy.special.ndtr((excess[:, None] - rises) / std[:, None])  # (N, 3)
    below = scipy.special.ndtr((least_fall + np.repeat(fallen, J) - fall) / fall_std)  # (N,)
    required = advisory_sigmas(J, settings)
    significant = sigmas >= required
    agree = np.empty((len(wear), COLUMNS), dtype=bool)
    agree[:, 0] = (sigmas >= required_of_joints(after, required)) & (excess >= rises[0])
    agree[:, 1] = significant & (above[:, 1] >= settings.wear_sure)
    agree[:, 2] = significant & (above[:, 2] >= settings.limit_sure)
    agree[:, FALLING] = below >= settings.wear_sure
    agree[:, :FALLING] |= channel_tiers(after.channels, excess, settings)

    counts = _counted(before, after, agree, (common > 0) | (fallen < 0))
    enough = (counts.replays >= settings.min_replays) & (counts.days >= settings.min_days)
    return Evidence(
        counts=counts,
        excess=excess,
        common=common,
        fallen=fallen,
        above=above,
        below=below,
        sigmas=sigmas,
        raises=np.max(np.where(enough[:, :FALLING], np.arange(FALLING), -1), axis=1),
        falls=enough[:, FALLING],
        together=(counts.arm_replays >= settings.min_replays) & (counts.arm_days >= settings.min_days),
        channels=after.channels,
        risen=risen,
        fall=fall,
    )


def required_of_joints(after: WearAfterReplay, required: float) -> Array:
    """(N,) standard deviations of wear that an advisory requires. required : after a change that was found some time ago.

    With replays alone, a rise needs less on the replay that finds it, where all replays since agree; later, when the size is known better,
    as much as any. Where production is observed replays are rare, and it needs less for as long as it is held.
    """
    if after.risen is not None:
        return np.where(after.risen, PRODUCTION_FOUND_SHARE * required, required)
    return required * np.where(after.agreeing >= LONG, FOUND_SHARE, np.where(after.changed, 1.0, UNFOUND_SHARE))


def _counted(before: Counts, after: WearAfterReplay, agree: np.ndarray, together: np.ndarray) -> Counts:
    """The counts with one more replay; agree : (N, 4) of the joints, together : (A,) of the arms."""
    arms = len(together)
    J = len(after.wear) // arms
    agreeing_days = np.maximum(1.0, np.round(after.agreeing * np.minimum(after.interval_days, 1.0)))
    replays, days, last_day = _count(
        (before.replays, before.days, before.last_day),
        agree,
        after.usable[:, None],
        after.day[:, None],
        (after.agreeing[:, None], agreeing_days[:, None]),
    )
    # as for a joint, an unusable replay neither confirms nor contradicts; a replay of an arm is usable where half of its joints are
    usable = 2 * after.usable.reshape(-1, J).sum(axis=1) >= J
    once = np.ones(arms)
    arm_replays, arm_days, arm_last_day = _count(
        (before.arm_replays, before.arm_days, before.arm_last_day), together, usable, after.day[::J], (once, once)
    )
    return Counts(
        replays=replays, days=days, last_day=last_day, arm_replays=arm_replays, arm_days=arm_days, arm_last_day=arm_last_day
    )  # fmt: skip


def _count(
    before: tuple[Array, Array, Array], agree: np.ndarray, usable: np.ndarray, day: Array, weight: tuple[Array, Array]
) -> tuple[Array, Array, Array]:
    """Replays, days and last day with one more replay: the counts grow where it agrees and begin again where it does not.

    weight : replays and days that the replay counts for.
    """
    replays, days, last = before
    more, gone = agree & usable, ~agree & usable
    new_days = np.where(gone, 0.0, days + (more & (last != day)) * weight[1])
    return np.where(gone, 0.0, replays + more * weight[0]), new_days, np.where(gone, -1.0, np.where(more, day, last))


def raised_by_production(evidence: Evidence) -> Array:
    """(N,) the tiers to which production alone may raise an alert; −1: none.

    It raises an advisory at most, and that only where it is surer than a replay needs to be: what changes the production changes friction
    too. Whatever the evidence would raise beyond that, one replay shall confirm.
    """
    advisory: Array = np.where(evidence.sigmas >= PRODUCTION_SIGMAS, np.minimum(evidence.raises, 0), -1)
    return advisory


def not_of_one_joint(wear: Array, shared: Array, known: np.ndarray, joints_per_arm: int, share: float) -> Array:
    """(N,) the part of each joint's wear that most joints of its arm have too, logarithm, ≥ 0.

    share : of the joints that is most of them; two thirds, so that the rise of two in six is theirs, however large. A joint whose part
    of a common change was taken for wear of its own, because it was detected before that of the others, has as much of it left as they
    have had.
    """
    J = joints_per_arm
    risen = np.where(known, wear + shared, np.nan).reshape(-1, J)
    count = known.reshape(-1, J).sum(axis=1)
    ordered = np.sort(risen, axis=1)  # NaN last
    at = np.clip(count - np.ceil(share * count - 1e-9), 0, J - 1).astype(int)
    most = np.where(count >= MIN_JOINTS_TOGETHER, ordered[np.arange(len(count)), at], 0.0)
    left: Array = np.maximum(np.repeat(np.maximum(most, 0.0), J) - np.maximum(shared, 0.0), 0.0)
    return left


def _largest_shared(shared: Array, std: Array, joints_per_arm: int, settings: HealthSettings) -> Array:
    """(A,) the largest common change of any joint of the arm that is sure, logarithm, of either sign; 0 where none is."""
    J = joints_per_arm
    sure = np.where(np.abs(shared) >= advisory_sigmas(J, settings) * std, shared, 0.0).reshape(-1, J)
    largest: Array = sure[np.arange(len(sure)), np.argmax(np.abs(sure), axis=1)]
    return largest


def _common_rise(wear: Array, std: Array, known: np.ndarray, joints_per_arm: int, settings: HealthSettings, least: float) -> Array:
    """(A,) rise of most joints of an arm together, logarithm; 0 where there is none, or where it is below `least`."""
    known = known.reshape(-1, joints_per_arm)
    shown = np.where(known, wear.reshape(-1, joints_per_arm), np.nan)
    count = known.sum(axis=1)
    rising = (scipy.special.ndtr((wear / std).reshape(-1, joints_per_arm)) >= settings.common_sure) & known
    shift = np.zeros(len(count))
    together = (count >= MIN_JOINTS_TOGETHER) & (rising.sum(axis=1) >= settings.common_share * count)
    if together.any():
        shift[together] = np.nanmedian(shown[together], axis=1)
    return np.where(shift >= least, shift, 0.0)
