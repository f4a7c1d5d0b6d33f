"""Sudden changes among the last replays, by their generalised likelihood ratio (GLR).

Had wear jumped by ν, or had the wear rate changed by ν, at replay k, the filter's later innovations would contain G·ν. The score of such a
change is Σ G·ν/S and its information Σ G²/S over the innovations since (Willsky and Jones, 1976). Where one change explains the innovations
far better than chance does, the state takes it over with its size and uncertainty, back to when it began. This alone raises no alert.

Shapes: N joints, S states, W = WINDOW starts of a change, 2 kinds of change (a step of wear, a new wear rate), M = 2·W candidates.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from monitor.judge.drift.filter_state import (
    KINDS,
    LEVELS,
    NOISE,
    OLDEST,
    PRODUCTION_LEVEL,
    RATE,
    STATES,
    WEAR,
    WINDOW,
    FilterState,
    open_slot,
)
from monitor.judge.drift.from_fleet import noise_known
from monitor.judge.drift.kalman import symmetric
from monitor.judge.drift.noise.size import MOST_SIGMA
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.slots import SLOTS
from monitor.judge.drift.update.blame import common_changes, pool_over_arms
from monitor.judge.drift.update.innovation import Gate, Innovation, Noise
from monitor.judge.drift.update.outlier_run import ChangeSums, OutlierRun, outlier_run
from monitor.recording import Array

CLIPPED = 3.0  # [σ] a replay that is further from an estimated change makes its size less certain
# [σ] an outlier counts for a change with less the further out it is, and with no less than this; several in a row on one side count in full
CLIPPED_OUTLIER = 1.0
# [σ] by which outliers in a row must differ from a shock that fades away, where noise is Gaussian. Where one replay counts with less,
# because the tails are long, two of them must by as many times more: t₃ noise makes shocks of 5 σ, and the next ones come while they fade.
# The sum of more has shorter tails.
STAYS_SIGMA = 3.5
DENSE = 28  # none of the youngest starts is dropped: without a step's first replay, a step found a day late has 5 % less of its σ
RATE_REPLAYS = 20  # [replays] from this age on a new wear rate has a threshold of its own; before it, it is hardly distinct from a step
# [χ²] by which the threshold of a step is lower from the same age on, so that it is that of a rate: of what chance finds, hardly any is
# such a step. Not where production is observed, where the starts of an old step share their evidence: `summed_evidence`
OF_OLD_STEP = DriftSettings().shift_sigma ** 2 - DriftSettings().pace_sigma ** 2
# [χ²] The threshold of a step that began `LONG` replays ago or earlier is lower too where the joint's noise, by its present estimate, lies
# between these two: by a parabola in log σ², 1.9 at σ 3.9 %. Where noise is less, a step of 5 % is found within three weeks without; where
# it is more, chance alone finds what may be found. From the same age on an advisory needs less of its standard deviations, `FOUND_SHARE`: a
# younger step that is found by less has its alert later, if at all. Not where `KNOWN_NOISE` has it lower already
OF_NOISE = 4.4
NOISY_STD = 0.028, 0.054  # [log]
# [replays] from this age on that of a rate falls twice as fast with age: chance finds few rates that began months ago. Most of what it
# finds is a month old, where noise that lasts for days still looks like a rate
OLD_REPLAYS = 40
LEAST_SIGMA = 2.0  # [σ] lowest threshold at any age
# [χ²] by which every threshold is higher where replays come e times as often as daily. Twice as many are twice as many chances, which costs
# 2·ln 2 (Rice, 1945); and ages are counted in replays, so that old changes, which need less, are fewer days old. By trial, at σ 2 % and
# ρ 0.5 from one replay to the next: 0.06 and 0.08 false advisories a robot-year at four a day, 0.06 at one. Not where production is
# observed
OF_FREQUENT = 3.0
MOST_A_DAY = 4.0  # replays within minutes of each other, by somebody who watches, do not blind the filter for weeks
RATE_STD_PER_DAY = 0.01  # [1/day] prior standard deviation of a new wear rate, of its size
USUAL_RATE_PER_DAY = 0.003  # [1/day] the same where a change is looked for, 110 % a year: what rises by 400 % a year needs more evidence
EARLY_STEP = 0.15  # [log] so much is a change even among the first replays: neither noise nor running-in makes it in a week
STEP_STD = 0.2  # [log] prior standard deviation of a step
PRIOR_INFORMATION = np.array([STEP_STD, USUAL_RATE_PER_DAY])[:, None] ** -2  # (2, 1)
# [χ²] by which every threshold is lower in a young joint whose noise the fleet knows: 5.15 σ become 4.9. The thresholds cover what an arm
# does not know of its noise, and starts of 200 replays; of a young joint there are few starts.
KNOWN_NOISE = 2.5
# Where production is observed, the starts of a rise share its evidence: rare replays do not tell them apart, and none of them alone may be
# sure for weeks. With replays alone the sum finds nothing sooner at equal false alarms.
LONG = 28.0  # [observations] age from which starts are summed; younger ones are told apart, and a rise among them is a step
# [χ²] by which the thresholds of those are higher where production is observed: its noise lasts for days, has long tails and is not the
# judge's. Most false advisories where production is observed were steps of 3 to 5 % within three weeks, and a step of 5 % is found a day
# later for it.
OF_PRODUCTION = 2.5
SUMMED = 9.5  # [log] of the summed evidence from which a rise is found: by chance once in e^9.5 observations of a joint, 36 years
SUMMED_STD = np.array([0.1, 0.2 / 365.0])[:, None]  # (2, 1) [log, 1/day] prior standard deviations of a step and of a rate in that sum
RATES_PER_STEP = 3.0  # prior odds: joints begin to wear more often than they jump


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangeBank:
    """Every candidate change, with its evidence before this replay and with it."""

    responses: Array  # (N, 2, W, S) error that a unit change has left in the filter, before this replay's update
    ages: Array  # (N, W) [replays] since the change would have begun, ascending
    glr_score: Array  # (N, 2, W) Σ G·ν/S of the replays before, with ν clipped
    raw_glr_score: Array  # (N, 2, W) the same with ν in full
    information: Array  # (N, 2, W) Σ G²/S of the replays before
    effect: Array  # (N, 2, W) G: what a unit change adds to this replay's innovation
    glr_score_now: Array  # the same three with this replay
    raw_glr_score_now: Array
    information_now: Array

    @property
    def before(self) -> ChangeSums:
        """The sums of the replays before this one."""
        return ChangeSums(self.raw_glr_score, self.information)

    @property
    def now(self) -> ChangeSums:
        """The sums with this replay."""
        return ChangeSums(self.raw_glr_score_now, self.information_now)

    def after_update(self, K: Array, *, restarted: np.ndarray) -> "ChangeBank":
        """The bank after the filter's update with gain K (N, S). It is empty for the joints in `restarted` (N,), whose change was found."""
        product = self.effect[..., None] * K[:, None, None, :]
        responses = np.subtract(self.responses, product, out=product)  # in place: this is the largest array of a fleet
        if not restarted.any():
            return replace(self, responses=responses)
        responses[restarted] = 0.0
        empty = restarted[:, None, None]
        return replace(
            self,
            responses=responses,
            glr_score_now=np.where(empty, 0.0, self.glr_score_now),
            raw_glr_score_now=np.where(empty, 0.0, self.raw_glr_score_now),
            information_now=np.where(empty, 0.0, self.information_now),
        )


