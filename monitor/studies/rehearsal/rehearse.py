"""Would these thresholds catch wear, and how often would they cry wolf? A simulated fleet through the filter and the tiers of `judge`.

The same functions judge the daemon's one arm; here they run on the arrays of a whole fleet. Learning days are left out of every figure.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from monitor.assess import AssessSettings
from monitor.judge.alerts.evidence import Counts, Evidence, WearAfterReplay, nothing_counted, weigh_evidence
from monitor.judge.alerts.remaining_life import remaining_life
from monitor.judge.drift.filter_state import RATE, WEAR, FilterState
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.drift.undetected_change import undetected_change
from monitor.recording import Array
from monitor.studies.figures import NINETY, Figure, Rate, Share, over_arms
from monitor.studies.rehearsal.fleet import MEAN_DUTY, REVOLUTIONS_PER_DUTY_DAY, SCENARIOS, Day, Fleet, FleetSettings, Wear

LEARNING_DAYS = 60
LATEST_ONSET = 425  # as long as alerts that mean nothing are counted: wear may begin on any day of it
BASELINES = (LEARNING_DAYS, 100, 180, LATEST_ONSET)  # [d] before the onset, between which detection is told apart
DAYS_A_YEAR = 365.0
PACES_PER_YEAR = (0.10, 0.60)  # of arms that are asked how long they have left
LIFE_GROUPS = 5  # of arms that wear about as fast
GROUP = 1200  # arms with one kind of wear that are played at once: 0.5 GB; those on which nothing wears are played together
COMPARABLE = tuple(name for name in SCENARIOS if name not in {"holidays", "payload_swaps"})
"""Where there is a replay every day against one baseline: delays in days mean replays there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Played:
    """What the monitor said of a fleet; days count from the first replay, NaN is never."""

    fleet: Fleet
    days: int
    tier_day: Array  # (A, J, 3) of the first rise to each tier after learning
    falling_day: Array  # (A, J)
    common_day: Array  # (A,)
    early: int  # alerts while learning: first rises to any tier, of joints and of arms
    covered: Array  # (A,) share of days and joints whose 90 % interval of friction at T0 held the truth
    covered_worn: float  # the same of joints that wear, after the onset; NaN where none does
    slope_error_per_k: Array  # (A, J) what temperature still does to friction after it was taken out
    state: DriftState  # after the last day


Each = Callable[[Callable[[Any], Any], list[Any]], Iterable[Any]]
"""`map`, or that of a pool of processes."""

Watcher = Callable[[int, Day, DriftState], None]
"""Called after each day's replays with the day, what happened in it, and the state of all joints."""


