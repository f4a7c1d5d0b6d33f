"""`python -m tests.evidence.baselines WORLD [WORLD…|all]`: what control charts that every reader knows find on the judge's own arms.

Friction is corrected for temperature and prewhitened, each joint by itself: log F is a regression on level, temperature, its square and the
warming, with the robot family's prior, whose residual is an autoregression of first order (Cochrane and Orcutt, 1949); the errors of its
prediction of the next replay, over their standard deviation, are on average 0 ± 1 and independent where nothing changes (Brown, Durbin and
Evans, 1975). They are charted (Montgomery, Introduction to Statistical Quality Control, chapters 6, 9 and 10.4).

The regression is first fitted to the learning days and then again before every replay, to all replays so far. A chart begins after the
learning days. It counts rises only, the first of each joint; one threshold is that of all joints.

Shapes: D days, N joints, P = 4 coefficients, Z = 1 + P.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from monitor.judge.settings import AssessSettings
from monitor.recording import Array
from monitor.studies.rehearsal.play import LEARNING_DAYS
from monitor.studies.worlds.fleet import WorldFleet
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import fleets_of, judge_world, world_document

from . import at_least_one
from .informed import FIRST_REPLAYS, MEAN, STD, TEN_K, Seen, days_to_crossing, largest_of_arms, seen_of

PLAIN = "plain"  # the world whose thresholds are carried to the others
WEIGHT = 0.1  # λ of the EWMA: Montgomery has 0.05 to 0.25
REFERENCE, OF_SLOW = 0.5, 0.25  # [σ] k of the CUSUM, half of the shift that it is for: 1 σ, as a step is; and ½ σ, for slow wear
SWEEPS = 3  # between coefficients and correlation; the next replay goes on where they end
FAMILY_RHO, FAMILY_STD = 0.5, 0.02  # of the residual, where the first fit begins
MOST_RHO, LEAST_STD = 0.95, 0.001  # of it


class Moments(NamedTuple):
    """Sums over the replays of (y, x), with a replay before each, (N, Z, Z) each; and their number, (N,)."""

    now: Array  # Σ z·zᵀ
    lagged: Array  # Σ z·z₋₁ᵀ
    before: Array  # Σ z₋₁·z₋₁ᵀ
    replays: Array

    def whitened(self, rho: Array) -> Array:
        """(N, Z, Z) Σ (z − ρ·z₋₁)·(z − ρ·z₋₁)ᵀ; rho : (N,)."""
        r = rho[:, None, None]
        return self.now - r * (self.lagged + np.swapaxes(self.lagged, 1, 2)) + r**2 * self.before


class Regression(NamedTuple):
    """Coefficients of level, temperature [10 K], its square and warming [K/min], and the residual's autoregression."""

    mean: Array  # (N, P)
    cov: Array  # (N, P, P)
    rho: Array  # (N,)
    var: Array  # (N,) of what is new in a replay


def fit(moments: Moments, start: Regression) -> Regression:
    """The regression of all replays so far, from where the one before ended.

    ρ of n residuals is too small by (1 + 3ρ)/n (Marriott and Pope, 1954).
    """
    _, cov, rho, var = start
    precision = np.diag(np.square(STD) ** -1.0)
    n = np.maximum(moments.replays, len(MEAN) + 1.0)
    for _ in range(SWEEPS):
        M = moments.whitened(rho) / var[:, None, None]
        cov = np.linalg.inv(M[:, 1:, 1:] + precision)
        mean = np.einsum("npq,nq->np", cov, M[:, 1:, 0] + precision @ MEAN)
        v = np.concatenate([np.ones((len(mean), 1)), -mean], axis=1)
        each, before = (np.einsum("nz,nzy,ny->n", v, sums, v) for sums in (moments.lagged, moments.before))
        seen = each / np.maximum(before, 1e-12)
        rho = np.clip(seen + (1.0 + 3.0 * seen) / n, 0.0, MOST_RHO)
        left = np.einsum("nz,nzy,ny->n", v, moments.whitened(rho), v)
        var = np.maximum(left / (n - len(MEAN)), LEAST_STD**2)
    return Regression(mean, cov, rho, var)


