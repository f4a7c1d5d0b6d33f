"""`python -m tests.evidence.ablation [NAME…]`: what each mechanism of the judge pays, in false advisories and in days to detection.

One mechanism at a time is off: a function or a constant of the judge is replaced by one that does nothing, and the same arms are judged
again. The judge itself has no switches.

Not here, because no single replacement takes them away or these worlds do not have what they are for: what the filter's own equations are
(wear, rate, noise and levels as states), the terms by which `update_noise` parts noise from the level's uncertainty, a fleet's prior
(`from_fleet`, `KNOWN_NOISE`), everything of production, stuck sensors, contexts that return, maintenance, and the count of revolutions.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast
from unittest.mock import patch

import numpy as np

from monitor.judge.alerts.evidence import WearAfterReplay, wear_of_state
from monitor.judge.drift.filter_state import CURVE, FilterState
from monitor.judge.drift.noise.size import MOST_SIGMA
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.undeclared import NO_UNDECLARED_CHANGE
from monitor.judge.drift.update.change_detection import candidate_weights, thresholds
from monitor.judge.drift.update.innovation import Gate
from monitor.judge.drift.update.outlier_run import outlier_run
from monitor.judge.settings import AssessSettings, HealthSettings
from monitor.recording import Array
from monitor.studies.rehearsal.fleet import Day
from monitor.studies.worlds.fleet import WorldFleet
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import Verdicts, fleets_of, judge_world, world_document

from . import at_least_one

SETTINGS = AssessSettings()  # of the judge; some mechanisms are figures of it
CORE = ("plain", "student-t3", "one-over-f")  # worlds in which most mechanisms are tried
ROW = FilterState.row


def _no(number: int) -> np.ndarray:
    return np.zeros(number, dtype=bool)


def _gate_nothing(state: FilterState, *_: Any) -> Gate:
    return Gate(_no(state.joints), np.zeros(state.joints), _no(state.joints))


def _each_alone(bank: Any, effect: Array, responses: Array, ages: Array, innovation: Any, noise: Any, length: Array, days: Array) -> Any:
    return outlier_run(bank, effect, responses, ages, innovation, noise, np.zeros_like(length), days)


def _thresholds_without(*kinds: int) -> Any:
    def never(*arguments: Any, **more: Any) -> Array:
        lowest = thresholds(*arguments, **more)
        lowest[:, kinds] = np.inf
        return lowest

    return never


def _same_at_every_age(ages: Array, settings: DriftSettings, *_: Any, **__: Any) -> Array:
    return np.full((len(ages), 2, ages.shape[1]), settings.shift_sigma**2)


def _likeliest_alone(*arguments: Any) -> Array:
    weight = candidate_weights(*arguments)
    return (np.arange(weight.shape[1]) == np.argmax(weight, axis=1)[:, None]).astype(float)


def _row_at_origin(state: FilterState, t: Array, warming: Array, slot: Array, *, noise: float = 1.0) -> Array:
    return ROW(state, np.zeros_like(t), warming, slot, noise=noise)


def _row_without_curve(state: FilterState, t: Array, warming: Array, slot: Array, *, noise: float = 1.0) -> Array:
    H = ROW(state, t, warming, slot, noise=noise)
    H[:, CURVE] = 0.0
    return H


def _each_replay_counts_once(state: FilterState, usable: np.ndarray, day: float) -> WearAfterReplay:
    return replace(wear_of_state(state, usable, day), agreeing=np.ones(state.joints))


class Mechanism(NamedTuple):
    """What is replaced by what, and where that is tried."""

    what: str
    off: Mapping[str, Any]  # name of a function or constant → what stands in for it
    worlds: Sequence[str] = CORE


D = "monitor.judge.drift."
CHANGE, FILTER, INNOVATION = f"{D}update.change_detection.", f"{D}update.filter_update.", f"{D}update.innovation."
STATE, STEP, LOWEST, CHANCE = f"{D}filter_state.", f"{D}step.", f"{D}update.lowest_level.", f"{D}noise.chance."
EVIDENCE, PLAY = "monitor.judge.alerts.evidence.", "monitor.studies.rehearsal.play."
OURS = f"{__name__}.SETTINGS"


def _drift(**figures: float) -> dict[str, Any]:
    return {OURS: replace(SETTINGS, drift=replace(SETTINGS.drift, **figures))}


def _health(**figures: Any) -> dict[str, Any]:
    return {OURS: replace(SETTINGS, health=HealthSettings(**figures))}


MECHANISMS: dict[str, Mechanism] = {
    # outliers
    "gate": Mechanism(
        "outliers are left out, and three in a row are a step", {f"{FILTER}gate_outliers": _gate_nothing}, (*CORE, "bad-days")
    ),
    "run": Mechanism("outliers in a row prove a step", {f"{FILTER}stays": lambda *a: _no(len(a[3].rho))}, (*CORE, "bad-days")),
    "stays": Mechanism(
        "… unless they fade as a shock does", {f"{FILTER}stays": lambda *a: ~_no(len(a[3].rho))}, ("student-t3", "bad-days")
    ),
    "outlier_run": Mechanism("what outliers in a row say together", {f"{CHANGE}outlier_run": _each_alone}, ("student-t3", "bad-days")),
    "counted_sigma": Mechanism(
        "an innovation is clipped by the tails of the arm's noise", {f"{FILTER}counted_sigma": lambda n, *_: np.full(len(n), MOST_SIGMA)}
    ),
    # changes by likelihood ratio
    "changes": Mechanism("changes are found by likelihood ratio", {f"{CHANGE}thresholds": _thresholds_without(0, 1)}, (*CORE, "ar-08")),
    "steps": Mechanism("… by that of a step", {f"{CHANGE}thresholds": _thresholds_without(0)}, (*CORE, "ar-08")),
    "rates": Mechanism("… by that of a new rate", {f"{CHANGE}thresholds": _thresholds_without(1)}, (*CORE, "ar-08")),
    "thresholds": Mechanism("thresholds fall with age", {f"{CHANGE}thresholds": _same_at_every_age}, (*CORE, "ar-08")),
    "OF_OLD_STEP": Mechanism("… more for old steps", {f"{CHANGE}OF_OLD_STEP": 0.0}, ("plain", "one-over-f", "noise-4")),
    "OF_NOISE": Mechanism("… still more where noise is 3 to 5 %", {f"{CHANGE}OF_NOISE": 0.0}, ("plain", "noise-4")),
    "OLD_REPLAYS": Mechanism("… more for old rates", {f"{CHANGE}OLD_REPLAYS": 1e9}, ("plain", "one-over-f")),
    "OF_FREQUENT": Mechanism("several replays a day need more evidence", {f"{CHANGE}OF_FREQUENT": 0.0}, ("twice-a-day-replay",)),
    "PRIOR_INFORMATION": Mechanism("the size of a change has a prior", {f"{CHANGE}PRIOR_INFORMATION": np.zeros((2, 1))}),
    "candidate_weights": Mechanism("a change is a mixture of candidates", {f"{CHANGE}candidate_weights": _likeliest_alone}),
    "SETTLING_SHARE": Mechanism(
        "innovations of an unknown level are no evidence", {f"{INNOVATION}SETTLING_SHARE": np.inf}, ("plain", "student-t3")
    ),
    # noise
    "update_noise": Mechanism(
        "size and correlation of the noise are learnt", {f"{FILTER}update_noise": lambda state, *_: state}, (*CORE, "noise-mixed")
    ),
    "autocorrelation": Mechanism(
        "its correlation is learnt",
        {f"{STATE}FilterState.autocorrelation": lambda state, _, s: np.full(state.joints, s.autocorrelation)},
        (*CORE, "ar-08"),
    ),
    "own_correlation": Mechanism("… of each joint", {f"{STATE}own_correlation": lambda _, __, shown, *___: shown}, (*CORE, "rho-mixed")),
    "alike": Mechanism("joints of an arm have like noise", {f"{STATE}alike": lambda step_var, *_: step_var}, (*CORE, "noise-mixed")),
    "present": Mechanism(
        "noise of the last weeks, of the arm", {f"{STATE}present": lambda activity, _: np.ones(len(activity))}, (*CORE, "seasonal-noise")
    ),
    "volatility": Mechanism(
        "… and of the joint", {f"{D}noise.volatility.Volatility.factor": lambda self, _: np.ones(len(self.usual))}, (*CORE, "noise-swells")
    ),
    "caution": Mechanism("noise of few replays is taken for larger", _drift(caution=0.0), ("plain", "student-t3")),
    "learn_chance": Mechanism(
        "what chance did at every age, by the arm's past",
        {f"{FILTER}learn_chance": lambda chance, *_: chance},
        (*CORE, "slow-common", "weekdays"),
    ),
    "spectrum": Mechanism(
        "… with a prior of spectra", {f"{CHANCE}spectrum": lambda _, __, n: np.ones((len(n), 1, n.shape[1]))}, (*CORE, "slow-common")
    ),
    "falls_by_chance": Mechanism(
        "… without what running-in makes", {f"{CHANCE}falls_by_chance": lambda mean, *_: mean[:, :, 0]}, ("plain", "running-in")
    ),
    "forget_chance": Mechanism(
        "… forgotten after a change of level",
        {f"{FILTER}forget_chance": lambda chance, _: chance, f"{LOWEST}forget_chance": lambda chance, _: chance},
        ("plain", "running-in", "regrease-then-wear"),
    ),
    "of_wear": Mechanism(
        "chance widens the ± of wear", {f"{CHANCE}Chance.of_wear": lambda self: np.ones(len(self.since))}, (*CORE, "slow-common")
    ),
    # temperature
    "temperature": Mechanism("friction depends on temperature", {f"{STATE}FilterState.row": _row_at_origin}, ("plain", "summer-24")),
    "curve": Mechanism("… along a curve", {f"{STATE}FilterState.row": _row_without_curve}, ("plain", "summer-24")),
    "lag": Mechanism(
        "grease lags behind the motor",
        {f"{STATE}saturating": np.zeros_like, f"{INNOVATION}saturating": np.zeros_like},
        ("plain", "summer-24", "grease-lag"),
    ),
    "uneven_share": Mechanism("… by several lags", _drift(uneven_share=0.0), ("plain", "summer-24", "grease-lag")),
    "blind_var": Mechanism(
        "replays without a temperature miss alike", {f"{INNOVATION}blind_var": lambda state, _, s: state.missed_var(s)}, ("sensor-silent",)
    ),
    # falls, common changes, payloads
    "count_from_lowest": Mechanism(
        "wear counts from the lowest level",
        {f"{STEP}count_from_lowest": lambda state, *_: state},
        (*CORE, "running-in", "regrease-then-wear"),
    ),
    "_rise_suspected": Mechanism(
        "… unless a rise is suspected", {f"{LOWEST}_rise_suspected": lambda s: _no(s.joints)}, ("plain", "running-in")
    ),
    "common_changes": Mechanism(
        "a change of most joints is none of one",
        {f"{CHANGE}common_changes": lambda found, *_: _no(len(found))},
        (*CORE, "slow-common", "payload-03"),
    ),
    "_loaded": Mechanism(
        "… nor one of shoulder and elbow", {f"{D}update.blame._loaded": lambda z, *_: _no(len(z))}, ("plain", "payload-03")
    ),
    "weigh": Mechanism(
        "weights contradict the declared payload",
        {f"{PLAY}weigh": lambda weights, *_, **__: (weights, NO_UNDECLARED_CHANGE)},
        ("payload-03",),
    ),
    # evidence
    "advisory_sigmas": Mechanism("wear must be significant", {f"{EVIDENCE}advisory_sigmas": lambda *_: 0.0}),
    "required_of_joints": Mechanism(
        "… less where it was found, more where not",
        {f"{EVIDENCE}required_of_joints": lambda after, sigmas: np.full(len(after.wear), sigmas)},
    ),
    "advisory_rise": Mechanism("wear must be 1 %", _health(advisory_rise=1e-6)),
    "min_replays": Mechanism("three replays on two days must agree", _health(min_replays=1, min_days=1)),
    "agreeing": Mechanism("… and all since a change do", {f"{PLAY}wear_of_state": _each_replay_counts_once}),
    "not_of_one_joint": Mechanism(
        "what most joints rose by is none of one",
        {f"{EVIDENCE}not_of_one_joint": lambda wear, *_: np.zeros(len(wear))},
        ("plain", "one-over-f", "slow-common"),
    ),
    "_common_rise": Mechanism(
        "joints that rise together are a common advisory",
        {f"{EVIDENCE}_common_rise": lambda wear, _, __, J, *___: np.zeros(len(wear) // J)},
        ("plain", "one-over-f", "slow-common"),
    ),
    # beside F(v*), and what is published
    "channels": Mechanism("channels beside F(v*)", {f"{STEP}update_channels": lambda *_: None}, (*CORE, "low-speed-wear")),
    "undetected_change": Mechanism(
        "changes that are not found yet widen the ±",
        {f"{PLAY}undetected_change": lambda state, *_: np.zeros((2, state.joints))},
        ("plain",),
    ),
}


@contextmanager
def without(name: str) -> Iterator[None]:
    """The judge without a mechanism."""
    with ExitStack() as stack:
        for target, replacement in MECHANISMS[name].off.items():
            stack.enter_context(patch(target, replacement))
        yield


# --- Worlds are judged together: a step of many arms costs little more than one of a few ---


class Fleets:
    """The arms of several worlds as one fleet, as `judge_world` needs it: replays as often in each, as many days, weighed or not."""

    def __init__(self, fleets: Sequence[WorldFleet]) -> None:
        first = fleets[0]
        self.fleets, self.days, self.joints, self.replays_a_day = fleets, first.days, first.joints, first.replays_a_day
        self.arms = sum(each.arms for each in fleets)
        self.world = max((each.world for each in fleets), key=lambda world: len(world.wear))  # for its kinds of wear, none with a life
        self.group, self.onset_day, self.unit_days, self.worn = (
            np.concatenate([getattr(each, name) for each in fleets]) for name in ("group", "onset_day", "unit_days", "worn")
        )
        self.undeclared = np.concatenate([each.undeclared for each in fleets], axis=1)

    def morning(self, number: int) -> Day:
        """The replays of that number of all arms."""
        days = [each.morning(number) for each in self.fleets]
        seen = [each.seen for each in days]
        joined = {name: np.concatenate([getattr(each, name) for each in days]) for name in JOINED}
        rigid = None if days[0].rigid is None else tuple(fit for each in days for fit in each.rigid or ())
        return Day(**joined, seen=Observation(*(np.concatenate(parts) for parts in zip(*seen, strict=True))), rigid=rigid)

    def log_torque_at(self, number: int, temperature_c: Array) -> Array:
        """(A, J) as of each fleet."""
        parts = np.split(temperature_c, np.cumsum([each.arms for each in self.fleets])[:-1])
        return np.concatenate([each.log_torque_at(number, part) for each, part in zip(self.fleets, parts, strict=True)])


JOINED = ("replayed", "slot", "opened", "truth", "worn", "revolutions", "used_days")  # fields of a day


def judged_together(fleets: Sequence[WorldFleet]) -> list[Verdicts]:
    """The verdicts of each fleet."""
    together, J, first = judge_world(cast(WorldFleet, Fleets(fleets)), SETTINGS), fleets[0].joints, 0
    result = []
    for fleet in fleets:
        arms = slice(first, first + fleet.arms)
        joints = slice(arms.start * J, arms.stop * J)
        of_arms = {name: getattr(together, name)[arms] for name in ("found_day", "before", "wrong")}
        episodes = {name: _some(getattr(together, name), joints, ("first", "count")) for name in ("rising", "falling")}
        episodes |= {name: _some(getattr(together, name), arms, ("first", "count")) for name in ("common", "payload", "no_payload")}
        coverage = _some(together.coverage, arms, ("held", "of"))
        result.append(replace(together, fleet=fleet, coverage=coverage, **of_arms, **episodes))
        first = arms.stop
    return result


def _some(whole: Any, which: slice, names: Sequence[str]) -> Any:
    """A part of episodes, or of a coverage: these arrays of it."""
    part = copy(whole)
    for name in names:
        setattr(part, name, getattr(whole, name)[which])
    return part


def played(names: Sequence[str], worlds: Sequence[str] | None, *, arms: int, worn: int, days: int, seed: int) -> Iterator[dict[str, Any]]:
    """`world_document` of each world, with `off` the mechanism that is off, None first. worlds : None: those of each mechanism."""
    asked = {name: MECHANISMS[name].worlds if worlds is None else worlds for name in names}
    pairs = {
        world: fleets_of(WORLDS[world], arms=arms, days=days, seed=seed, worn=worn)
        for world in dict.fromkeys(world for each in asked.values() for world in each)
    }
    for name, tried in ((None, list(pairs)), *asked.items()):
        alike: dict[Any, list[str]] = {}
        for world in tried:
            alike.setdefault(tuple((each.replays_a_day, each.days, each.morning(0).rigid is None) for each in pairs[world]), []).append(
                world
            )
        for some in alike.values():
            with nullcontext() if name is None else without(name):
                healthy, worn_ones = (judged_together([pairs[world][side] for world in some]) for side in (0, 1))
            for one, other in zip(healthy, worn_ones, strict=True):
                yield {"off": name, **world_document(one, other)}


# --- The table: a row for each mechanism, over its worlds ---

HEAD = """| without | which does | worlds | false advisories, a robot-year | 5 % step: days | 10 % a year: days | never found, of | 90 % intervals: healthy, until found | most |
|---|---|---|---|---|---|---|---|---|
"""  # noqa: E501 - a table's head


def table(documents: Iterable[dict[str, Any]]) -> str:
    """Each mechanism's price: the judge of today → without it, on the same arms, over all of its worlds."""
    today: dict[str, dict[str, Any]] = {}
    others: dict[str, list[dict[str, Any]]] = {}
    for document in documents:
        if document["off"] is None:
            today[document["world"]] = document
        else:
            others.setdefault(document["off"], []).append(document)
    return HEAD + "".join(
        _row(name, [today[each["world"]] for each in others[name]], others[name]) for name in MECHANISMS if name in others
    )