def play(
    settings: FleetSettings,
    assess: AssessSettings,
    wear: Wear | None = None,
    *,
    watch: Watcher | None = None,
    learning: int = LEARNING_DAYS,
    count_use: bool = True,
) -> Played:
    """A fleet's life, judged day by day; `count_use`: somebody listens and counts revolutions."""
    fleet = Fleet(settings, wear)
    A, J = fleet.arms, fleet.joints
    N = A * J
    drift, laws = assess.drift, assess.temperature
    state: DriftState | None = None
    counts: Counts = nothing_counted(N, A)
    last = np.zeros(A)
    tier_day, falling_day, common_day = np.full((N, 3), np.nan), np.full(N, np.nan), np.full(A, np.nan)
    covered, asked, worn_covered, worn_asked = np.zeros(N), np.zeros(N), 0.0, 0.0
    sums = np.zeros((N, 5))
    early = np.zeros(N + A, dtype=bool)
    for day in range(settings.days):
        now = fleet.morning(day)
        here = np.repeat(now.replayed, J)
        if state is None:
            state = initial_state(now.seen, J, drift, laws)
        replay = Replay(
            observation=now.seen,
            days=day - last,
            replayed=now.replayed,
            slot=now.slot,
            opened=now.opened & (day > 0),  # the initial state knows no level yet
            revolutions=now.revolutions.ravel() if count_use else None,
        )
        last = np.where(now.replayed, day, last)
        result = step(state, replay, drift, laws, settle_on_learnt=True)
        state, filter_state = result.state, result.state.filter_state
        T, inside, T0, slot = now.seen.temperature_c, result.inside_range, state.reference_temperature_c, state.slot
        known = filter_state.learnt_from & np.isfinite(T)
        after = WearAfterReplay(
            wear=filter_state.wear,
            wear_std=filter_state.wear_std,
            known=filter_state.replays > 0,
            usable=filter_state.learnt_from & inside,
            day=np.full(N, float(day)),
            agreeing=filter_state.agreeing,
            interval_days=filter_state.interval_days,
        )
        found: Evidence = weigh_evidence(after, counts, J, assess.health)
        counts = found.counts
        if day < learning:
            early |= np.concatenate([(found.raises >= 0) | found.falls, found.together])
        if day >= learning:
            for k in range(3):
                tier_day[(found.raises >= k) & np.isnan(tier_day[:, k]), k] = day
            falling_day[found.falls & np.isnan(falling_day)] = day
            common_day[found.together & np.isnan(common_day)] = day
            truth = np.log(fleet.torque(T0.reshape(A, J), np.exp(now.worn))).ravel()
            mean, std_log = filter_state.reference(T0, slot)
            more, more_var = undetected_change(filter_state, filter_state.reference_row(T0, slot), drift)
            held = np.abs(truth - mean - more) < NINETY * np.sqrt(std_log**2 + more_var + drift.between_floor**2)
            covered, asked = covered + (held & here), asked + here
            worn = (now.worn.ravel() > 0) & here
            worn_covered, worn_asked = worn_covered + float((held & worn).sum()), worn_asked + float(worn.sum())
            # what the temperature law leaves: truth at the true temperature against what the filter expects there, without its noise
            expected = mean + _at(filter_state, T, slot) - _at(filter_state, T0, slot)
            left = now.truth.ravel() - expected
            use = known & inside & here
            x, y = np.where(use, T - T0, 0.0), np.where(use, left, 0.0)
            sums += np.stack([use, x, y, x * x, x * y], axis=1)
        if watch:
            watch(day, now, state)
    assert state is not None
    n, sx, sy, sxx, sxy = sums.T
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = (n * sxy - sx * sy) / (n * sxx - sx * sx)
    return Played(
        fleet=fleet,
        days=settings.days - learning,
        tier_day=tier_day.reshape(A, J, 3),
        falling_day=falling_day.reshape(A, J),
        common_day=common_day,
        early=int(early.sum()),
        covered=covered.reshape(A, J).sum(axis=1) / np.maximum(asked.reshape(A, J).sum(axis=1), 1.0),
        covered_worn=worn_covered / worn_asked if worn_asked else float("nan"),
        slope_error_per_k=slope.reshape(A, J),
        state=state,
    )


def _at(filter_state: FilterState, T: Array, slot: Array) -> Array:
    t = np.where(np.isfinite(T), T, filter_state.origin_c)
    return filter_state.reference(t, slot)[0]


# --- figures ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Delay:
    """Days from the onset to the first tier, over the arms that had no alert before; infinite where it never came."""

    arms: int
    median_days: float
    median_at_most: float  # one-sided 95 %, by order statistics
    p90_days: float
    within_30: Share
    by_baseline: tuple[tuple[int, int, Share], ...]  # from, to days before the onset: within 30 of these
    right_joint: Share  # of the arms in which anything was told
    wear_tier_median_days: float


def false_alarms(played: Played, scenario: str | None = None) -> Rate:
    """Alerts of arms on which nothing wears: every joint's first rise to any tier, every fall, every common rise."""
    mask = np.ones(played.fleet.arms, dtype=bool) if scenario is None else played.fleet.scenario == scenario
    told = np.isfinite(played.tier_day[mask][:, :, 0]).sum() + np.isfinite(played.falling_day[mask]).sum()
    told += np.isfinite(played.common_day[mask]).sum()
    return Rate(events=int(told), robot_years=float(mask.sum() * played.days / DAYS_A_YEAR))