class Change(NamedTuple):
    """The state as if the changes that were found had been predicted; joints without one keep theirs."""

    mean: Array  # (N, S)
    cov: Array  # (N, S, S)
    of_baseline: np.ndarray  # (N,) a change so early that it belongs to the baseline: the level is unknown again
    of_wear: np.ndarray  # (N,) a change of wear or of its rate
    stepped: Array  # (N,) the part of it that is a step, log
    agreeing: Array  # (N,) number of replays that agree with this one: 1, or all since the change
    since: Array  # (N,) number of replays since the change, this one included: 1 where there is none
    common: np.ndarray  # (N,) a change that most joints of the arm had together: it is in the levels, and not in wear
    shared: Array  # (N,) the size of that change, log
    shared_var: Array  # (N,) its variance
    differing_var: Array  # (N,) by which the variance of this replay is larger, being one of outliers in a row that differ


def advance_bank(state: FilterState, innovation: Innovation, gate: Gate, counted: Array, settings: DriftSettings) -> ChangeBank:
    """The bank with the changes that may have begun at this replay, and with this replay's evidence. counted : (N,) `counted_sigma`."""
    bank = add_candidates(state, innovation.resolved)
    nu, S = innovation.value, innovation.var
    G = np.einsum("na,nkwa->nkw", innovation.row, bank.responses)
    beyond = np.abs(innovation.normalised) - settings.gate_sigma
    limit = np.where(gate.gated, np.clip(counted - beyond, CLIPPED_OUTLIER, counted), counted) * np.sqrt(S)
    clipped = np.clip(nu, -limit, limit)
    counts = innovation.resolved & ~innovation.settling
    gain = np.where(counts[:, None, None], G / S[:, None, None], 0.0)
    return replace(
        bank,
        effect=G,
        glr_score_now=bank.glr_score + gain * clipped[:, None, None],
        raw_glr_score_now=bank.raw_glr_score + gain * nu[:, None, None],
        information_now=bank.information + gain * G,
    )


