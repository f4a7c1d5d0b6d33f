"""How soon a young arm's wear is found, without a fleet's prior, with it, and by observers who know more: `python -m tests.bench.prior`.

Simulated arms of which one joint steps by 5 % on day 10 to 60. Every day's margin is kept, by which the evidence of a rise is above its
threshold [nats]; the threshold itself is out of reach, so that one run shows every other one. Quoted are the days from the step to its
detection, quarter, half and three quarters of the arms and the mean of at most 90 days, at the monitor's own threshold and where so many
detections a robot-year are false: rises found in joints that did not change.

The observers are computed by a filter of their own (level and AR(1) noise, every age of a step and of a ramp, bounded innovations). They
know the noise and the temperature of the grease, the second one the level of each joint as well.
"""

import argparse
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from monitor.judge.friction.prior import FleetPrior, prior_from_document
from monitor.judge.friction.step import FrictionModel, FrictionState
from monitor.judge.settings import AssessSettings
from monitor.recording import Array
from monitor.studies.fleet_prior import LearntArm, learn_prior
from monitor.studies.rehearsal.fleet import Day, Fleet, FleetSettings, Wear
from monitor.studies.rehearsal.play import COMPARABLE, judged_days
from tests.synthetic_arm import of_arm

DAYS, ONSETS, STEP, LEARNING = 130, (10, 60), 0.05, 8
FALSE_PER_YEAR = (0.2, 0.1, 0.05)
J = 6
OFF = 1e-4  # false alarms a robot-year in these runs: what is found by so high a threshold is above every other one
BOUND = 3.0  # [σ] an innovation counts for an observer with no more; for the monitor with 2.3
BEFORE = 10  # replays before which nothing is found, by whom it may be
ASSESS = AssessSettings()


class Watched(Fleet):
    """A fleet of which it is kept what is left of each observation where temperature is known exactly."""

    def __init__(self, settings: FleetSettings, wear: Wear) -> None:
        super().__init__(settings, wear)
        self.left: list[Array] = []  # (A·J,) each: wear and noise
        self.variance: list[Array] = []

    def morning(self, day: int) -> Day:
        now = super().morning(day)
        self.left.append(now.seen.log_torque - (now.truth - now.worn).ravel())
        self.variance.append(now.seen.variance)
        return now


class Margins(NamedTuple):
    """What a run has kept."""

    margin: Array  # (D, A, J) [nats] of a rise's evidence over the monitor's threshold, an observer's over 0
    joint: np.ndarray  # (A,) that steps
    onset: Array  # (A,) day


def fleet_prior(arms: int, days: int, settings: FleetSettings) -> FleetPrior:
    """What other arms say."""
    fleet = Fleet(replace(settings, arms=arms, days=days, seed=settings.seed + 1000))
    for one in judged_days(fleet, days, ASSESS):
        state = one.result.state.friction
    learnt = [LearntArm(f"arm-{k}", settings.robot, of_arm(state, k), float(days)) for k in range(arms)]
    document = learn_prior(learnt, ASSESS.drift, ASSESS.temperature)
    return prior_from_document(document, settings.robot, J, settings.reference_speed_rad_s, digest="0")


def lived(settings: FleetSettings, prior: FleetPrior | None) -> tuple[Margins, Watched]:
    """A fleet's life with a step in one joint of each arm, and the monitor's margins."""
    rng, A = np.random.default_rng(settings.seed), settings.arms
    joint, onset = rng.integers(0, J, A), rng.integers(*ONSETS, A).astype(float)
    wear = Wear(joint=joint.astype(float), onset_day=onset, step=np.full(A, STEP), per_day=np.zeros(A))
    fleet, assess = Watched(settings, wear), replace(ASSESS, drift=replace(ASSESS.drift, prior=prior))
    blind = replace(assess, health=replace(assess.health, false_alarms_per_year=OFF))
    kept = [margin_of(one.result.state.friction, assess.friction) for one in judged_days(fleet, settings.days, blind)]
    return Margins(np.array(kept).reshape(-1, A, J), joint, onset), fleet


def margin_of(state: FrictionState, model: FrictionModel) -> Array:
    """(N,) [nats] by which R of a rise is above its threshold."""
    counted = ~state.risen.reshape(-1, J + 1)[:, :J]
    needed = model.decision.needed(state.peaks, counted, J, state.age_days)[0]
    margin = np.log(np.maximum(state.odds[0], 1e-9) / needed)
    told: Array = state.of_joints(np.where(state.risen, np.inf, np.where(state.replays > BEFORE, margin, -np.inf)))
    return told