def _row(name: str, today: list[dict[str, Any]], off: list[dict[str, Any]]) -> str:
    both = (today, off)
    events = [sum(_counted(each)["events"] for each in side) for side in both]
    rates = [count / sum(each["robot_years"] for each in side) for count, side in zip(events, both, strict=True)]
    missed = [sum(row["never"]["hits"] for each in side for row in each["detection"]) for side in both]
    of = sum(row["arms"] for each in off for row in each["detection"])
    cover = [f"{_mean(side, 'healthy'):.0f}, {_until_found(side):.0f}" for side in both]
    cells = (
        f"`{name}`",
        MECHANISMS[name].what,
        str(len(off)),
        f"{rates[0]:.2f} → {rates[1]:.2f} ({events[0]} → {events[1]})",
        _ratio(today, off, "5 % step"),
        _ratio(today, off, "10 %/year"),
        f"{missed[0]} → {missed[1]}, {of}",
        f"{cover[0]} → {cover[1]}",
        _most(today, off),
    )
    return f"| {' | '.join(cells)} |\n"


def _counted(document: dict[str, Any]) -> dict[str, Any]:
    counted: dict[str, Any] = document["false_advisories"]["counted"]
    return counted


def _medians(document: dict[str, Any]) -> dict[str, float]:
    """Median days to each kind of wear."""
    return {row["wear"]: np.inf if row["median_days"] is None else row["median_days"] for row in document["detection"]}