def add_candidates(state: FilterState, resolved: np.ndarray) -> ChangeBank:
    """The bank with one start added, at this replay, and one older start dropped, for the joints in `resolved` (N,).

    The ages stay about geometric: the start is dropped that leaves the smallest gap for its age, so that a change is found with a small
    relative error of its age.
    """
    n = np.flatnonzero(resolved)
    ages = state.ages + resolved[:, None]
    gaps = (ages[:, 2:] - ages[:, :-2]) / ages[:, 1:-1]  # that dropping a start between the first and the last would leave
    gaps[:, :DENSE] = np.inf
    last = np.where(ages[:, -1:] > OLDEST, 0.0, np.inf)
    dropped = DENSE + 1 + np.argmin(np.concatenate([gaps, last], axis=1)[:, DENSE:], axis=1)  # (N,)
    # every start younger than the dropped one moves up by a place
    places = np.arange(WINDOW)
    source = np.where((places <= dropped[:, None]) & resolved[:, None], np.maximum(places - 1, 0), places)  # (N, W)
    ages = np.take_along_axis(ages, source, axis=1)
    ages[n, 0] = 0.0
    rows = (np.arange(len(ages))[:, None, None] * KINDS + np.arange(KINDS)[:, None]) * WINDOW + source[:, None, :]  # (N, 2, W)

    def moved(old: Array) -> Array:
        new: Array = np.take(old.reshape(rows.size, -1), rows.ravel(), axis=0).reshape(old.shape)
        new[n, :, 0] = 0.0
        return new

    responses = moved(state.responses)
    responses[n, 0, 0, WEAR] = 1.0
    responses[n, 1, 0, RATE] = 1.0
    responses[n, 1, 0, WEAR] = state.interval_days[n]  # a rate that began after the last replay has worked for one interval
    glr_score, raw_glr_score, information = moved(state.glr_scores), moved(state.raw_glr_scores), moved(state.glr_informations)
    return ChangeBank(
        responses=responses,
        ages=ages,
        glr_score=glr_score,
        raw_glr_score=raw_glr_score,
        information=information,
        effect=np.zeros_like(glr_score),
        glr_score_now=glr_score,
        raw_glr_score_now=raw_glr_score,
        information_now=information,
    )


def stays(bank: ChangeBank, innovation: Innovation, gate: Gate, noise: Noise, counted: Array) -> np.ndarray:
    """(N,) whether outliers in a row stay where a step leaves them, and do not fade away as noise of correlation ρ does after one shock.

    counted : (N,) `counted_sigma`: the tails of the noise.
    After a shock every replay is ρ times the one before, and what is left of it is new noise. The filter learned from none of them, so a
    step would be in each of them in full.
    """
    rho, noise_var = noise
    row, longer = np.arange(len(rho)), np.clip(gate.run_before, 1.0, DENSE - 1.0).astype(int)  # (N,) replays after the first
    nu, _ = bank.now.each_outlier(DENSE)  # (N, DENSE) youngest first
    total, first = np.cumsum(nu, axis=1)[row, longer], nu[row, longer]
    new = (total - first) - rho * (total - innovation.value)
    # of what belongs to each replay alone, the sum keeps ends and 1 − ρ of the middle
    var = longer * (1.0 - rho**2) * noise_var + ((longer - 1.0) * (1.0 - rho) ** 2 + 1.0 + rho**2) * innovation.within_var
    tails = 1.0 + (MOST_SIGMA / counted - 1.0) * np.sqrt(np.minimum(2.0 / longer, 1.0))
    stay: np.ndarray = np.sign(gate.run) * new > STAYS_SIGMA * tails * np.sqrt(var)
    return stay


