"""How good the predicted remaining life is, for arms that wear at a constant rate up to the limit."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from monitor.assess import AssessSettings
from monitor.judge.alerts.remaining_life import remaining_life_of_joint
from monitor.judge.drift.step import DriftState
from monitor.recording import Array
from monitor.studies.figures import DAYS_A_YEAR, Share
from monitor.studies.rehearsal.fleet import MEAN_DUTY, REVOLUTIONS_PER_DUTY_DAY, Day, FleetSettings, Wear
from monitor.studies.rehearsal.play import COMPARABLE, play

RATES_PER_YEAR = (0.10, 0.60)  # between which the wear rates are drawn, evenly in their logarithm
GROUPS = 5  # of arms that wear about as fast: those that wear fast need fewer days
LEAST_GROUP = 48  # arms
ONSET_DAY = 60.0
ALPHA = 0.2  # of the true remaining life: so far off P50 may be
HALF_LIFE = 0.5  # of the limit is worn when an arm is asked


class Answer(NamedTuple):
    """What the monitor predicted of one arm at half-life."""

    near: bool  # P50 within ALPHA of the truth
    covered: bool | None  # P10–P90 contained the truth; None where there was no prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """How good remaining life was."""

    interval: Share  # P10–P90 contained the truth, at half-life
    alpha_lambda: Share  # P50 within 20 % of the truth, at half-life
    no_trend: int  # arms without a prediction


def life(arms: int, assess: AssessSettings, *, seed: int, per_year: tuple[float, float] = RATES_PER_YEAR, base: FleetSettings) -> Life:
    """α-λ (Saxena et al., 2008) with α = 0.2, and coverage of P10–P90, at half-life and in revolutions; each arm is asked once.

    Joints wear by a constant amount per revolution, `per_year` in a year of mean work. Half-life is where half of the limit is worn.
    """
    return summarise(job() for job in life_jobs(arms, assess, seed=seed, per_year=per_year, base=base))


def life_jobs(
    arms: int, assess: AssessSettings, *, seed: int, base: FleetSettings, per_year: tuple[float, float] = RATES_PER_YEAR
) -> list[Callable[[], Any]]:
    """The arms in groups with similar wear rates; each job returns the answers of its group."""
    rng = np.random.default_rng(seed)
    rates = np.sort(np.exp(rng.uniform(np.log(per_year[0]), np.log(per_year[1]), arms))) / DAYS_A_YEAR  # per mean day of work
    groups = np.array_split(rates, min(GROUPS, max(arms // LEAST_GROUP, 1)))
    return [
        partial(answers_of, rate, rng.integers(0, 6, len(rate)), assess, replace(base, arms=len(rate), seed=seed * GROUPS + k))
        for k, rate in enumerate(groups)
    ]


def summarise(groups: Iterable[list[Answer]]) -> Life:
    """The answers of all groups."""
    answers = [answer for group in groups for answer in group]
    inside = [answer.covered for answer in answers if answer.covered is not None]
    return Life(
        interval=Share(hits=sum(inside), of=len(inside)),
        alpha_lambda=Share(hits=sum(answer.near for answer in answers), of=len(answers)),
        no_trend=len(answers) - len(inside),
    )


def answers_of(rate: Array, joint: np.ndarray, assess: AssessSettings, base: FleetSettings) -> list[Answer]:
    """The answers at half-life of arms whose `joint` (A,) wears at a rate (A,) per mean day of work."""
    arms, rise = len(rate), assess.prognosis.limit_rise
    wear = Wear(joint=joint.astype(float), onset_day=np.full(arms, ONSET_DAY), step=np.zeros(arms), per_day=rate)
    answers: list[Answer] = []
    asked = np.zeros(arms, dtype=bool)

    def watch(_: int, now: Day, state: DriftState) -> None:
        worn = now.used_days * rate
        for arm in np.flatnonzero(now.replayed & ~asked & (worn >= HALF_LIFE * rise)).tolist():
            asked[arm] = True
            left = (rise - worn[arm]) / rate[arm] * MEAN_DUTY * REVOLUTIONS_PER_DUTY_DAY
            answers.append(_answer(state, arm * state.joints_per_arm + int(joint[arm]), left, assess))

    days = int(ONSET_DAY + HALF_LIFE * rise / rate.min()) + 30  # an arm may have worked less than the mean
    play(replace(base, days=days, scenarios=COMPARABLE), assess, wear, watch=watch)
    return answers


def _answer(state: DriftState, n: int, truth: float, assess: AssessSettings) -> Answer:
    """The monitor's prediction for joint n of the fleet against the true remaining revolutions."""
    predicted = remaining_life_of_joint(state, n, assess.drift, assess.prognosis)
    if predicted.p50_days is None or predicted.p10_days is None:
        return Answer(near=False, covered=None)
    usual = state.usage.per_day[n]
    latest = np.inf if predicted.p90_days is None else predicted.p90_days * usual
    near = abs(predicted.p50_days * usual - truth) <= ALPHA * truth
    return Answer(bool(near), bool(predicted.p10_days * usual <= truth <= latest))