def _ratio(today: list[dict[str, Any]], off: list[dict[str, Any]], wear: str) -> str:
    """Median over worlds of the median days without over those of today."""
    pairs = [(_medians(a).get(wear), _medians(b).get(wear)) for a, b in zip(today, off, strict=True)]
    ratios = [np.inf if b == np.inf else b / a for a, b in pairs if a is not None and b is not None and a < np.inf]
    if not ratios:
        return "–"
    middle = float(np.median(ratios))
    return "never" if middle == np.inf else f"× {middle:.2f}"


def _mean(side: list[dict[str, Any]], key: str) -> float:
    return 100.0 * float(np.mean([each["interval_90"][key] for each in side]))


def _until_found(side: list[dict[str, Any]]) -> float:
    shares = [row["interval_90_undetected"] for each in side for row in each["detection"]]
    return 100.0 * float(np.mean([share for share in shares if share is not None]))


def _most(today: list[dict[str, Any]], off: list[dict[str, Any]]) -> str:
    """The worlds in which false advisories, and in which days change most."""
    pairs = list(zip(today, off, strict=True))
    a, b = max(pairs, key=lambda pair: abs(_counted(pair[1])["events"] - _counted(pair[0])["events"]))
    texts = []
    if _counted(a)["events"] != _counted(b)["events"]:
        texts.append(f"{a['world']} {_counted(a)['per_year']:.2f} → {_counted(b)['per_year']:.2f}")
    changed = [
        (abs(np.log(min(after, 1e4) / min(before, 1e4))), each["world"], wear, before, after)
        for each, other in pairs
        for wear, before in _medians(each).items()
        for after in [_medians(other)[wear]]
    ]
    size, world, wear, before, after = max(changed, default=(0.0, "", "", 0.0, 0.0))
    if size > 0.0 and _days(before) != _days(after):
        texts.append(f"{world} {wear} {_days(before)} → {_days(after)} d")
    return "; ".join(texts)