class JointNoise(NamedTuple):
    """What thresholds know of the joints' noise, (N,) each."""

    known: Array  # `noise_known`
    var: Array  # between replays [log²]
    interval_days: Array  # usual time between replays


def joint_noise(state: FilterState, var: Array, settings: DriftSettings) -> JointNoise:
    """That of a state, where the noise between replays has the variance `var` (N,)."""
    return JointNoise(noise_known(state, settings.prior), var, state.interval_days)


def detect_change(
    state: FilterState,
    bank: ChangeBank,
    innovation: Innovation,
    gate: Gate,
    noise: Noise,
    slot: Array,
    joints_per_arm: int,
    settings: DriftSettings,
    same_mass: np.ndarray | None = None,
) -> Change:
    """Which joints have changed, and their state with the change taken over. noise : between replays; same_mass : as in `update_filter`.

    A single outlier never proves a change. `gate_run` outliers in a row on one side always do, from the first of them on.
    """
    N = state.joints
    in_a_row = gate.in_a_row
    # outliers before this one were not learned from, but they are replays since the baseline
    since = state.replays + np.where(in_a_row, gate.run_before, 0.0)
    # a change needs several replays; one that began while hardly anything was known belongs to the baseline, unless it is large
    large = in_a_row & (np.abs(innovation.value) >= EARLY_STEP)
    baseline = np.where(large, settings.gate_run, settings.baseline_replays)
    enough = (bank.ages >= settings.gate_run - 1) & (bank.ages <= (since - baseline)[:, None])
    glr_score = np.where(in_a_row[:, None, None], bank.raw_glr_score_now, bank.glr_score_now)
    expected = bank.information_now * state.chance.of_starts()  # mean square of a score where nothing changed
    of_joint, beside_production = joint_noise(state, noise.var, settings), state.sources is not None
    ratios, relative = likelihood_ratios(
        glr_score, expected, bank.information_now, bank.ages, enough, settings, of_joint, beside_production=beside_production
    )
    counts = innovation.resolved & ~innovation.settling
    sure = np.max(relative, axis=(1, 2)) > 1.0
    if beside_production:
        old = enough & (bank.ages >= LONG)
        sure |= summed_evidence(bank.glr_score_now, bank.information_now, state.chance.of_starts(), bank.ages, old) > SUMMED
    found = (sure | in_a_row) & counts & (in_a_row | ~gate.gated)
    of_baseline = found & ~np.any(ratios > 0, axis=(1, 2))
    common = common_changes(
        found & ~of_baseline,
        relative,
        np.where(gate.gated[:, None, None], bank.raw_glr_score_now, bank.glr_score_now),
        expected,
        bank.responses[..., WEAR] / np.maximum(bank.information_now, 1e-12),
        counts,
        joints_per_arm,
        same_mass,
    )
    of_baseline &= ~common
    of_wear = (found & ~of_baseline) | common
    ratios = pool_over_arms(ratios, common, joints_per_arm)
    mean, cov = state.mean, state.cov
    if of_baseline.any():
        fresh = open_slot(state, slot, of_baseline)
        mean, cov = fresh.mean, fresh.cov
    taken = Taken(mean, cov, *np.zeros((5, N)))
    if of_wear.any():
        # where production is observed, the outlier before may be the other source's, and nothing is taken off
        length = np.where(in_a_row & (state.sources is None), np.minimum(np.abs(gate.run), DENSE), 0.0)
        n = np.flatnonzero(of_wear)
        run = outlier_run(
            bank.before.of_joints(n),
            bank.effect[n],
            bank.responses[n],
            bank.ages[n],
            Innovation(*(each[n] for each in innovation)),
            Noise(*(each[n] for each in noise)),
            length[n],
            state.interval_days[n],
        )
        taken = change_posterior(mean, cov, bank, ratios, innovation, run, of_wear, common, in_a_row)
    since = 1.0 + taken.age
    agreeing = np.where(common, 1.0, since)  # it is none of the joint
    return Change(
        mean=taken.mean,
        cov=taken.cov,
        of_baseline=of_baseline,
        of_wear=of_wear,
        stepped=taken.stepped,
        agreeing=agreeing,
        since=since,
        common=common,
        shared=taken.shared,
        shared_var=taken.shared_var,
        differing_var=taken.differing_var,
    )