class Felt(NamedTuple):
    """What was told of arms in which one joint wears, (A,) each; days, infinite where nothing was told."""

    onset: Array
    own: Array  # from the onset to the worn joint's first tier, that day counted
    wear: Array  # likewise to its wear tier
    others: Array  # on which any other joint's first tier came

    @classmethod
    def of(cls, played: Played, wear: Wear) -> "Felt":
        """Of a fleet that was played with this wear."""
        joint = wear.joint.astype(int)
        days = np.where(np.isnan(played.tier_day), np.inf, played.tier_day)  # (A, J, 3)
        own = days[np.arange(played.fleet.arms), joint]  # (A, 3)
        other = np.where(np.arange(days.shape[1]) == joint[:, None], np.inf, days[:, :, 0])
        since = own - wear.onset_day[:, None] + 1.0
        return cls(onset=wear.onset_day, own=since[:, 0], wear=since[:, 1], others=other.min(axis=1))

    @classmethod
    def together(cls, groups: Sequence["Felt"]) -> "Felt":
        """All arms of all groups."""
        return cls(*(np.concatenate(each) for each in zip(*groups, strict=True)))


def delay(felt: Felt) -> Delay:
    """How soon the worn joint was told."""
    sound = ~(felt.own < 1)  # a false alarm before the onset is counted there
    onset, days, wear_days, others = (each[sound] for each in felt)
    n = len(days)
    ordered = np.sort(days)
    rank = int(np.ceil(n / 2 + 1.645 * np.sqrt(n) / 2))
    told = np.isfinite(days)
    wrong = (others >= onset) & (others < onset + days)
    return Delay(
        arms=n,
        median_days=float(np.median(days)) if n else np.inf,  # where all were told something before, nobody knows
        median_at_most=float(ordered[min(rank, n - 1)]) if n else np.inf,
        p90_days=float(np.quantile(days, 0.9, method="higher")) if n else np.inf,
        within_30=Share(hits=int((days <= 30).sum()), of=n),
        by_baseline=tuple(
            (low, high, Share(hits=int((days[here] <= 30).sum()), of=int(here.sum())))
            for low, high in pairwise(BASELINES)
            for here in [(onset >= low) & (onset < high)]
        ),
        right_joint=Share(hits=int((told & ~wrong).sum()), of=int(told.sum())),
        wear_tier_median_days=float(np.median(wear_days)) if n else np.inf,
    )