def innovations(seen: Seen, learn_days: int | None = None) -> Array:
    """(D, N) error of each prediction over its standard deviation, from `LEARNING_DAYS` on; NaN where there is none.

    learn_days : the regression is not fitted again from that day on; None: it is, before every replay.
    """
    D, N = seen.log_torque.shape
    away = (seen.temperature_c - np.nanmean(seen.temperature_c[:FIRST_REPLAYS], axis=0)) / TEN_K
    rows = np.stack([seen.log_torque, np.ones((D, N)), away, away**2, np.nan_to_num(seen.warming_k_per_min)], axis=2)
    moments = Moments(*np.zeros((3, N, rows.shape[2], rows.shape[2])), np.zeros(N))
    rho, var = np.full(N, FAMILY_RHO), np.full(N, (1.0 - FAMILY_RHO**2) * FAMILY_STD**2)
    regression = Regression(np.tile(MEAN, (N, 1)), np.tile(np.diag(np.square(STD)), (N, 1, 1)), rho, var)
    before, result = np.full(rows.shape[1:], np.nan), np.full((D, N), np.nan)
    for day, row in enumerate(rows):
        here = np.isfinite(row).all(axis=1)
        pair = here & np.isfinite(before).all(axis=1)
        z, z_before = (np.where(pair[:, None], each, 0.0) for each in (row, before))
        if day >= LEARNING_DAYS:
            if learn_days is None or day <= max(learn_days, LEARNING_DAYS):
                regression = fit(moments, regression)
            new = z - regression.rho[:, None] * z_before
            error = new[:, 0] - np.einsum("np,np->n", new[:, 1:], regression.mean)
            var = regression.var + np.einsum("np,npq,nq->n", new[:, 1:], regression.cov, new[:, 1:])
            result[day] = np.where(pair, error / np.sqrt(var), np.nan)
        moments = Moments(
            moments.now + z[:, :, None] * z[:, None, :],
            moments.lagged + z[:, :, None] * z_before[:, None, :],
            moments.before + z_before[:, :, None] * z_before[:, None, :],
            moments.replays + pair,
        )
        before = np.where(here[:, None], row, before)
    return result


# --- Charts: (2, D, N) statistic of a rise and of a fall, of standardised observations (D, N); days without one change nothing ---


def shewhart(z: Array) -> Array:
    """Each observation alone (Shewhart, 1931)."""
    return np.stack([np.nan_to_num(z), -np.nan_to_num(z)])


def ewma(z: Array, weight: float = WEIGHT) -> Array:
    """Their exponentially weighted moving average over its exact standard deviation (Roberts, 1959; Montgomery, 9.2)."""
    mean, number, result = np.zeros(z.shape[1]), np.zeros(z.shape[1]), np.zeros(z.shape)
    for day, each in enumerate(z):
        known = np.isfinite(each)
        number += known
        mean = np.where(known, (1.0 - weight) * mean + weight * np.nan_to_num(each), mean)
        var = weight / (2.0 - weight) * (1.0 - (1.0 - weight) ** (2.0 * number))
        result[day] = mean / np.sqrt(np.maximum(var, 1e-12))
    return np.stack([result, -result])


def cusum(z: Array, reference: float = REFERENCE) -> Array:
    """C⁺ = max(0, C⁺ + z − k) and C⁻ = max(0, C⁻ − z − k): the tabular CUSUM (Page, 1954; Montgomery, 9.1)."""
    sums, result = np.zeros((2, z.shape[1])), np.zeros((2, *z.shape))
    for day, each in enumerate(z):
        sums = np.where(np.isfinite(each), np.maximum(0.0, sums + np.stack([each, -each]) - reference), sums)
        result[:, day] = sums
    return result


CHARTS: Mapping[str, Callable[[Array], Array]] = {
    "Shewhart": shewhart,
    "EWMA": ewma,
    "CUSUM": cusum,
    f"CUSUM k {OF_SLOW:g}": partial(cusum, reference=OF_SLOW),
}


def rises(fleet: WorldFleet, joints: np.ndarray, learn_days: int | None = None) -> dict[str, Array]:
    """(D − LEARNING_DAYS, n) of each chart, of some joints of a fleet: how far they have risen."""
    z = innovations(seen_of(fleet, joints), learn_days)[LEARNING_DAYS:]
    return {name: chart(z)[0] for name, chart in CHARTS.items()}


# --- The judge and the charts in one world ---


class Charted(NamedTuple):
    """A world that the judge and the charts have seen."""

    document: dict[str, Any]  # of `world_document`
    wearing: WorldFleet
    highest: dict[str, Array]  # of each chart, (N,) of healthy joints, descending
    rises: dict[str, Array]  # of each chart, (D, A) of the joints that wear

    def tuned(self) -> dict[str, float]:
        """Thresholds by which each chart has as many false advisories as the judge."""
        events = self.document["false_advisories"]["counted"]["events"]
        return {name: float(highest[min(events, len(highest) - 1)]) for name, highest in self.highest.items()}

    def by(self, thresholds: Mapping[str, float]) -> dict[str, dict[str, Any]]:
        """False advisories and days to detection of each chart, by its threshold."""
        return {name: self._by(name, threshold) for name, threshold in thresholds.items()}

    def _by(self, name: str, threshold: float) -> dict[str, Any]:
        fleet, events = self.wearing, int((self.highest[name] > threshold).sum())
        kinds = [(wear.name, fleet.group == k) for k, wear in enumerate(fleet.world.wear)]
        return {
            "threshold": threshold,
            "events": events,
            "per_year": events / self.document["robot_years"],
            "detection": [
                {"wear": wear, **days_to_crossing(self.rises[name][:, mine], fleet.onset_day[mine], threshold)} for wear, mine in kinds
            ],
        }