def likelihood_ratios(
    glr_score: Array,
    expected: Array,
    information: Array,
    ages: Array,
    enough: np.ndarray,
    settings: DriftSettings,
    noise: JointNoise,
    *,
    beside_production: bool = False,
    of_production: float = OF_PRODUCTION,
) -> tuple[Array, Array]:
    """The likelihood ratio of each candidate, and its ratio to the threshold, (N, 2, W) each; 0 where `enough` is False.

    expected : (N, 2, W) mean square of the score where nothing changed. information : (N, 2, W) of the score. enough : (N, W) whether a
    start has enough replays before it and since. beside_production : whether production is observed beside replays; of_production : [χ²]
    by which the thresholds of young candidates are then higher.

    The size of a change has a prior. What is compared with the threshold is the ratio of the likeliest size under it, with 1/σ² of the
    prior beside the information. A few replays that noise lines up fit a wear rate of several hundred per cent a year best, and few joints
    wear so.

    Innovations since n replays are a mean of n: chance carries it across z standard deviations n times less often, at the rate
    e^(−z²/2)/n (Rice, 1945). So that false detections are about as frequent at every age, the threshold falls with age.
    """
    ratio = np.where(enough[:, None, :], glr_score**2 / np.maximum(expected, 1e-12), 0.0)
    with_prior = 1.0 + PRIOR_INFORMATION / np.maximum(information, 1e-9)
    return ratio, ratio / with_prior / thresholds(ages, settings, noise, beside_production=beside_production, of_production=of_production)


def summed_evidence(glr_score: Array, information: Array, inflation: Array, ages: Array, enough: np.ndarray) -> Array:
    """(N,) [log] evidence for a rise that began at any start, over no change; −∞ where no start has told anything.

    It is the statistic of Shiryaev and Roberts, the sum of the Bayes factors of all starts: under no change its mean grows by 1 with every
    observation, for a step and for a rate each. The size of a rise is a priori half of a Gaussian. glr_score, information, inflation :
    (N, 2, W), of the variance by chance; ages : (N, W); enough : (N, W) as in `likelihood_ratios`. A candidate stands for every start up to
    the next older one.
    """
    score, told = glr_score / inflation, information / inflation
    precision = told + SUMMED_STD**-2.0
    span = np.diff(ages, axis=1, append=ages[:, -1:] + 1.0)
    positive = math.log(2.0) + scipy.special.log_ndtr(score / np.sqrt(precision))
    factor = 0.5 * score**2 / precision - 0.5 * np.log(SUMMED_STD**2 * precision) + positive + np.log(np.maximum(span, 1.0))[:, None]
    summed: Array = scipy.special.logsumexp(np.where(enough[:, None] & (information > 0), factor, -np.inf), axis=(1, 2))
    return summed


