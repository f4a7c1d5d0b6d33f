"""`python -m tests.evidence.sought`: days to detection of arms that sought temperatures, beside the same arms that did not.

What `[schedule] seek_temperatures` does, on the fleet of the worlds: where an arm had no replay for a week at the 5 K about its temperature
after work, or about that of a cold start, the day's replay is made there instead of in the morning after 40 minutes. The daemon makes it
beside that.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from monitor.judge.settings import AssessSettings
from monitor.publish.compensation import NODES_C, SOUGHT_AGAIN_DAYS
from monitor.recording import Array
from monitor.studies.worlds.laws import Heat, Temperatures
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import play_world

from . import at_least_one
from .informed import informed_documents
from .worlds import world_line

AFTER_WORK_K = (11.0, 17.0)  # rise of a UR5's joints in half an hour, Raviola et al. (2021), section 4
APART_K = float(NODES_C[1] - NODES_C[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class SoughtHeat(Heat):
    """The temperatures of arms that seek those that they lack."""

    def at_replays(self, rng: np.random.Generator, shape: tuple[int, int, int], replays_a_day: int = 1) -> Temperatures:
        """The temperatures (R, A, J) at all replays."""
        ordinary = Heat.at_replays(self, rng, shape, replays_a_day)
        replays, arms, joints = shape
        rise = rng.uniform(*AFTER_WORK_K, (replays, arms, 1)) * rng.uniform(0.9, 1.1, (arms, joints))
        # the morning's rise is not kept by `Heat`: from its rate, and the mean time since the start
        since = 0.5 * sum(self.started_min)
        left = np.exp(-since / self.warm_up_min)
        cold = ordinary.motor_c - ordinary.warming_k_per_min * self.warm_up_min * (1.0 - left) / left
        places = np.stack([cold + rise, cold, ordinary.motor_c])  # (3, R, A, J): after work, cold, in the morning
        which = _sought(places.mean(axis=-1), SOUGHT_AGAIN_DAYS * replays_a_day)
        at = which[None, ..., None]

        def chosen(parts: Array) -> Array:
            found: Array = np.take_along_axis(parts, at, axis=0)[0]
            return found

        grease = chosen(np.stack([cold + rise, cold, ordinary.grease_c]))
        return Temperatures(grease, chosen(places), chosen(np.stack([0.0 * rise, 0.0 * rise, ordinary.warming_k_per_min])))


def _sought(places_c: Array, again: float) -> np.ndarray:
    """(R, A) which of (3, R, A) places each replay is made at: the first two where none was there for `again` replays, else the last."""
    _, R, A = places_c.shape
    rows = np.clip(np.rint(places_c / APART_K).astype(int), 0, 20)
    seen, arms = np.full((A, 21), -np.inf), np.arange(A)
    which = np.full((R, A), 2)
    for r in range(R):
        for place in (1, 0):
            which[r] = np.where(r - seen[arms, rows[place, r]] >= again, place, which[r])
        seen[arms, rows[which[r], r, arms]] = r
    return which


def compare(name: str, *, arms: int, days: int, seed: int) -> Iterator[str]:
    """Lines of the world as it is, and with arms that seek; each with what an observer finds who knows the noise, where there is one."""
    world = WORLDS[name]
    heat = SoughtHeat(**{field.name: getattr(world.heat, field.name) for field in fields(Heat)})
    for each in (world, replace(world, name=f"{name}, sought", heat=heat)):
        yield world_line(play_world(each, AssessSettings(), arms=arms, days=days, seed=seed))
        for found in informed_documents(each, arms=arms, days=days, seed=seed, per_year=(world.goal.false,)):
            yield f"  who knows the noise, {found['wear']}: median {found['median_days']:g}, nine of ten {found['p90_days']} d"


def main() -> None:
    """Print the lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[*WORLDS, []], metavar="WORLD", help="default: summer-24-sudden")
    parser.add_argument("--arms", type=at_least_one, default=120)
    parser.add_argument("--days", type=at_least_one, default=600)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    for name in given.names or ["summer-24-sudden"]:
        for line in compare(name, arms=given.arms, days=given.days, seed=given.seed):
            sys.stdout.write(f"{line}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
