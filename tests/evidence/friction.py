"""What the one model of `monitor.judge.friction` reaches in the worlds, on the arms that the judge of the daemon has there.

`python -m tests.evidence.friction WORLD… [--arms --worn --seed --json]`: false advisories a robot-year of healthy arms, days to detection,
and how often 90 % intervals of friction hold the truth: of healthy joints, and of worn ones before they are found. Counted as in
`monitor.studies.worlds.verdicts`. The series beside friction at the reference speed are judged by the same model, with other priors.
"""

import argparse
import json
import time
from typing import Any, NamedTuple

import numpy as np

from monitor.judge.drift.observation import Observation
from monitor.judge.friction.beside import model_beside, observations_beside
from monitor.judge.friction.step import FrictionModel, FrictionState, initial_state, step
from monitor.judge.settings import AssessSettings
from monitor.recording import Array
from monitor.studies.figures import DAYS_A_YEAR
from monitor.studies.rehearsal.play import LEARNING_DAYS, Episodes, Weighed
from monitor.studies.worlds.fleet import World, WorldFleet
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import CONTRADICTIONS, days_document, fleets_of

from . import at_least_one
from .baselines import days_cell

COVERAGE_EVERY = 7  # replays
HEAD = "| world | false a robot-year | days | 90 % of F: healthy, not yet found |\n|---|---|---|---|"


class Found(NamedTuple):
    """What the model found in a fleet; days are those of its life, infinite is never."""

    fleet: WorldFleet
    told: dict[str, Episodes]  # rising and falling of the joints, common and payload of the arms
    found_day: Array  # (A,) of the wear, on or after its onset
    before: np.ndarray  # (A,) told before the onset
    held: Array  # (2, 2) intervals that held the truth, and all: of healthy joints, of worn ones not yet found
    seconds: float


class Beside:
    """The series beside friction at the reference speed, of A arms with J joints."""

    def __init__(self, joints_per_arm: int, levels: int) -> None:
        self.joints_per_arm, self.levels = joints_per_arm, levels
        self.states: dict[str, FrictionState] = {}

    def risen(self, seen: Observation, days: Array, **options: Any) -> np.ndarray:
        """(A, J) joints of which a series tells wear after a replay. A current that is noisier is no wear."""
        J, found = self.joints_per_arm, np.zeros((len(days), self.joints_per_arm), dtype=bool)
        for name, observation in observations_beside(seen).items():
            model = model_beside(name)
            state = self.states.get(name) or initial_state(observation, J, model, levels=self.levels)
            self.states[name] = step(state, observation, days, model, in_place=True, **options)
            if name != "noise":
                found |= self.states[name].risen.reshape(-1, J + 1)[:, :J]
        return found


def judge(fleet: WorldFleet, model: FrictionModel, assess: AssessSettings) -> Found:
    """The fleet's life, replay by replay."""
    A, J, started = fleet.arms, fleet.joints, time.process_time()
    told = {name: Episodes(A * J if name in {"rising", "falling"} else A) for name in ("rising", "falling", "common", "payload")}
    found, before, previously = np.full(A, np.inf), np.zeros(A, dtype=bool), np.zeros(A, dtype=bool)
    last, contradicted, weighed = np.zeros(A), np.zeros(A), Weighed(A)
    several = bool(fleet.undeclared.any())
    many, held = fleet.worn.sum(axis=1) >= 3, np.zeros((2, 2))
    state: FrictionState | None = None
    beside = Beside(J, 4 if several else 1)
    for number in range(fleet.days * fleet.replays_a_day):
        day, now = number / fleet.replays_a_day, fleet.morning(number)
        state = state or initial_state(now.seen, J, model, levels=4 if several else 1)
        weights = weighed.weigh(now, day, assess.health)
        opened = weights.opened & (day > 0)
        contexts = {"slot": weights.slot, "opened": opened, "withheld": weights.withheld} if several else {}
        state = step(state, now.seen, day - last, model, replayed=now.replayed, in_place=True, **contexts)
        at_other_speeds = beside.risen(now.seen, day - last, replayed=now.replayed, **contexts)
        last = np.where(now.replayed, day, last)
        raised, common = (
            state.risen.reshape(A, J + 1)[:, :J] | at_other_speeds,
            state.risen.reshape(A, J + 1)[:, J] | state.told.common.any(axis=0),
        )
        told["rising"].add(day, raised.ravel(), LEARNING_DAYS)
        told["falling"].add(day, state.told.falls.reshape(A, J + 1)[:, :J].ravel(), LEARNING_DAYS)
        told["common"].add(day, common, LEARNING_DAYS)
        contradicted = np.where(now.replayed, (contradicted + 1) * weights.contradicted, contradicted)
        told["payload"].add(day, (contradicted >= CONTRADICTIONS) & ~fleet.undeclared[number] & now.replayed, LEARNING_DAYS)
        own, after = (raised & fleet.worn).any(axis=1) | (many & common), day >= fleet.onset_day
        before |= own & ~after & (day >= LEARNING_DAYS) | own & (day == fleet.onset_day) & previously
        found[own & after & np.isinf(found)] = day
        previously = own
        if day >= LEARNING_DAYS and number % COVERAGE_EVERY == 0:
            inside = _holds(fleet, state, number, model)
            worn = now.worn > 0
            for k, mask in enumerate((~worn, worn & np.isinf(found)[:, None])):
                seen = mask & now.replayed[:, None]
                held[:, k] += (inside & seen).sum(), seen.sum()
    return Found(fleet, told, found, before, held, time.process_time() - started)


