"""The worlds on the performance card: a row for each, with its goals and bounds."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from monitor.judge.settings import AssessSettings
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import play_world

from .informed import informed_beside

DAYS = 1095  # of every healthy arm
ARMS = 40  # healthy ones of each world that goals are set for: 113 robot-years, so that 5 events prove 0.1 a year
SHARE_WORN = 3 / 8  # of so many: arms with each kind of wear
SHARE_OTHERS = 1 / 4  # of all that: in worlds that no table lists
# Times as many arms, healthy ones and those with wear: false advisories, medians of days and shares of lives that lie near what is asked
# for. Of 15 arms such a median is known to a fifth, of 120 to 8 %.
MORE = {
    "plain": (8, 8),
    "noise-3": (8, 3),
    "noise-4": (8, 8),
    "noise-5": (8, 3),
    "noise-mixed": (8, 1),
    "seasonal-noise-mild": (3, 3),
    "student-t3": (3, 3),
    "summer-24": (4, 4),
    "two-joints": (3, 3),
    "grease-lag": (3, 3),
    "paths": (3, 8),
    "twice-a-day-replay": (2, 2),
    "twice-a-day-time": (2, 2),
    "four-a-day": (2, 2),
    "bad-days": (2, 2),
}
NOISE_KNOWN = ("plain", "noise-4", "quiet")  # worlds with goals of days in which nothing but wear and temperature moves friction
SEED_ABOVE = 1000  # of the worlds, above the card's: seeds from 1 to 99 were for development, those from 3000 on nobody looked at

Each = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""`map`, or that of a pool of processes."""

WORLDS_HEAD = "\n## Worlds that nobody assumed\n"
WORLDS_TEXT = """
Each row is a world with friction, heat, noise and wear of its own, from seed {seed}; `joint-monitor rehearse --world NAME` plays it.

- The generators know nothing of the judge. Dry friction has a Stribeck effect that decays exponentially, viscous friction follows a power
  of speed and Vogel's law of temperature. Where a row says nothing else, σ is 2 % and ρ 0.5, the room has seasons, weather and cold
  Mondays, and the grease lags some minutes behind the motor.
- {arms} healthy arms live three years, {others} from "{first_other}" on, worlds that no goal was set for beforehand. Wear is put into
  {worn} arms more for each kind, {others_worn} there, into one joint where nothing else is said, from a day between 60 and 425 on. Times
  as many arms, healthy and with wear: {more}.
  Nobody counts revolutions.
- Counted are the first rise and the first fall of every joint and the first common advisory of every arm, after 60 days of learning.
- Bounds are one-sided, 95 %: ✓ means that the bound keeps what is asked for, (✓) that the figure does and its bound does not, (✗) that
  the figure does not and its other bound does: chance alone may be why. Nine of ten and intervals are marked by the figure alone.

| world | | false advisories a robot-year | asked for | days to detection: median, nine of ten | right joint | 90 % intervals, healthy |
|---|---|---|---|---|---|---|
"""
NOT_KNOWING = """
What does it cost not to know the noise? An observer who knows σ and ρ exactly, and that nothing but wear and temperature moves friction,
learns level and temperature law of each joint and looks for rises by steps and rates, by their generalised likelihood ratio. It has the
same arms, and a threshold by which it has as many false advisories as the judge, or as many as are asked for. The judge knows none of this,
and counts no replay for more than 2.3 standard deviations. Median days, with bounds:

| world | wear | asked for | judge, at its false advisories a robot-year | who knows the noise, at as many | at what is asked for |
|---|---|---|---|---|---|
"""
LIVES = """
Remaining life, asked at 50 and 75 % of the time from the onset to the limit, of wear on paths that the judge is not told:

| path | at | no date | P10–P90 holds the truth | P50 within 20 % | median of P50 over the truth | asked for |
|---|---|---|---|---|---|---|
"""
LIFE_HOLDS, LIFE_RATIO = (0.75, 0.88), (0.7, 1.4)  # asked of P10–P90, and of P50 over the truth


def world_documents(assess: AssessSettings, *, arms: int, seed: int, each: Each = map) -> list[dict[str, Any]]:
    """Every world, played; `each` does not change it."""
    return list(each(partial(_played, assess=assess, arms=arms, seed=seed), WORLDS))


