"""What the judge says of remaining life in joints whose wear follows a path to the limit, asked at shares of the true life."""

import time
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from monitor.judge.alerts.evidence import Evidence
from monitor.judge.alerts.remaining_life import remaining_life_of_joint
from monitor.judge.settings import AssessSettings
from monitor.recording import Array, known_or_none
from monitor.studies.figures import DAYS_A_YEAR, Rate, Share, median_bounds, share_document
from monitor.studies.rehearsal.play import LEARNING_DAYS, Coverage, Episodes, JudgedDay, judged_days
from monitor.studies.rehearsal.rehearse import ASKED_AT, SOON_DAYS, LifeAnswer, life_documents
from monitor.studies.worlds.fleet import World, WorldFleet


class Lives:
    """Asks every arm whose wear has a life at each of `ASKED_AT`, on the first replay from then on."""

    def __init__(self, fleet: WorldFleet, assess: AssessSettings) -> None:
        self.answers: list[LifeAnswer] = []
        self._fleet, self._assess = fleet, assess
        has_life = np.array([wear.life_years is not None for wear in fleet.world.wear] or [False])
        lives = (fleet.group >= 0) & has_life[fleet.group]
        self._open = np.repeat(lives[:, None], len(ASKED_AT), axis=1)  # (A, 2)

    def add(self, judged: JudgedDay) -> None:
        """One more day."""
        fleet, assess = self._fleet, self._assess
        due = judged.day >= fleet.onset_day[:, None] + np.array(ASKED_AT) * fleet.unit_days[:, None]
        for arm, k in np.argwhere(self._open & due & judged.now.replayed[:, None]).tolist():
            self._open[arm, k] = False
            joint = arm * (fleet.joints + 1) + int(np.argmax(fleet.worn[arm]))
            left = fleet.onset_day[arm] + fleet.unit_days[arm] - judged.day
            friction = judged.result.state.friction
            predicted = remaining_life_of_joint(friction, joint, assess.friction, assess.prognosis, assess.drift.wear_prior)
            self.answers.append(LifeAnswer(int(fleet.group[arm]), ASKED_AT[k], predicted, float(left)))


# --- What the judge makes of a world: false advisories, days to detection, coverage ---

CONTRADICTIONS = 2  # in a row raise the alert
LIFE_DAYS = (LEARNING_DAYS, 2 * LEARNING_DAYS, 425, np.inf)  # ends of the parts of life in which false advisories are counted apart


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdicts:
    """What was raised in a fleet of a world. Days are those of the fleet's life; infinite is never."""

    fleet: WorldFleet
    rising: Episodes  # of the joints, (A·J,)
    falling: Episodes
    common: Episodes  # of the arms, (A,)
    payload: Episodes  # likewise, weights that contradict the declared context: of arms that carry what nobody declared …
    no_payload: Episodes  # … and of others
    found_day: Array  # (A,) first tier of a joint that wears, on or after the onset
    before: np.ndarray  # (A,) it was raised already before the onset
    wrong: np.ndarray  # (A,) another joint's tier came between onset and detection
    coverage: Coverage
    lives: list[LifeAnswer]
    seconds: float


def judge_world(fleet: WorldFleet, assess: AssessSettings) -> Verdicts:
    """A world's fleet, judged day by day."""
    started, A, J = time.process_time(), fleet.arms, fleet.joints
    rising, falling, common, payload, no_payload = Episodes(A * J), Episodes(A * J), Episodes(A), Episodes(A), Episodes(A)
    contradicted = np.zeros(A)  # replays in a row
    found, before, wrong = np.full(A, np.inf), np.zeros(A, dtype=bool), np.zeros(A, dtype=bool)
    coverage = Coverage(fleet, assess.friction)
    many = fleet.worn.sum(axis=1) >= 3
    previously, lives = np.zeros(A, dtype=bool), Lives(fleet, assess)
    for judged in judged_days(fleet, fleet.days, assess, count_use=False):
        day, evidence = judged.day, judged.evidence
        raised = evidence.raises.reshape(A, J) >= 0
        rising.add(day, raised.ravel(), LEARNING_DAYS)
        falling.add(day, evidence.falls, LEARNING_DAYS)
        common.add(day, evidence.together, LEARNING_DAYS)
        contradicted = np.where(judged.now.replayed, (contradicted + 1) * judged.undeclared, contradicted)
        payload.add(day, (contradicted >= CONTRADICTIONS) & fleet.undeclared[judged.number], LEARNING_DAYS)
        no_payload.add(day, (contradicted >= CONTRADICTIONS) & ~fleet.undeclared[judged.number] & judged.now.replayed, LEARNING_DAYS)
        own = _found(raised, evidence, fleet.worn, many)
        after = day >= fleet.onset_day
        before |= own & ~after & (day >= LEARNING_DAYS)
        before |= own & (day == fleet.onset_day) & previously
        wrong |= after & np.isinf(found) & (raised & ~fleet.worn).any(axis=1)
        found[own & after & np.isinf(found)] = day
        previously = own
        lives.add(judged)
        if day >= LEARNING_DAYS:
            coverage.add(judged, np.isinf(found)[:, None])
    return Verdicts(
        fleet=fleet,
        rising=rising,
        falling=falling,
        common=common,
        payload=payload,
        no_payload=no_payload,
        found_day=found,
        before=before,
        wrong=wrong,
        coverage=coverage,
        lives=lives.answers,
        seconds=time.process_time() - started,
    )


def _found(raised: np.ndarray, evidence: Evidence, worn: np.ndarray, many: np.ndarray) -> np.ndarray:
    """(A,) whether a joint that wears is at a tier, or all together where three or more wear."""
    result: np.ndarray = (raised & worn).any(axis=1) | (many & evidence.together)
    return result