def observed(fleet: Watched, like: Margins, *, level_known: bool) -> Margins:
    """The evidence of an observer who knows noise and temperature."""
    s, days = fleet.settings, len(fleet.left)
    N, rho = fleet.arms * J, s.autocorrelation
    P = np.zeros((N, 2, 2))  # of level and noise
    P[:, 0, 0], P[:, 1, 1] = 0.0 if level_known else 100.0, s.between_std**2
    mean = np.zeros((N, 2))  # `left` counts from the level
    response, score, information = np.zeros((N, 2, days, 2)), np.zeros((N, 2, days)), np.zeros((N, 2, days))
    starts, kept = np.arange(days), []
    for day, (y, within) in enumerate(zip(fleet.left, fleet.variance, strict=True)):
        if day:
            mean[:, 1] *= rho
            response[..., 1] *= rho
            P *= np.array([[1.0, rho], [rho, rho**2]])
            P[:, 1, 1] += (1.0 - rho**2) * s.between_std**2
        age = np.maximum(day - starts + 1.0, 0.0)
        effect = np.stack([np.minimum(age, 1.0), age / 100.0]) - response.sum(axis=3)  # (N, 2, days) of a unit step, a unit ramp
        var, seen = P.sum(axis=(1, 2)) + within, np.isfinite(y)
        nu = np.where(seen, y - mean.sum(axis=1), 0.0)
        nu = np.clip(nu, -BOUND * np.sqrt(var), BOUND * np.sqrt(var)) if day else nu
        gain = np.where(seen[:, None], P.sum(axis=2) / var[:, None], 0.0)
        weight = np.where(seen & (day > 0), 1.0 / var, 0.0)[:, None, None]
        score += effect * nu[:, None, None] * weight
        information += effect**2 * weight
        mean += gain * nu[:, None]
        response += gain[:, None, None, :] * effect[..., None]
        P -= gain[:, :, None] * P.sum(axis=1)[:, None, :]
        counts = (age >= 1.0) & (starts >= (0 if level_known else ASSESS.drift.baseline_replays))
        ratio = np.where(counts & (score > 0), score**2 / np.maximum(information, 1e-12), 0.0)
        kept.append(0.5 * np.max(ratio, axis=(1, 2)))
    return Margins(np.array(kept).reshape(-1, fleet.arms, J), like.joint, like.onset)


def show(name: str, found: Margins, *, own: bool) -> None:
    """A line: at the own threshold, where there is one, and at equal shares of false detections."""
    A = len(found.joint)
    healthy = np.ones((A, J), dtype=bool)
    healthy[np.arange(A), found.joint] = False
    highest = np.sort(found.margin[LEARNING:].max(axis=0)[healthy])[::-1]
    years = len(highest) / J * (len(found.margin) - LEARNING) / 365.0
    parts = [f"own threshold {delays(found, 0.0)}, {int((highest > 0).sum())} false in {years:.0f} robot-years"] * own
    for per_year in FALSE_PER_YEAR:
        shift = float(np.interp(per_year * years, np.arange(len(highest)) + 0.5, highest))
        parts.append(f"{per_year:g} a year {delays(found, shift)} ({shift:+.1f})")
    print(f"{name}: {'; '.join(parts)}", flush=True)


def delays(found: Margins, shift: float) -> str:
    """Quartiles and bounded mean of the days to detection, where the threshold is shifted by so much [nats]."""
    own = found.margin[:, np.arange(len(found.joint)), found.joint] > shift
    day = np.where(own.any(axis=0), own.argmax(axis=0).astype(float), np.inf)
    days = np.where(day < found.onset, np.nan, day - found.onset + 1.0)
    quarters = np.nanquantile(days, [0.25, 0.5, 0.75], method="higher")
    return f"{quarters[0]:.0f} {quarters[1]:.0f} {quarters[2]:.0f}, mean {np.nanmean(np.minimum(days, 90.0)):.0f} d"


def main() -> None:
    """The four, on the same arms."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.prior", description=__doc__)
    parser.add_argument("--arms", type=int, default=160)
    parser.add_argument("--seed", type=int, default=72)
    parser.add_argument("--autocorrelation", type=float, default=0.5, help="of the noise of these arms; that of the fleet is 0.5")
    parser.add_argument("--fleet", type=int, default=24, help="arms that the prior is of, after 120 days")
    parser.add_argument("--days", type=int, default=DAYS)
    arguments = parser.parse_args()
    settings = FleetSettings(arms=arguments.arms, days=arguments.days, seed=arguments.seed, scenarios=COMPARABLE)
    prior = fleet_prior(arguments.fleet, 120, settings)
    arms = replace(settings, autocorrelation=arguments.autocorrelation)
    without, fleet = lived(arms, None)
    show("without", without, own=True)
    show("with prior", lived(arms, prior)[0], own=True)
    show("who knows noise and temperature", observed(fleet, without, level_known=False), own=False)
    show("and the level", observed(fleet, without, level_known=True), own=False)


if __name__ == "__main__":
    main()