def _holds(fleet: WorldFleet, state: FrictionState, number: int, model: FrictionModel) -> np.ndarray:
    """(A, J) whether the 90 % interval of friction at the reference temperature holds the truth."""
    A, J = fleet.arms, fleet.joints
    truth = np.zeros((A, J + 1))
    truth[:, :J] = fleet.log_torque_at(number, state.reference_c.reshape(A, J + 1)[:, :J])
    below = state.friction(state.reference_c, model).below(truth.ravel()).reshape(A, J + 1)[:, :J]
    inside: np.ndarray = (below > 0.05) & (below < 0.95)
    return inside


def document(world: World, *, arms: int, worn: int, days: int, seed: int, model: FrictionModel | None = None) -> dict[str, Any]:
    """The figures of a world."""
    model, assess = model or FrictionModel(), AssessSettings()
    healthy, wearing = (judge(fleet, model, assess) for fleet in fleets_of(world, arms=arms, days=days, seed=seed, worn=worn))
    years = arms * (days - LEARNING_DAYS) / DAYS_A_YEAR
    events = {name: int(np.isfinite(episodes.first).sum()) for name, episodes in healthy.told.items()}
    counted = sum(events[name] for name in (*world.goal.counted, "payload"))
    detection = []
    for k, wear in enumerate(world.wear):
        here = (wearing.fleet.group == k) & ~wearing.before
        delays = wearing.found_day[here] - wearing.fleet.onset_day[here] + 1.0
        detection.append({"wear": wear.name, "before": int(((wearing.fleet.group == k) & wearing.before).sum()), **days_document(delays)})
    return {
        "world": world.name,
        "robot_years": years,
        "false_per_year": counted / years,
        "events": events,
        "detection": detection,
        "interval_90": {"healthy": _share(healthy.held[:, 0]), "not_yet_found": _share(wearing.held[:, 1])},
        "arm_days_a_minute": 60.0 * arms * days / healthy.seconds,
    }


def _share(held: Array) -> float | None:
    return float(held[0] / held[1]) if held[1] else None


def row(of: dict[str, Any]) -> str:
    """The figures of a world as a row of a table."""
    shares = ", ".join("–" if share is None else f"{100 * share:.0f} %" for share in of["interval_90"].values())
    return f"| {of['world']} | {of['false_per_year']:.3f} | {days_cell(of['detection'])} | {shares} |"


def main() -> None:
    """Play the worlds that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m tests.evidence.friction", description=__doc__.split("\n\n")[0] if __doc__ else None)
    parser.add_argument("names", nargs="+", metavar="WORLD", choices=[*WORLDS, "all"], help="worlds, or: all")
    parser.add_argument("--arms", type=at_least_one, default=40, help="healthy ones")
    parser.add_argument("--worn", type=at_least_one, default=20, help="arms with each kind of wear")
    parser.add_argument("--days", type=at_least_one, default=1095, help="of every healthy arm")
    parser.add_argument("--seed", type=int, default=1, help="1 to 99 were for development")
    parser.add_argument("--json", action="store_true", help="a JSON object a line")
    options = parser.parse_args()
    if not options.json:
        print(HEAD)
    for name in WORLDS if options.names == ["all"] else options.names:
        of = document(WORLDS[name], arms=options.arms, worn=options.worn, days=options.days, seed=options.seed)
        print(json.dumps(of, ensure_ascii=False) if options.json else row(of), flush=True)


if __name__ == "__main__":
    main()