def noise_known_documents(
    documents: Sequence[dict[str, Any]], *, arms: int, seed: int, each: Each = map
) -> dict[str, list[dict[str, Any]]]:
    """Of each world in `NOISE_KNOWN` what an informed observer reaches, at the judge's false advisories and at those that are asked for."""
    judged = [document for document in documents if document["world"] in NOISE_KNOWN]
    return dict(zip((document["world"] for document in judged), each(partial(_informed, arms=arms, seed=seed), judged), strict=True))


def _informed(document: dict[str, Any], arms: int, seed: int) -> list[dict[str, Any]]:
    healthy, worn = arms_of(document["world"], arms)
    return informed_beside(document, arms=healthy, worn=worn, days=DAYS, seed=seed)


def _played(name: str, assess: AssessSettings, arms: int, seed: int) -> dict[str, Any]:
    healthy, worn = arms_of(name, arms)
    return play_world(WORLDS[name], assess, arms=healthy, worn=worn, days=DAYS, seed=seed)


def arms_of(name: str, arms: int) -> tuple[int, int]:
    """Healthy arms of a world, and arms with each kind of wear, where a usual world has so many healthy ones."""
    usual = 1.0 if WORLDS[name].listed else SHARE_OTHERS
    healthy, worn = MORE.get(name, (usual, usual))
    return max(round(healthy * arms), 1), max(round(worn * SHARE_WORN * arms), 1)


def worlds_section(
    documents: Sequence[dict[str, Any]], *, arms: int, seed: int, noise_known: Mapping[str, Sequence[dict[str, Any]]] | None = None
) -> str:
    """The section of the card, of the documents of all worlds; arms, seed : as in `world_documents`.

    noise_known : `noise_known_documents`.
    """
    first_other = next(name for name, world in WORLDS.items() if not world.listed)
    first_usual = next(name for name, world in WORLDS.items() if world.listed and name not in MORE)
    usual, others = (arms_of(name, arms) for name in (first_usual, first_other))
    text = WORLDS_HEAD + WORLDS_TEXT.format(
        seed=seed,
        arms=usual[0],
        others=others[0],
        first_other=first_other,
        worn=usual[1],
        more=", ".join(f"{name} {healthy} and {worn}" for name, (healthy, worn) in MORE.items()),
        others_worn=others[1],
    )
    for document in documents:
        false, goal = document["false_advisories"], document["goal"]
        counted = false["counted"]
        cells = (
            document["world"],
            document["sentence"],
            f"{counted['per_year']:.3f} (≤ {counted['at_most']:.3f}){_beside(document)}",
            f"≤ {goal['false_advisories']:g} {_met(counted['per_year'], counted['at_most'], goal['false_advisories'])}",
            "; ".join(_days(row, goal) for row in document["detection"]),
            ", ".join(_percent(row["right_joint"]["share"]) for row in document["detection"]),
            _interval(document["interval_90"]["healthy"], goal["interval_90"]),
        )
        text += f"| {' | '.join(cells)} |\n"
    text += "\nUntil wear is detected, the 90 % intervals of friction of the worn joint hold the truth in: "
    text += ", ".join(f"{row['wear']} {_percent(row['interval_90_undetected'])}" for row in documents[0]["detection"])
    text += f" ({documents[0]['world']}).\n"
    if noise_known:
        text += NOT_KNOWING + "".join(_noise_known_rows(document, noise_known.get(document["world"], ())) for document in documents)
    lives = [(row["wear"], life) for document in documents for row in document["detection"] for life in row["remaining_life"]]
    if lives:
        text += LIVES + "".join(_world_life_row(wear, life) for wear, life in lives)
    return text


def _noise_known_rows(document: dict[str, Any], informed: Sequence[dict[str, Any]]) -> str:
    """A row for each kind of wear of a world: the judge's median beside those of the observer, at each share of false advisories."""
    rate, goal = document["false_advisories"]["counted"]["per_year"], document["goal"]["median_days"]
    text = ""
    for row in document["detection"]:
        observer = [_bounded_median(one) for one in informed if one["wear"] == row["wear"]]
        if observer:
            asked = f"≤ {goal[row['wear']]:g}" if row["wear"] in goal else "–"
            text += f"| {document['world']} | {row['wear']} | {asked} | {_bounded_median(row)}, at {rate:.3f} | {' | '.join(observer)} |\n"
    return text