def onsets(arms: int, seed: int, *, step: float = 0.0, per_day: float = 0.0, latest: int = LATEST_ONSET) -> Wear:
    """One joint of each arm wears from a day on, drawn evenly between the end of learning and `latest`."""
    dice = np.random.default_rng(seed)
    return Wear(
        joint=dice.integers(0, 6, arms).astype(float),
        onset_day=dice.integers(LEARNING_DAYS, latest, arms).astype(float),
        step=np.full(arms, step),
        per_day=np.full(arms, per_day),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """How good remaining useful life was, for arms that wear at a constant pace up to the limit."""

    interval: Share  # P10–P90 held the truth, asked at half-life
    alpha_lambda: Share  # P50 within 20 % of the truth at half-life
    no_trend: int  # arms without an answer then


def life(arms: int, assess: AssessSettings, *, seed: int, per_year: tuple[float, float] = PACES_PER_YEAR, base: FleetSettings) -> Life:
    """α-λ (Saxena et al., 2008) with α = 0.2 and coverage of P10–P90 at half-life, in revolutions; each arm asked once.

    Joints wear by a constant rate a revolution, `per_year` in a year of mean work; half-life is where half of the limit is worn.
    """
    return _life(map(_done, _life_jobs(arms, assess, seed=seed, per_year=per_year, base=base)))


def _life_jobs(
    arms: int, assess: AssessSettings, *, seed: int, per_year: tuple[float, float], base: FleetSettings
) -> list[Callable[[], Any]]:
    """Those that wear fast need fewer days: groups of about the same pace."""
    dice = np.random.default_rng(seed)
    paces = np.sort(np.exp(dice.uniform(np.log(per_year[0]), np.log(per_year[1]), arms))) / DAYS_A_YEAR  # a mean day of work
    groups = np.array_split(paces, min(LIFE_GROUPS, max(arms // 48, 1)))
    return [
        partial(_lives, pace, dice.integers(0, 6, len(pace)), assess, replace(base, arms=len(pace), seed=seed * LIFE_GROUPS + k))
        for k, pace in enumerate(groups)
    ]


def _life(groups: Iterable[list[tuple[bool, bool | None]]]) -> Life:
    answers = [answer for group in groups for answer in group]
    inside = [held for _, held in answers if held is not None]
    return Life(
        interval=Share(hits=sum(inside), of=len(inside)),
        alpha_lambda=Share(hits=sum(near for near, _ in answers), of=len(answers)),
        no_trend=len(answers) - len(inside),
    )


def _lives(pace: Array, joint: np.ndarray, assess: AssessSettings, base: FleetSettings) -> list[tuple[bool, bool | None]]:
    """Of each arm at half-life: whether P50 was near, and whether P10–P90 held the truth; None where no date was given."""
    arms, rise = len(pace), assess.prognosis.limit_rise
    wear = Wear(joint=joint.astype(float), onset_day=np.full(arms, 60.0), step=np.zeros(arms), per_day=pace)
    answers: list[tuple[bool, bool | None]] = []
    asked = np.zeros(arms, dtype=bool)

    def watch(_: int, now: Day, state: DriftState) -> None:
        filter_state, usage = state.filter_state, state.usage
        worn = now.used_days * pace
        for arm in np.flatnonzero(now.replayed & ~asked & (worn >= 0.5 * rise)):
            asked[arm] = True
            n = arm * 6 + int(wear.joint[arm])
            told = remaining_life(
                filter_state.mean[n, [WEAR, RATE]],
                filter_state.cov[n][np.ix_([WEAR, RATE], [WEAR, RATE])],
                wear_walk_per_sqrt_day=assess.drift.wear_walk_per_sqrt_day,
                settings=assess.prognosis,
            )
            truth = (rise - worn[arm]) / pace[arm] * MEAN_DUTY * REVOLUTIONS_PER_DUTY_DAY
            if told.p50_days is None or told.p10_days is None:
                answers.append((False, None))
                continue
            usual = usage.per_day[n]
            latest = np.inf if told.p90_days is None else told.p90_days * usual
            near = abs(told.p50_days * usual - truth) <= 0.2 * truth
            answers.append((bool(near), bool(told.p10_days * usual <= truth <= latest)))

    days = int(60 + 0.5 * rise / pace.min()) + 30  # the last weeks of work may have been short
    play(replace(base, days=days, scenarios=COMPARABLE), assess, wear, watch=watch)
    return answers


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
    """False alarms, delays against pace, coverage and life quality, as one document; the same whoever does `each`, e.g. a pool's map.

    lives : arms that are asked for their remaining life; half of `arms` where it is not said.
    steps : arms in which a 5 % step comes; `arms` where it is not said.
    """
    base = FleetSettings(
        arms=arms, seed=seed, between_std=between_std, robot=robot, reference_speed_rad_s=assess.drift.reference_speed_rad_s
    )  # fmt: skip
    few = max(arms // 3, 12)
    kinds = [
        Kind("2 % step", 0.02, 0.0, few),
        Kind("5 % step", 0.05, 0.0, arms if steps is None else steps),  # the share within 30 days is asked for on a bound of 99 %
        Kind("5 %/year", 0.0, 0.05, few),
        Kind("10 %/year", 0.0, 0.10, few),
        Kind("30 %/year", 0.0, 0.30, few),
        Kind("100 %/year", 0.0, 1.00, few),
    ]
    parts = [part for kind in kinds for part in _parts(kind, seed + 1)]
    jobs = [partial(_quiet, base, assess), *(partial(_group, base, assess, part) for part in parts)]
    asked = max(arms // 2 if lives is None else lives, 12)
    groups = _life_jobs(asked, assess, seed=seed + 3, per_year=PACES_PER_YEAR, base=base)
    quiet, *rest = each(_done, [*jobs, *groups])
    felt = list(zip(parts, rest[: len(parts)], strict=True))
    told = _life(rest[len(parts) :])
    return {
        **quiet,
        "detection": [_of_kind(kind, [group for part, group in felt if part.kind == kind]) for kind in kinds],
        "remaining_life": {
            "p10_p90_holds": _share(told.interval),
            "alpha_lambda_at_half_life": _share(told.alpha_lambda),
            "no_trend": told.no_trend,
        },
    }


def _done(job: Callable[[], Any]) -> Any:
    return job()


def _quiet(base: FleetSettings, assess: AssessSettings) -> dict[str, Any]:
    """What is told of a fleet on which nothing wears."""
    quiet = play(base, assess)
    left = np.abs(quiet.slope_error_per_k)  # (A, J)
    return {
        "robot_years": base.arms * quiet.days / DAYS_A_YEAR,
        "learning_days": LEARNING_DAYS,
        "while_learning": _rate(Rate(events=quiet.early, robot_years=base.arms * LEARNING_DAYS / DAYS_A_YEAR)),
        "between_std": base.between_std,
        "autocorrelation": base.autocorrelation,
        "false_alarms": {name or "all": _rate(false_alarms(quiet, name)) for name in (None, *SCENARIOS)},
        "false_wear_alerts": int(np.isfinite(quiet.tier_day[:, :, 1]).sum()),
        "friction_interval_90": _figure(over_arms(np.mean, quiet.covered)),
        "slope_left_per_k": {**_figure(over_arms(np.nanmean, left)), "nine_of_ten": _known(float(np.nanquantile(left, 0.9)))},
    }


class Kind(NamedTuple):
    """One kind of wear, and in how many arms it is played."""

    label: str
    step: float
    per_year: float
    arms: int


def detected(base: FleetSettings, assess: AssessSettings, kind: Kind, seed: int) -> dict[str, Any]:
    """What was told of one kind of wear, as a document."""
    return _of_kind(kind, [_group(base, assess, part) for part in _parts(kind, seed)])


class Part(NamedTuple):
    """So many arms of one kind of wear as are played at once: memory goes with them."""

    kind: Kind
    arms: int
    seed: int


def _parts(kind: Kind, seed: int) -> list[Part]:
    count = -(-kind.arms // GROUP)
    return [Part(kind, len(group), seed + 1000 * k) for k, group in enumerate(np.array_split(np.arange(kind.arms), count))]


def _group(base: FleetSettings, assess: AssessSettings, part: Part) -> tuple[Felt, float]:
    """What was told of it, and the share of its intervals that held the truth in joints that wear."""
    kind, arms, seed = part
    wear = onsets(arms, seed, step=kind.step, per_day=kind.per_year / DAYS_A_YEAR)
    days = days_to_play(kind.step, kind.per_year)
    played = play(replace(base, arms=arms, days=days, seed=seed + 1, scenarios=COMPARABLE), assess, wear)
    return Felt.of(played, wear), played.covered_worn


def _of_kind(kind: Kind, groups: Sequence[tuple[Felt, float]]) -> dict[str, Any]:
    felt = Felt.together([felt for felt, _ in groups])
    covered = float(np.average([share for _, share in groups], weights=[len(felt.own) for felt, _ in groups]))
    return detection_row(kind.label, kind.step, kind.per_year, delay(felt), covered)


def days_to_play(step: float, per_year: float) -> int:
    """Until what began on the last day is found in nearly every arm."""
    return LATEST_ONSET + (60 if step >= 0.05 else 120 if per_year >= 0.3 else 250)


def detection_row(label: str, step: float, per_year: float, told: Delay, interval_90: float) -> dict[str, Any]:
    """What was told of one kind of wear, as a document."""
    return {"wear": label, "step": step, "per_year": per_year, **_delay(told), "interval_90": _known(interval_90)}


def _figure(figure: Figure) -> dict[str, float | None]:
    return {name: _known(value) for name, value in figure._asdict().items()}


def _rate(rate: Rate) -> dict[str, float]:
    return {"events": rate.events, "robot_years": rate.robot_years, "per_year": rate.per_year, "at_most": rate.at_most}


def _share(share: Share) -> dict[str, float | None]:
    return {"hits": share.hits, "of": share.of, "share": _known(share.value), "at_least": share.at_least, "at_most": share.at_most}


def _known(figure: float) -> float | None:
    return figure if np.isfinite(figure) else None


def _delay(told: Delay) -> dict[str, Any]:
    return {
        "arms": told.arms,
        "median_days": _known(told.median_days),
        "median_at_most_days": _known(told.median_at_most),
        "p90_days": _known(told.p90_days),
        "within_30_days": _share(told.within_30),
        "by_baseline": [
            {"from_days": low, "to_days": high, "within_30_days": _share(share)} for low, high, share in told.by_baseline if share.of
        ],
        "right_joint": _share(told.right_joint),
        "wear_tier_median_days": _known(told.wear_tier_median_days),
    }
