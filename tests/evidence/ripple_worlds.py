"""False findings of gear ripple: `python -m tests.evidence.ripple_worlds [--arms N] [--seed N]`, a row for each world.

Sound gears whose ripple lives as the name of the world says. Nothing here is drawn from the model that judges it: a gear's ripple is an
amplitude between nothing and a sixth of friction, which a replay measures in each direction of motion with noise of a current, and from
which the estimator takes what noise adds, so that it is often zero. On real arms it repeats to a tenth or two within minutes; slopes with
temperature, seasons, loads and running-in are assumed, larger than any that was measured.
"""

import argparse
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from monitor.judge.friction import step as friction
from monitor.judge.friction.beside import RIPPLE, model_beside
from monitor.judge.friction.observation import RIPPLE_FLOOR, Observation
from monitor.recording import Array

from . import at_least_one

J, LEARNING_DAYS = 6, 60
WORLDS = {
    "plain": "amplitudes scatter by 10 or 20 %, for a day or for weeks",
    "gamma": "amplitudes of a gamma distribution, whose tail is long upwards",
    "seasons": "±15 % a year, each joint at its own time, beside the slope with temperature",
    "loads": "half the months another load, which changes the ripple by −20 to +30 %",
    "outliers": "one arm in fifty a day has joints with two to six times the ripple, one replay in twenty is three times as noisy",
    "running-in": "60 % more at first, which fades over 40 days",
    "walking": "amplitudes walk by 1 % · √days",
    "noisy days": "what a replay resolves differs by a half from day to day",
    "hidden": "two replays in five do not show the ripple",
}


class Ripple(NamedTuple):
    """Of one replay of N joints, as the model sees it."""

    value: Array  # (N,) [log]
    variance: Array  # (N,)
    temperature_c: Array  # (N,)


def replays(world: str, rng: np.random.Generator, arms: int, days: int) -> Iterator[Ripple]:
    """One order of the ripple of sound arms, a replay a day."""
    N = arms * J
    base = np.where(rng.random(N) < 0.25, 0.0, np.exp(rng.normal(np.log(0.025), 0.8, N)))  # of friction
    resolved = np.exp(rng.normal(np.log(0.012), 0.4, N))
    slope, season, place = rng.normal(0.0, 0.015, N), rng.uniform(0.0, 2.0 * np.pi, N), rng.uniform(0.0, 2.0 * np.pi, arms)
    rho, spread = rng.choice([0.0, 0.3, 0.6, 0.85], N), rng.choice([0.1, 0.2], N)
    of_load = rng.uniform(-0.2, 0.3, N)
    scatter, walked, loaded = np.zeros(N), np.zeros(N), np.zeros(N, dtype=bool)
    for day in range(days):
        of_arm = 28.0 + 6.0 * np.sin(2.0 * np.pi * day / 365.0 + place) + 2.0 * rng.normal(size=arms)
        T = np.repeat(of_arm, J) + rng.normal(size=N)
        scatter = rho * scatter + np.sqrt(1.0 - rho**2) * rng.normal(size=N)
        size, noise = base * np.exp(slope * (T - 28.0) + spread * scatter), resolved
        if world == "gamma":
            size = size * rng.gamma(1.0 / spread**2, spread**2)
        if world == "seasons":
            size = size * np.exp(0.15 * np.sin(2.0 * np.pi * day / 365.0 + season))
        if world == "loads":
            loaded = np.repeat(rng.random(arms) < 0.5, J) if day % 30 == 0 else loaded
            size = size * np.where(loaded, 1.0 + of_load, 1.0)
        if world == "outliers":
            struck = np.repeat(rng.random(arms) < 0.02, J) & (rng.random(N) < 0.5)
            size, noise = np.where(struck, size * rng.uniform(2.0, 6.0, N), size), np.where(rng.random(N) < 0.05, 3.0, 1.0) * resolved
        if world == "running-in":
            size = size * (1.0 + 0.6 * np.exp(-day / 40.0))
        if world == "walking":
            walked = walked + 0.01 * rng.normal(size=N)
            size = size * np.exp(walked)
        if world == "noisy days":
            noise = resolved * np.exp(0.5 * rng.normal(size=N))
        measured = _measured(size, noise, rng) / np.exp(-0.012 * (T - 28.0) + 0.02 * rng.normal(size=N))  # friction falls as it warms
        value = np.log(measured[0] + RIPPLE_FLOOR)
        hidden = (rng.random(N) < 0.4) if world == "hidden" else np.zeros(N, dtype=bool)
        yield Ripple(np.where(hidden, np.nan, value), (measured[1] / (measured[0] + RIPPLE_FLOOR)) ** 2, T)


def _measured(size: Array, noise: Array, rng: np.random.Generator) -> Array:
    """(2, N) amplitude and its deviation, as `gear_ripple` has them of a wave with noise in both directions of motion."""
    inphase, across = noise * rng.normal(size=(2, 2, len(size)))
    square = np.maximum(((size + inphase) ** 2 + across**2).mean(axis=0) - 2.0 * noise**2, 0.0)
    doubt = np.sqrt(2.0 * square * noise**2 + 2.0 * noise**4)
    return np.stack([np.sqrt(square), doubt / (np.sqrt(square) + np.sqrt(square + doubt))])


def found(world: str, arms: int, days: int, seed: int) -> tuple[int, float]:
    """How often any order of a sound joint's ripple was found to have risen after learning, and in how many robot-years."""
    count = 0
    for order, name in enumerate(RIPPLE):
        model, state, before = model_beside(name), None, np.zeros(arms * J, dtype=bool)
        for day, seen in enumerate(replays(world, np.random.default_rng((seed, order)), arms, days)):
            one = np.ones(arms * J)
            observation = Observation(seen.value, seen.variance, seen.temperature_c, one, 0.0 * one, one, one)
            state = friction.initial_state(observation, J, model) if state is None else state
            state = friction.step(state, observation, np.full(arms, float(day > 0)), model, in_place=True)
            risen = state.of_joints(state.risen)
            count += np.count_nonzero(risen & ~before) if day >= LEARNING_DAYS else 0
            before = risen
    return count, arms * (days - LEARNING_DAYS) / 365.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.evidence.ripple_worlds", description=__doc__)
    parser.add_argument("worlds", nargs="*", metavar="WORLD", help=f"default all: {', '.join(WORLDS)}")
    parser.add_argument("--arms", type=at_least_one, default=100, help="of each world, for three years (default 100)")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if unknown := [name for name in given.worlds if name not in WORLDS]:
        parser.error(f"no world {', '.join(unknown)}; expected of: {', '.join(WORLDS)}")
    print("| world | found | robot-years | a robot-year |\n|---|---|---|---|")
    for name in given.worlds or WORLDS:
        count, years = found(name, given.arms, 1095, given.seed)
        print(f"| {name}: {WORLDS[name]} | {count} | {years:.0f} | {count / years:.3f} |", flush=True)


if __name__ == "__main__":
    main()