def _bounded_median(row: dict[str, Any]) -> str:
    median, low, high = (_days_or_never(row[key]) for key in ("median_days", "median_at_least_days", "median_at_most_days"))
    return f"{median} (≥ {low}, ≤ {high})"


def _beside(document: dict[str, Any]) -> str:
    """What is not counted in a world, because it is the right word there."""
    false = document["false_advisories"]
    beside = [
        f"{name} in {false[name]['events']} of {document['arms']} arms" if name == "common" else f"{name} {false[name]['events']}"
        for name in ("rising", "falling", "common")
        if name not in false["counted"]["kinds"]
    ]
    payload = document["payload_found"]
    if payload["of"]:
        beside.append(f"payload in {payload['arms']} of {payload['of']} arms")
    return f"; told: {', '.join(beside)}" if beside else ""


def _days(row: dict[str, Any], goal: dict[str, Any]) -> str:
    """The wear's name, its median and nine of ten, with what is asked for; and the share never found, where there is one."""
    median, nine = (_days_or_never(row[key]) for key in ("median_days", "p90_days"))
    asked = goal["median_days"].get(row["wear"])
    if asked is not None:
        median = f"{_bounded_median(row)[:-1]}; asked ≤ {asked:g} {_median_met(row, asked)})"
    asked = goal["nine_of_ten_days"].get(row["wear"])
    if asked is not None:
        days = row["p90_days"]
        nine += f" (asked ≤ {asked:g} {'✓' if days is not None and days <= asked else '✗ not reached'})"
    never = row["never"]
    missed = f", never {never['hits']} of {never['of']}" if never["hits"] else ""
    return f"{row['wear']} {median}, {nine}{missed}"


def _days_or_never(days: float | None) -> str:
    return "never" if days is None else f"{days:.0f}"


def _median_met(row: dict[str, Any], asked: float) -> str:
    low, median, high = (np.inf if row[key] is None else row[key] for key in ("median_at_least_days", "median_days", "median_at_most_days"))
    return _met(median, high, asked, at_least=low)


def _world_life_row(wear: str, life: dict[str, Any]) -> str:
    holds, ratio = life["p10_p90_holds"], life["p50_over_truth"]
    share = holds["share"]
    bounds = "–" if share is None else f"{_percent(share)} (≥ {_percent(holds['at_least'])}, ≤ {_percent(holds['at_most'])})"
    cells = (
        wear,
        _percent(life["at_share_of_life"]),
        f"{life['without_date']} of {life['asked']}",
        bounds,
        _percent(life["p50_near"]["share"]),
        "–" if ratio is None else f"{ratio:.2f}",
        f"{100 * LIFE_HOLDS[0]:.0f}–{100 * LIFE_HOLDS[1]:.0f} %, {LIFE_RATIO[0]:g}–{LIFE_RATIO[1]:g} {_life_met(holds, ratio)}",
    )
    return f"| {' | '.join(cells)} |\n"


def _life_met(holds: dict[str, Any], ratio: float | None) -> str:
    """The mark of a share that is asked to lie between two, as of medians."""
    least, most = LIFE_HOLDS
    if holds["share"] is None or ratio is None or not LIFE_RATIO[0] <= ratio <= LIFE_RATIO[1]:
        return "✗ not reached"
    low, share, high = holds["at_least"], holds["share"], holds["at_most"]
    if least <= share <= most:
        return "✓" if least <= low and high <= most else "(✓)"
    return "(✗)" if low <= most and high >= least else "✗ not reached"


def _met(value: float, at_most: float, asked: float, at_least: float = np.inf) -> str:
    """The mark of a figure that is asked to be no larger. at_least : its lower bound, where it has one."""
    if at_most <= asked:
        return "✓"
    if value <= asked:
        return "(✓)"
    return "(✗)" if at_least <= asked else "✗ not reached"


def _interval(share: float | None, asked: list[float] | None) -> str:
    if share is None or asked is None:
        return _percent(share)
    return f"{_percent(share)} ({100 * asked[0]:.0f}–{100 * asked[1]:.0f} % {'✓' if asked[0] <= share <= asked[1] else '✗'})"


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"
