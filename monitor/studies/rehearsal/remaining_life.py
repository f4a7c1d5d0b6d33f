"""How good the predicted remaining life is, for arms that wear up to the limit along a straight, an exponential and a root path."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from monitor.judge.alerts.remaining_life import remaining_life_of_joint
from monitor.judge.assess import AssessSettings
from monitor.judge.drift.step import DriftState
from monitor.recording import Array, known_or_none
from monitor.studies.figures import DAYS_A_YEAR, Share, share_document
from monitor.studies.rehearsal.fleet import MEAN_DUTY, REVOLUTIONS_PER_DUTY_DAY, Day, FleetSettings, Wear
from monitor.studies.rehearsal.play import COMPARABLE, play

RATES_PER_YEAR = (0.10, 0.60)  # mean rates up to the limit, between which they are drawn evenly in their logarithm
GROUPS = 5  # of arms that wear about as fast: those that wear fast need fewer days
LEAST_GROUP = 48  # arms
ONSET_DAY = 60.0
ALPHA = 0.2  # of the true remaining life: so far off P50 may be
HALF_LIFE = 0.5  # share of life, of which the limit is worn along a straight path
ASKED_AT = (HALF_LIFE, 0.75)  # shares of life at which an arm is asked
STRAIGHT, EXPONENTIAL, ROOT = "straight", "exponential", "root"
GROWTH = 3.0  # friction rises e³ = 20 times as fast at the limit as at the onset


def along(path: str, share: Array) -> Array:
    """The share of the limit that is worn at a share of life."""
    worn: dict[str, Array] = {STRAIGHT: share, EXPONENTIAL: np.expm1(GROWTH * share) / np.expm1(GROWTH), ROOT: np.sqrt(share)}
    return worn[path]


class Answer(NamedTuple):
    """What the monitor predicted of one arm."""

    path: str
    share: float  # of life, when it was asked
    near: bool  # P50 within ALPHA of the truth
    covered: bool | None  # P10–P90 contained the truth; None where there was no prediction
    ratio: float  # P50 over the truth; NaN where there was no prediction, infinity where P50 is beyond 54 years


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """How good remaining life was."""

    interval: Share  # P10–P90 contained the truth, at the half-life of straight paths
    alpha_lambda: Share  # P50 within 20 % of the truth, then
    no_trend: int  # arms without a prediction, then
    by_path: tuple[dict[str, Any], ...]  # a document for each path and share of life


def life(arms: int, assess: AssessSettings, *, seed: int, per_year: tuple[float, float] = RATES_PER_YEAR, base: FleetSettings) -> Life:
    """α-λ (Saxena et al., 2008) with α = 0.2, and coverage of P10–P90, in revolutions; each arm is asked at two shares of its life.

    Joints wear up to the limit, on the mean `per_year` in a year of mean work: `arms` along a straight path, and half as many each along an
    exponential and a root path.
    """
    return summarise(job() for job in life_jobs(arms, assess, seed=seed, per_year=per_year, base=base))


def life_jobs(
    arms: int, assess: AssessSettings, *, seed: int, base: FleetSettings, per_year: tuple[float, float] = RATES_PER_YEAR
) -> list[Callable[[], Any]]:
    """The arms in groups with similar wear rates along the same path; each job returns the answers of its group."""
    rng = np.random.default_rng(seed)
    jobs: list[Callable[[], Any]] = []
    for path, many in ((STRAIGHT, arms), (EXPONENTIAL, arms // 2), (ROOT, arms // 2)):
        rates = np.sort(np.exp(rng.uniform(np.log(per_year[0]), np.log(per_year[1]), many))) / DAYS_A_YEAR  # per mean day of work
        for rate in np.array_split(rates, min(GROUPS, max(many // LEAST_GROUP, 1))):
            fleet = replace(base, arms=len(rate), seed=seed * 3 * GROUPS + len(jobs))
            jobs.append(partial(answers_of, path, rate, rng.integers(0, 6, len(rate)), assess, fleet))
    return jobs


def summarise(groups: Iterable[list[Answer]]) -> Life:
    """The answers of all groups."""
    answers = [answer for group in groups for answer in group]
    half = [answer for answer in answers if (answer.path, answer.share) == (STRAIGHT, HALF_LIFE)]
    inside = [answer.covered for answer in half if answer.covered is not None]
    return Life(
        interval=Share(hits=sum(inside), of=len(inside)),
        alpha_lambda=Share(hits=sum(answer.near for answer in half), of=len(half)),
        no_trend=len(half) - len(inside),
        by_path=tuple(_document(answers, path, share) for path in (STRAIGHT, EXPONENTIAL, ROOT) for share in ASKED_AT),
    )


def _document(answers: list[Answer], path: str, share: float) -> dict[str, Any]:
    """The figures of one path at one share of life."""
    asked = [answer for answer in answers if (answer.path, answer.share) == (path, share)]
    inside = [answer.covered for answer in asked if answer.covered is not None]
    ratios = [answer.ratio for answer in asked if answer.covered is not None]
    return {
        "path": path,
        "at_share_of_life": share,
        "asked": len(asked),
        "no_trend": len(asked) - len(inside),
        "p10_p90_holds": share_document(Share(hits=sum(inside), of=len(inside))) if inside else None,
        "p50_over_truth": known_or_none(float(np.median(ratios))) if ratios else None,
    }


def answers_of(
    path: str, rate: Array, joint: np.ndarray, assess: AssessSettings, base: FleetSettings, asked_at: tuple[float, ...] = ASKED_AT
) -> list[Answer]:
    """The answers of arms whose `joint` (A,) wears along a path that reaches the limit at a mean rate (A,) per mean day of work.

    asked_at : shares of life, ascending.
    """
    arms, rise = len(rate), assess.prognosis.limit_rise
    wear = wear_along(path, rate, joint, rise)
    answers: list[Answer] = []
    asked = np.zeros((arms, len(asked_at)), dtype=bool)

    def watch(_: int, now: Day, state: DriftState) -> None:
        lived = now.used_days * rate / rise  # share of life
        due = now.replayed[:, None] & ~asked & (lived[:, None] >= np.array(asked_at))
        for arm, k in np.argwhere(due).tolist():
            asked[arm, k] = True
            left = (1.0 - lived[arm]) * rise / rate[arm] * MEAN_DUTY * REVOLUTIONS_PER_DUTY_DAY
            n = arm * state.joints_per_arm + int(joint[arm])
            answers.append(_answer(path, asked_at[k], state, n, left, assess))

    days = int(ONSET_DAY + asked_at[-1] * rise / rate.min()) + 30  # an arm may have worked less than the mean
    play(replace(base, days=days, scenarios=COMPARABLE), assess, wear, watch=watch)
    return answers


def wear_along(path: str, rate: Array, joint: np.ndarray, rise: float) -> Wear:
    """The wear of arms whose `joint` (A,) begins to wear on `ONSET_DAY`, and reaches `rise` at a mean rate (A,) per mean day of work."""
    return Wear(
        joint=joint.astype(float),
        onset_day=np.full(len(rate), ONSET_DAY),
        step=np.zeros(len(rate)),
        per_day=rate,
        path=lambda straight: rise * along(path, straight / rise),
    )


def _answer(path: str, share: float, state: DriftState, n: int, truth: float, assess: AssessSettings) -> Answer:
    """The monitor's prediction for joint n of the fleet against the true remaining revolutions."""
    predicted = remaining_life_of_joint(state, n, assess.drift, assess.prognosis)
    if predicted.p10_days is None:
        return Answer(path, share, near=False, covered=None, ratio=np.nan)
    usual = float(state.usage.per_day[n])
    middle, latest = (np.inf if days is None else days * usual for days in (predicted.p50_days, predicted.p90_days))
    near = abs(middle - truth) <= ALPHA * truth
    return Answer(path, share, bool(near), bool(predicted.p10_days * usual <= truth <= latest), middle / truth)