def thresholds(
    ages: Array, settings: DriftSettings, noise: JointNoise, *, beside_production: bool = False, of_production: float = OF_PRODUCTION
) -> Array:
    """(N, 2, W) the likelihood ratio from which a candidate of an age (N, W) is a change. The others are as in `likelihood_ratios`."""
    log_age = np.log(np.maximum(ages, 1.0))
    known, alone = noise.known[:, None], not beside_production
    frequent = OF_FREQUENT * np.log(np.clip(1.0 / noise.interval_days[:, None], 1.0, MOST_A_DAY))
    by_age = 2.0 * log_age + KNOWN_NOISE * known - (frequent if alone else of_production * (ages < LONG))
    least, most = np.square(NOISY_STD)
    noisy = np.clip(noise.var[:, None], least, most)
    of_noise = np.where(ages >= LONG, OF_NOISE * np.log(noisy / least) * np.log(most / noisy) * (1.0 - known), 0.0)
    of_old = np.where((ages >= RATE_REPLAYS) & alone, OF_OLD_STEP + of_noise, 0.0)
    of_step = settings.shift_sigma**2 - of_old
    of_rate = np.where(ages >= RATE_REPLAYS, settings.pace_sigma, settings.shift_sigma) ** 2
    of_rate -= 2.0 * np.maximum(log_age - math.log(OLD_REPLAYS), 0.0)
    lowest: Array = np.maximum(np.stack([of_step - by_age, of_rate - by_age], axis=1), LEAST_SIGMA**2)
    return lowest


class Taken(NamedTuple):
    """What a state takes over of its changes."""

    mean: Array  # (N, S)
    cov: Array  # (N, S, S)
    stepped: Array  # (N,) the part that is a step, log
    age: Array  # (N,) [replays] of the likeliest change
    shared: Array  # (N,) the part that went to the levels, because most joints had it, log
    shared_var: Array  # (N,) its variance
    differing_var: Array  # (N,) as in `Change`


def change_posterior(
    mean: Array,
    cov: Array,
    bank: ChangeBank,
    ratios: Array,
    innovation: Innovation,
    run: OutlierRun,
    found: np.ndarray,
    common: np.ndarray,
    in_a_row: np.ndarray,
) -> Taken:
    """Mean and covariance as if the changes in `found` (N,) had been predicted; those in `common` (N,) as changes of the levels.

    run : of the joints in `found`.

    Which change it was, and since when, is as uncertain as the candidates' likelihoods say: the state takes over their mean and the spread
    between them. This replay is left to the update that follows; where it disagrees with the estimated size, the variance of the size grows
    until it agrees. Of outliers in a row that differ, that of the replay grows, `differing_var`, and that of the size by a share of it.
    """
    n = np.flatnonzero(found)
    M = KINDS * WINDOW
    prior_std = np.repeat([STEP_STD, RATE_STD_PER_DAY], WINDOW)  # (M,)
    before = run.left_of(bank.before.of_joints(n), run.before)
    precision = before.information.reshape(-1, M) + np.repeat(np.array([STEP_STD, RATE_STD_PER_DAY]) ** -2, WINDOW)  # (n, M)
    alone = (in_a_row & ~common)[n]  # a common change has the ratios of all joints
    ratio = np.where(alone[:, None, None], of_run(ratios[n], bank.now.of_joints(n), run), ratios[n]).reshape(-1, M)
    weight = candidate_weights(ratio, before.information.reshape(-1, M), precision, bank.ages[n], prior_std)
    # where innovations were clipped, the size lies between the clipped and the full estimate
    clipped, full = bank.glr_score[n].reshape(-1, M) / precision, before.score.reshape(-1, M) / precision
    clipped = np.where(in_a_row[n, None], full, clipped)  # outliers in a row count in full
    size = 0.5 * (clipped + full)
    effect, last_effect = bank.effect[n].reshape(-1, M), run.last_effect.reshape(-1, M)
    changed, changed_before = (np.einsum("nm,nm->n", weight * size, each) for each in (effect, last_effect))

    def beside_noise(phi: Array) -> tuple[Array, Array, Array]:
        """(n,) what this replay says beside the noise that the one before has shown, what the change leads to expect, and the variance."""
        return innovation.value[n] - phi * run.nu, changed - phi * changed_before, innovation.var[n] - phi**2 * run.var

    said, expected, S = beside_noise(run.phi)
    # Outliers in a row that differ by more than noise do not show what lasts of it, and none of them says more of the size than another.
    # Not so where this one says less than expected, on the same side: it is what follows on a shock that fades
    differing = alone & (run.length > 1.0) & ((said - expected) ** 2 > CLIPPED**2 * S) & (said * (expected - said) < 0)
    run = run._replace(phi=np.where(differing, 0.0, run.phi))
    said, expected, S = beside_noise(run.phi)
    surplus = np.maximum((said - expected) ** 2 - CLIPPED**2 * S, 0.0)
    seen = run.phi[:, None] * last_effect
    g = bank.responses[n].reshape(len(n), M, -1).copy()  # (n, M, S)
    g[..., NOISE] -= seen
    g, to_level = to_levels(g, common[n])
    moved = g * size[:, :, None]
    shift = np.einsum("nm,nms->ns", weight, moved)
    best = np.argmax(weight, axis=1)
    row = np.arange(len(n))
    gain = (effect - seen)[row, best]
    wider = surplus / np.where(differing, run.length, np.maximum(gain**2, 1e-12))
    var = 1.0 / precision + 0.25 * (full - clipped) ** 2
    var[row, best] += np.minimum(wider, np.where(best < WINDOW, STEP_STD, RATE_STD_PER_DAY) ** 2) / np.maximum(weight[row, best], 0.1)
    away = moved - shift[:, None, :]
    spread = np.einsum("nm,nms,nmt->nst", weight * var, g, g) + np.einsum("nm,nms,nmt->nst", weight, away, away)
    known, known_cov = run.with_noise_seen(mean[n], cov[n])
    mean, cov = mean.copy(), cov.copy()
    mean[n] = known + shift
    cov[n] = known_cov + symmetric(spread)
    stepped, age, shared, shared_var, differing_var = np.zeros((5, len(mean)))
    stepped[n] = np.where(common[n], 0.0, (weight * size)[:, :WINDOW].sum(axis=1))
    age[n] = bank.ages[n, best % WINDOW]
    shared[n] = np.sum(weight * size * to_level, axis=1)
    shared_var[n] = np.sum(weight * (var * to_level**2 + (size * to_level - shared[n, None]) ** 2), axis=1)
    differing_var[n] = np.where(differing, surplus, 0.0)
    return Taken(mean, cov, stepped, age, shared, shared_var, differing_var)


