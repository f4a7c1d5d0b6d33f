"""How soon the monitor detects wear of one joint, and how often it raises an alert of an arm that does not wear."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from monitor.judge.alerts.remaining_life import RemainingLife, remaining_life_of_joint
from monitor.judge.drift.step import DriftState
from monitor.judge.settings import AssessSettings
from monitor.recording import Array, known_or_none
from monitor.studies.figures import DAYS_A_YEAR, Figure, Rate, Share, median_bounds, over_arms, share_document
from monitor.studies.rehearsal.fleet import MEAN_DUTY, REVOLUTIONS_PER_DUTY_DAY, SCENARIOS, Day, FleetSettings, Wear
from monitor.studies.rehearsal.play import COMPARABLE, LEARNING_DAYS, Played, play

LATEST_ONSET = 425  # [day] false alerts are counted until then, and wear may begin on any day of that time
BASELINES = (LEARNING_DAYS, 100, 180, LATEST_ONSET)  # [day] before the onset: detection is reported for each span between them
GROUP = 1200  # arms with one kind of wear that are played at once: 0.5 GB
SOON_DAYS = 30  # within which a detection counts as soon


class Kind(NamedTuple):
    """One kind of wear, and the number of arms that have it."""

    label: str
    step: float  # fraction, at once
    per_year: float  # fraction, per year of mean work
    arms: int


class Part(NamedTuple):
    """Arms of one kind of wear that are played at once: memory limits how many."""

    kind: Kind
    arms: int
    seed: int


class Reported(NamedTuple):
    """What was reported of arms in which one joint wears, (A,) each [day]; infinite where nothing was reported."""

    onset: Array
    own: Array  # from the onset to the worn joint's first tier, that day included
    wear: Array  # likewise to its wear tier
    others: Array  # day of any other joint's first tier

    @classmethod
    def of(cls, played: Played, wear: Wear) -> "Reported":
        """Of a fleet that was played with this wear."""
        joint = wear.joint.astype(int)
        days = np.where(np.isnan(played.tier_day), np.inf, played.tier_day)  # (A, J, 3)
        own = days[np.arange(played.fleet.arms), joint]  # (A, 3)
        other = np.where(np.arange(days.shape[1]) == joint[:, None], np.inf, days[:, :, 0])
        since = own - wear.onset_day[:, None] + 1.0
        return cls(onset=wear.onset_day, own=since[:, 0], wear=since[:, 1], others=other.min(axis=1))

    @classmethod
    def together(cls, groups: Sequence["Reported"]) -> "Reported":
        """All arms of all groups."""
        return cls(*(np.concatenate(each) for each in zip(*groups, strict=True)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Delay:
    """Days from the onset to the first tier, over the arms that had no alert before; infinite where it never came."""

    arms: int
    median_days: float
    median_at_most: float  # one-sided 95 %, by order statistics
    p90_days: float
    within_30: Share
    by_baseline: tuple[tuple[int, int, Share], ...]  # from, to days before the onset: detected within 30 days
    right_joint: Share  # of the arms in which anything was reported
    wear_tier_median_days: float


def false_alarms(played: Played, scenario: str | None = None) -> Rate:
    """Alerts of arms without wear: the first rise to any tier and the first fall of every joint, the first common change of every arm."""
    mask = np.ones(played.fleet.arms, dtype=bool) if scenario is None else played.fleet.scenario == scenario
    events = np.isfinite(played.tier_day[mask][:, :, 0]).sum() + np.isfinite(played.falling_day[mask]).sum()
    events += np.isfinite(played.common_day[mask]).sum()
    return Rate(events=int(events), robot_years=float(mask.sum() * played.days / DAYS_A_YEAR))


def delay(reported: Reported) -> Delay:
    """How soon the worn joint was reported. Arms with an alert of it before the onset are left out: that is a false alert."""
    without_false_alert = ~(reported.own < 1)
    onset, days, wear_days, others = (each[without_false_alert] for each in reported)
    n = len(days)
    found = np.isfinite(days)
    wrong = (others >= onset) & (others < onset + days)
    return Delay(
        arms=n,
        median_days=float(np.median(days)) if n else np.inf,
        median_at_most=median_bounds(days)[1],
        p90_days=float(np.quantile(days, 0.9, method="higher")) if n else np.inf,
        within_30=Share(hits=int((days <= SOON_DAYS).sum()), of=n),
        by_baseline=tuple(
            (low, high, Share(hits=int((days[here] <= SOON_DAYS).sum()), of=int(here.sum())))
            for low, high in pairwise(BASELINES)
            for here in [(onset >= low) & (onset < high)]
        ),
        right_joint=Share(hits=int((found & ~wrong).sum()), of=int(found.sum())),
        wear_tier_median_days=float(np.median(wear_days)) if n else np.inf,
    )


def onsets(arms: int, seed: int, *, step: float = 0.0, per_day: float = 0.0, latest: int = LATEST_ONSET) -> Wear:
    """Wear of one joint in each arm, from a day drawn evenly between the end of learning and `latest`."""
    rng = np.random.default_rng(seed)
    return Wear(
        joint=rng.integers(0, 6, arms).astype(float),
        onset_day=rng.integers(LEARNING_DAYS, latest, arms).astype(float),
        step=np.full(arms, step),
        per_day=np.full(arms, per_day),
    )


def detected(base: FleetSettings, assess: AssessSettings, kind: Kind, seed: int) -> dict[str, Any]:
    """What was reported of one kind of wear, as a document."""
    return kind_document(kind, [play_part(base, assess, part) for part in parts(kind, seed)])


def parts(kind: Kind, seed: int) -> list[Part]:
    """The arms of one kind of wear, in parts of `GROUP` at most."""
    count = -(-kind.arms // GROUP)
    return [Part(kind, len(group), seed + 1000 * k) for k, group in enumerate(np.array_split(np.arange(kind.arms), count))]


class Covered(NamedTuple):
    """Share of 90 % intervals of friction that contained the truth in joints that wear, from the onset on."""

    worn: float  # on every day
    undetected: float  # until the joint's first tier


def play_part(base: FleetSettings, assess: AssessSettings, part: Part) -> tuple[Reported, Covered]:
    """What was reported of a part, and how often the intervals contained the truth."""
    kind, arms, seed = part
    wear = onsets(arms, seed, step=kind.step, per_day=kind.per_year / DAYS_A_YEAR)
    days = days_to_play(kind.step, kind.per_year)
    played = play(replace(base, arms=arms, days=days, seed=seed + 1, scenarios=COMPARABLE), assess, wear)
    return Reported.of(played, wear), Covered(played.covered_worn, played.covered_undetected)


def days_to_play(step: float, per_year: float) -> int:
    """So many days that a change of the last possible onset is detected in nearly every arm."""
    return LATEST_ONSET + (60 if step >= 0.05 else 120 if per_year >= 0.3 else 250)


def kind_document(kind: Kind, groups: Sequence[tuple[Reported, Covered]]) -> dict[str, Any]:
    """The detection of one kind of wear, from all its parts, as a document."""
    reported = Reported.together([group for group, _ in groups])
    covered = np.average([shares for _, shares in groups], axis=0, weights=[len(group.own) for group, _ in groups])
    return detection_row(kind.label, kind.step, kind.per_year, delay(reported), Covered(*map(float, covered)))


def detection_row(label: str, step: float, per_year: float, found: Delay, covered: Covered) -> dict[str, Any]:
    """The detection of one kind of wear, as a document."""
    return {
        "wear": label,
        "step": step,
        "per_year": per_year,
        "arms": found.arms,
        "median_days": known_or_none(found.median_days),
        "median_at_most_days": known_or_none(found.median_at_most),
        "p90_days": known_or_none(found.p90_days),
        "within_30_days": share_document(found.within_30),
        "by_baseline": [
            {"from_days": low, "to_days": high, "within_30_days": share_document(soon)} for low, high, soon in found.by_baseline if soon.of
        ],
        "right_joint": share_document(found.right_joint),
        "wear_tier_median_days": known_or_none(found.wear_tier_median_days),
        "interval_90": known_or_none(covered.worn),
        "interval_90_undetected": known_or_none(covered.undetected),
    }


# --- How good the predicted remaining life is, for arms that wear up to the limit along a straight, an exponential and a root path ---

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


class LifeAnswer(NamedTuple):
    """What the monitor predicted of one joint that wears, and the truth."""

    group: str | int  # path or number of the kind of wear
    share: float  # of life, when it was asked
    predicted: RemainingLife
    true_days: float
    arm: int = 0  # its number in the group

    @property
    def covered(self) -> bool | None:
        """Whether P10–P90 held the truth; None where there was no date. A bound that is not given is beyond every date."""
        early, late = self.predicted.p10_days, self.predicted.p90_days
        return None if early is None else early <= self.true_days <= (np.inf if late is None else late)

    @property
    def ratio(self) -> float:
        """P50 over the truth; NaN where there was no date, infinity where P50 is beyond 54 years."""
        if self.predicted.p10_days is None:
            return float("nan")
        return float("inf") if self.predicted.p50_days is None else self.predicted.p50_days / self.true_days

    @property
    def near(self) -> bool:
        """Whether P50 was within ALPHA of the truth."""
        return bool(abs(self.ratio - 1.0) <= ALPHA)


def life_documents(answers: Sequence[LifeAnswer]) -> list[dict[str, Any]]:
    """For each share of life: how often P10–P90 held the truth, P50 was near, the median of P50 over the truth, and no date was given."""
    rows = []
    for share in ASKED_AT:
        asked = [each for each in answers if each.share == share]
        dated = [each for each in asked if each.covered is not None]
        if asked:
            rows.append(
                {
                    "at_share_of_life": share,
                    "asked": len(asked),
                    "without_date": len(asked) - len(dated),
                    "p10_p90_holds": share_document(Share(hits=sum(bool(each.covered) for each in dated), of=len(dated))),
                    "p50_near": share_document(Share(hits=sum(each.near for each in dated), of=len(asked))),
                    "p50_over_truth": known_or_none(float(np.median([each.ratio for each in dated]))) if dated else None,
                }
            )
    return rows


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """How good remaining life was."""

    interval: Share  # P10–P90 contained the truth, at the half-life of straight paths
    alpha_lambda: Share  # P50 within 20 % of the truth, then
    without_date: int  # arms without a prediction, then
    by_path: tuple[dict[str, Any], ...]  # a document for each path and share of life


def life(arms: int, assess: AssessSettings, *, seed: int, per_year: tuple[float, float] = RATES_PER_YEAR, base: FleetSettings) -> Life:
    """α-λ (Saxena et al., 2008) with α = 0.2, and coverage of P10–P90, in revolutions; each arm is asked at two shares of its life.

    Joints wear up to the limit, on the mean `per_year` in a year of mean work: `arms` along a straight path, and half as many each along an
    exponential and a root path.
    """
    return summarise(job() for job in life_jobs(arms, assess, seed=seed, per_year=per_year, base=base))


def life_jobs(
    arms: int,
    assess: AssessSettings,
    *,
    seed: int,
    base: FleetSettings,
    per_year: tuple[float, float] = RATES_PER_YEAR,
    asked_at: tuple[float, ...] = ASKED_AT,
) -> list[Callable[[], Any]]:
    """The arms in groups with similar wear rates along the same path; each job returns the answers of its group."""
    rng = np.random.default_rng(seed)
    jobs: list[Callable[[], Any]] = []
    for path, many in ((STRAIGHT, arms), (EXPONENTIAL, arms // 2), (ROOT, arms // 2)):
        rates = np.sort(np.exp(rng.uniform(np.log(per_year[0]), np.log(per_year[1]), many))) / DAYS_A_YEAR  # per mean day of work
        for rate in np.array_split(rates, min(GROUPS, max(many // LEAST_GROUP, 1))):
            fleet = replace(base, arms=len(rate), seed=seed * 3 * GROUPS + len(jobs))
            jobs.append(partial(answers_of, path, rate, rng.integers(0, 6, len(rate)), assess, fleet, asked_at))
    return jobs


def summarise(groups: Iterable[list[LifeAnswer]]) -> Life:
    """The answers of all groups."""
    answers = [answer for group in groups for answer in group]
    half = [answer for answer in answers if (answer.group, answer.share) == (STRAIGHT, HALF_LIFE)]
    inside = [answer.covered for answer in half if answer.covered is not None]
    return Life(
        interval=Share(hits=sum(inside), of=len(inside)),
        alpha_lambda=Share(hits=sum(answer.near for answer in half), of=len(half)),
        without_date=len(half) - len(inside),
        by_path=tuple(
            {"path": path, **row}
            for path in (STRAIGHT, EXPONENTIAL, ROOT)
            for row in life_documents([answer for answer in answers if answer.group == path])
        ),
    )


def answers_of(
    path: str, rate: Array, joint: np.ndarray, assess: AssessSettings, base: FleetSettings, asked_at: tuple[float, ...] = ASKED_AT
) -> list[LifeAnswer]:
    """The answers of arms whose `joint` (A,) wears along a path that reaches the limit at a mean rate (A,) per mean day of work.

    asked_at : shares of life, ascending.
    """
    arms, rise = len(rate), assess.prognosis.limit_rise
    wear = wear_along(path, rate, joint, rise)
    answers: list[LifeAnswer] = []
    asked = np.zeros((arms, len(asked_at)), dtype=bool)

    def watch(_: int, now: Day, state: DriftState) -> None:
        lived = now.used_days * rate / rise  # share of life
        due = now.replayed[:, None] & ~asked & (lived[:, None] >= np.array(asked_at))
        for arm, k in np.argwhere(due).tolist():
            asked[arm, k] = True
            left = (1.0 - lived[arm]) * rise / rate[arm] * MEAN_DUTY * REVOLUTIONS_PER_DUTY_DAY
            n = arm * state.joints_per_arm + int(joint[arm])
            predicted = remaining_life_of_joint(state.friction, n + arm, assess.friction, assess.prognosis, assess.drift.wear_prior)
            answers.append(LifeAnswer(path, asked_at[k], predicted, float(left / state.usage.per_day[n]), arm))

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


# --- Would these thresholds detect wear, and how many false alerts would they raise? Every figure of a simulated fleet, as one document ---

FEWEST_ARMS = 12  # of any kind of wear

Each = Callable[[Callable[[Any], Any], list[Any]], Iterable[Any]]
"""`map`, or that of a pool of processes."""


def rehearse(
    assess: AssessSettings,
    *,
    arms: int,
    seed: int = 0,
    between_std: float = 0.02,
    robot: str = "ur5",
    lives: int | None = None,
    steps: int | None = None,
    each: Each = map,
) -> dict[str, Any]:
    """False alerts, detection delays, coverage and the quality of remaining life, as one document. `each` does not change it.

    lives : arms that are asked for their remaining life; None: half of `arms`.
    steps : arms with a 5 % step; None: `arms`.
    """
    base = FleetSettings(
        arms=arms, seed=seed, between_std=between_std, robot=robot, reference_speed_rad_s=assess.drift.reference_speed_rad_s
    )
    few = max(arms // 3, FEWEST_ARMS)
    kinds = [
        Kind("2 % step", 0.02, 0.0, few),
        Kind("5 % step", 0.05, 0.0, arms if steps is None else steps),  # its share within 30 days is compared with 99 %
        Kind("5 %/year", 0.0, 0.05, few),
        Kind("10 %/year", 0.0, 0.10, few),
        Kind("30 %/year", 0.0, 0.30, few),
        Kind("100 %/year", 0.0, 1.00, few),
    ]
    every_part = [part for kind in kinds for part in parts(kind, seed + 1)]
    asked = max(arms // 2 if lives is None else lives, FEWEST_ARMS)
    jobs = [partial(quiet_document, base, assess), *(partial(play_part, base, assess, part) for part in every_part)]
    jobs += life_jobs(asked, assess, seed=seed + 3, base=base)
    quiet, *rest = each(_done, jobs)
    reported = list(zip(every_part, rest[: len(every_part)], strict=True))
    life = summarise(rest[len(every_part) :])
    return {
        **quiet,
        "detection": [kind_document(kind, [group for part, group in reported if part.kind == kind]) for kind in kinds],
        "remaining_life": {
            "p10_p90_holds": share_document(life.interval),
            "alpha_lambda_at_half_life": share_document(life.alpha_lambda),
            "without_date": life.without_date,
            "by_path": list(life.by_path),
        },
    }


def quiet_document(base: FleetSettings, assess: AssessSettings) -> dict[str, Any]:
    """The figures of a fleet without wear."""
    quiet = play(base, assess)
    left = np.abs(quiet.slope_error_per_k)  # (A, J)
    return {
        "robot_years": base.arms * quiet.days / DAYS_A_YEAR,
        "learning_days": LEARNING_DAYS,
        "while_learning": _rate_document(Rate(events=quiet.early, robot_years=base.arms * LEARNING_DAYS / DAYS_A_YEAR)),
        "between_std": base.between_std,
        "autocorrelation": base.autocorrelation,
        "false_alarms": {name or "all": _rate_document(false_alarms(quiet, name)) for name in (None, *SCENARIOS)},
        "false_wear_alerts": int(np.isfinite(quiet.tier_day[:, :, 1]).sum()),
        "friction_interval_90": _figure_document(over_arms(np.mean, quiet.covered)),
        "slope_left_per_k": {
            **_figure_document(over_arms(np.nanmean, left)),
            "nine_of_ten": known_or_none(float(np.nanquantile(left, 0.9))),
        },
    }


def _done(job: Callable[[], Any]) -> Any:
    """The result of a job: a function of the module, so that a pool of processes can call it."""
    return job()


def _figure_document(figure: Figure) -> dict[str, float | None]:
    return {name: known_or_none(value) for name, value in figure._asdict().items()}


def _rate_document(rate: Rate) -> dict[str, float]:
    return {"events": rate.events, "robot_years": rate.robot_years, "per_year": rate.per_year, "at_most": rate.at_most}