def world_document(healthy: Verdicts, worn: Verdicts) -> dict[str, Any]:
    """The figures of a world, as one document: advisories from its healthy arms, detection from those that wear."""
    fleet, world = healthy.fleet, healthy.fleet.world
    years = float(fleet.arms * (fleet.days - LEARNING_DAYS) / DAYS_A_YEAR)
    rates = {
        name: _rate(int(np.isfinite(episodes.first).sum()), years, again=int(np.maximum(episodes.count - 1, 0).sum()))
        for name, episodes in (
            ("rising", healthy.rising),
            ("falling", healthy.falling),
            ("common", healthy.common),
            ("payload", healthy.no_payload),
        )
    }
    counted = sum(int(rates[name]["events"]) for name in (*world.goal.counted, "payload"))
    return {
        "world": world.name,
        "sentence": world.sentence,
        "arms": fleet.arms,
        "robot_years": years,
        "learning_days": LEARNING_DAYS,
        "false_advisories": {
            "counted": {**_rate(counted, years), "kinds": list(world.goal.counted)},
            "single_joint": _rate(int(rates["rising"]["events"] + rates["falling"]["events"]), years),
            "by_life": _by_life(healthy),
            **rates,
        },
        "payload_found": {"arms": int(np.isfinite(healthy.payload.first).sum()), "of": int(fleet.undeclared.any(axis=0).sum())},
        "detection": [_detection(worn, k) for k in range(len(world.wear))],
        "interval_90": {"healthy": healthy.coverage.share(0), "worn": worn.coverage.share(1)},
        "goal": {
            "false_advisories": world.goal.false,
            "median_days": dict(world.goal.within_days),
            "nine_of_ten_days": dict(world.goal.nine_of_ten_days),
            "interval_90": None if world.goal.interval is None else list(world.goal.interval),
        },
        "processor_s": healthy.seconds + worn.seconds,
        "arm_days": fleet.arms * fleet.days + worn.fleet.arms * worn.fleet.days,
    }


def _by_life(healthy: Verdicts) -> list[dict[str, Any]]:
    """The counted advisories of friction by the arms' age: what chance does is learnt from the arm, and young arms have more of them."""
    counted = healthy.fleet.world.goal.counted
    first = np.concatenate([getattr(healthy, kind).first for kind in counted])
    parts = []
    for begin, end in pairwise(LIFE_DAYS):
        last = min(end, float(healthy.fleet.days))
        if last > begin:
            events = int(((first >= begin) & (first < last)).sum())
            years = float(healthy.fleet.arms * (last - begin) / DAYS_A_YEAR)
            parts.append({"from_day": begin, "to_day": last, "robot_years": years, **_rate(events, years)})
    return parts


def _rate(events: int, years: float, **more: int) -> dict[str, Any]:
    rate = Rate(events=events, robot_years=years)
    return {"events": events, "per_year": rate.per_year, "at_most": rate.at_most, **more}


def _detection(verdicts: Verdicts, k: int) -> dict[str, Any]:
    """Days to detection of the wear of number k."""
    fleet = verdicts.fleet
    here = (fleet.group == k) & ~verdicts.before
    days = verdicts.found_day[here] - fleet.onset_day[here] + 1.0
    found, n = np.isfinite(days), len(days)
    return {
        "wear": fleet.world.wear[k].name,
        "raised_before": int(((fleet.group == k) & verdicts.before).sum()),
        **days_document(days),
        "within_30_days": share_document(Share(hits=int((days <= SOON_DAYS).sum()), of=n)),
        "interval_90_undetected": verdicts.coverage.share(2, fleet.group == k),
        "never": share_document(Share(hits=int((~found).sum()), of=n)),
        "right_joint": share_document(Share(hits=int((found & ~verdicts.wrong[here]).sum()), of=int(found.sum()))),
        "remaining_life": life_documents([each for each in verdicts.lives if each.group == k]),
    }


def days_document(days: Array) -> dict[str, Any]:
    """Days to detection of arms, infinite where it never came: their number, the median with its bounds, and nine of ten."""
    n, (low, high) = len(days), median_bounds(days)
    return {
        "arms": n,
        "median_days": known_or_none(float(np.median(days))) if n else None,
        "median_at_least_days": known_or_none(max(low, 0.0)),
        "median_at_most_days": known_or_none(high),
        "p90_days": known_or_none(float(np.quantile(days, 0.9, method="higher"))) if n else None,
    }


def play_world(world: World, assess: AssessSettings, *, arms: int, days: int, seed: int, worn: int | None = None) -> dict[str, Any]:
    """A world's figures, as one document.

    arms : healthy ones, over `days`. worn : arms of each kind of wear, no longer than needed; None: half as many as healthy ones.
    """
    healthy, wearing = fleets_of(world, arms=arms, days=days, seed=seed, worn=worn)
    return world_document(judge_world(healthy, assess), judge_world(wearing, assess))


def fleets_of(world: World, *, arms: int, days: int, seed: int, worn: int | None = None) -> tuple[WorldFleet, WorldFleet]:
    """The healthy arms and those that wear, as in `play_world`."""
    each = max(arms // 2, 1) if worn is None else worn
    latest = max((wear.latest_day + DAYS_A_YEAR * (wear.life_years or (1.0, 1.0))[1] for wear in world.wear), default=0.0)
    healthy = WorldFleet(world, healthy=arms, worn=0, days=days, seed=seed)
    return healthy, WorldFleet(world, healthy=0, worn=each, days=min(days, int(latest)), seed=seed + 1_000_000)