def of_run(ratios: Array, counted: ChangeSums, run: OutlierRun) -> Array:
    """The likelihood ratios (n, 2, W) of joints whose last replays are outliers in a row, by what these say together.

    counted : with this replay, as if each of them were alone.
    """
    now = run.left_of(counted, run.now)
    some = (ratios > 0) & (counted.score != 0.0)
    share = (now.score / np.where(some, counted.score, 1.0)) ** 2 * counted.information / np.maximum(now.information, 1e-12)
    return np.where(some, ratios * share, ratios)


def to_levels(g: Array, common: np.ndarray) -> tuple[Array, Array]:
    """The responses g (n, M, S) with the wear of the joints in `common` (n,) in every level instead, and that wear (n, M).

    The rate of such a change is left out: the arm begins anew at the level that it has now. If it goes on, that is detected again.
    """
    wear = np.where(common[:, None], g[..., WEAR], 0.0)
    moved = g.copy()
    moved[..., LEVELS : LEVELS + SLOTS] += wear[..., None]
    if g.shape[-1] > STATES:
        moved[..., PRODUCTION_LEVEL] += wear
    moved[common, :, WEAR] = 0.0
    moved[common, :, RATE] = 0.0
    return moved, wear


def candidate_weights(ratio: Array, information: Array, precision: Array, ages: Array, prior_std: Array) -> Array:
    """(n, M) posterior probability of each candidate, given that one of those with a positive ratio is true.

    ratio, information, precision : (n, M); ages : (n, W); prior_std : (M,). A candidate stands for every start up to the next older one.

    What the replays say little of, as of a change that began with the baseline, has the evidence of a size that the prior allows.
    """
    span = np.tile(np.diff(ages, axis=1, append=ages[:, -1:] + 1.0), KINDS)
    evidence = 0.5 * ratio * information / precision + np.log(np.maximum(span, 1.0) / np.sqrt(precision)) - np.log(prior_std)
    evidence += np.repeat([0.0, math.log(RATES_PER_STEP)], WINDOW)
    evidence = np.where(ratio > 0, evidence, -np.inf)
    weight = np.exp(evidence - evidence.max(axis=1, keepdims=True))
    posterior: Array = weight / weight.sum(axis=1, keepdims=True)
    return posterior