def charted(name: str, *, arms: int, worn: int, days: int, seed: int, learn_days: int | None = None) -> Charted:
    """A world's arms, judged and charted; the arguments are those of `play_world`."""
    healthy, wearing = fleets_of(WORLDS[name], arms=arms, days=days, seed=seed, worn=worn)
    assess = AssessSettings()
    document = world_document(judge_world(healthy, assess), judge_world(wearing, assess))
    chance = rises(healthy, np.arange(healthy.arms * healthy.joints), learn_days)
    worn_joints = rises(wearing, np.flatnonzero(wearing.worn), learn_days)
    return Charted(
        document,
        wearing,
        {chart: np.sort(each.max(axis=0))[::-1] for chart, each in chance.items()},
        {chart: largest_of_arms(each, wearing) for chart, each in worn_joints.items()},
    )


def comparison(world: Charted, of_plain: Mapping[str, float]) -> dict[str, Any]:
    """One world's figures: the judge's, the charts' at as many false advisories, and by the thresholds of `plain`."""
    document = world.document
    return {
        "world": document["world"],
        "robot_years": document["robot_years"],
        "judge": {**document["false_advisories"]["counted"], "detection": document["detection"]},
        "tuned": world.by(world.tuned()),
        "by_thresholds_of_plain": world.by(of_plain),
    }


HEAD = (
    "| world | judge: false a robot-year | judge: days | "
    + " | ".join(f"{name}: days" for name in CHARTS)
    + " | thresholds of `plain`: false a robot-year |\n"
    + "|---|---|---|"
    + "---|" * len(CHARTS)
    + "---|\n"
)


def table_row(one: dict[str, Any]) -> str:
    """Median days and, in brackets, nine of ten, of each kind of wear of the world; charts tuned to the judge's false advisories."""
    plainly = ", ".join(f"{each['per_year']:.2f}" for each in one["by_thresholds_of_plain"].values())
    cells = [one["world"], f"{one['judge']['per_year']:.3f}", days_cell(one["judge"]["detection"])]
    cells += [days_cell(each["detection"]) for each in one["tuned"].values()]
    return f"| {' | '.join([*cells, plainly])} |\n"


def days_cell(detection: Sequence[Mapping[str, Any]]) -> str:
    """Median days to each kind of wear, and nine of ten; – is never."""
    figures = [["–" if row[key] is None else f"{row[key]:.0f}" for key in ("median_days", "p90_days")] for row in detection]
    return "; ".join(f"{median} ({nine})" for median, nine in figures)


def main() -> None:
    """Judge and chart the worlds that the command line names."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.evidence.baselines", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    daily = [name for name, world in WORLDS.items() if world.replays_a_day == 1]
    parser.add_argument("names", nargs="*", metavar="WORLD", help="of one replay a day, or: all")
    parser.add_argument("--arms", type=at_least_one, default=40, help="healthy arms (default 40)")
    parser.add_argument("--worn", type=at_least_one, default=30, help="arms with each kind of wear (default 30)")
    parser.add_argument("--days", type=at_least_one, default=1095, help="of every arm's life (default 1095)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--learn-days", type=at_least_one, default=None, help="the regression is not fitted again from that day on")
    parser.add_argument("--json", action="store_true", help="one object a line")
    parser.add_argument("--read", type=Path, help="no playing: the table of what --json printed into this file")
    arguments = parser.parse_args()
    if arguments.read:
        sys.stdout.write(HEAD + "".join(table_row(json.loads(line)) for line in arguments.read.read_text("utf-8").splitlines()))
        return
    names = daily if arguments.names == ["all"] else arguments.names
    unknown = [name for name in names if name not in daily]
    if unknown or not names:
        parser.error(f"no world of one replay a day: {', '.join(unknown) or 'none named'}; expected of: {', '.join(daily)}, all")
    size = {"arms": arguments.arms, "worn": arguments.worn, "days": arguments.days, "seed": arguments.seed}
    plain = charted(PLAIN, **size, learn_days=arguments.learn_days)
    of_plain = plain.tuned()
    if not arguments.json:
        sys.stdout.write(HEAD)
    for name in names:
        one = comparison(plain if name == PLAIN else charted(name, **size, learn_days=arguments.learn_days), of_plain)
        sys.stdout.write(json.dumps(one, allow_nan=False) + "\n" if arguments.json else table_row(one))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