def _days(days: float) -> str:
    return "never" if days == np.inf else f"{days:.0f}"


def main() -> None:
    """Play the mechanisms that the command line names, or all."""
    listed = "\n".join(f"  {name:20s}{each.what}" for name, each in MECHANISMS.items())
    parser = argparse.ArgumentParser(
        prog="python -m tests.evidence.ablation",
        description=__doc__,
        epilog=f"Mechanisms:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="mechanisms; none: all")
    parser.add_argument("--worlds", nargs="+", metavar="WORLD", help="instead of those of each mechanism")
    parser.add_argument("--arms", type=at_least_one, default=20, help="healthy arms (default 20)")
    parser.add_argument("--worn", type=at_least_one, default=15, help="arms with each kind of wear (default 15)")
    parser.add_argument("--days", type=at_least_one, default=1095, help="of every arm's life (default 1095)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="one object a line, as they come")
    parser.add_argument("--read", type=Path, help="no playing: the table of what --json printed into this file")
    arguments = parser.parse_args()
    if arguments.read:
        sys.stdout.write(table(json.loads(line) for line in arguments.read.read_text("utf-8").splitlines()))
        return
    names, worlds = arguments.names or list(MECHANISMS), arguments.worlds
    if unknown := [name for name in (*names, *(worlds or ())) if name not in MECHANISMS and name not in WORLDS]:
        parser.error(f"unknown: {', '.join(unknown)}; expected mechanisms of: {', '.join(MECHANISMS)}; worlds of: {', '.join(WORLDS)}")
    documents = played(names, worlds, arms=arguments.arms, worn=arguments.worn, days=arguments.days, seed=arguments.seed)
    if not arguments.json:
        sys.stdout.write(table(documents))
        return
    for document in documents:
        sys.stdout.write(json.dumps(document, allow_nan=False) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
