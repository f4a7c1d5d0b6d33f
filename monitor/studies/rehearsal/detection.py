"""How soon the monitor detects wear of one joint, and how often it raises an alert of an arm that does not wear."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from monitor.judge.assess import AssessSettings
from monitor.recording import Array, known_or_none
from monitor.studies.figures import DAYS_A_YEAR, Rate, Share, median_bounds, share_document
from monitor.studies.rehearsal.fleet import FleetSettings, Wear
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
