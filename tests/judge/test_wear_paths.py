"""The course of friction in blocks, and the path that is fitted to it."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.judge.alerts.remaining_life import RemainingLife, assumptions, remaining_life, remaining_life_of_joint
from monitor.judge.alerts.wear_paths import ACCELERATING, SLOWING, STRAIGHT, WearPaths, wear_paths
from monitor.judge.document import plain
from monitor.judge.drift.filter_state import RATE, SLOTS, WEAR, begin_history
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.drift.wear_history import (
    AGE,
    BLOCKS,
    COUNT,
    FULL,
    PRODUCTION_AGE,
    add_replay,
    age_history,
    empty_history,
    rescale_production,
    settle_slot,
)
from monitor.judge.settings import PrognosisSettings
from monitor.judge.temperature.laws import TemperatureSettings
from monitor.publish import documents
from monitor.publish.documents import made
from monitor.recording import Array

pytestmark = pytest.mark.xdist_group("worn fleets")  # one worker judges each fleet once

DRIFT, TEMPERATURE, PROGNOSIS = DriftSettings(), TemperatureSettings(), PrognosisSettings()
ONSET, LIFE = 80.0, 300.0  # days
PATHS = {"straight": lambda x: x, "accelerating": lambda x: np.expm1(3.0 * x) / np.expm1(3.0), "slowing": np.sqrt}


@functools.cache
def worn_fleet(path: str, arms: int, asked_at: float, *, std: float = 0.02, seed: int = 0) -> tuple[DriftState, float]:
    """Arms of four joints of which the second wears along a path, judged until a share of its life; with the days that are left."""
    rng, J = np.random.default_rng(seed), 4
    N, state = arms * J, None
    last = int(ONSET + asked_at * LIFE)
    noise = std * rng.normal(size=N)
    for day in range(last + 1):
        noise = 0.5 * noise + np.sqrt(0.75) * std * rng.normal(size=N)
        worn = np.where(np.arange(N) % J == 1, 0.3 * PATHS[path](np.maximum(day - ONSET, 0.0) / LIFE), 0.0)
        celsius = 30.0 + 2.0 * rng.normal(size=N)
        log_torque = 2.0 + np.log1p(worn) - 0.007 * (celsius - 30.0) + noise
        seen = Observation(
            log_torque=log_torque,
            variance=np.full(N, 0.003**2),
            temperature_c=celsius,
            viscous_share=np.full(N, 0.4),
            warming_k_per_min=np.zeros(N),
            coulomb_nm=0.6 * np.exp(log_torque),
            viscous_nm_s_per_rad=np.exp(log_torque),
        )
        state = initial_state(seen, J, DRIFT, TEMPERATURE) if state is None else state
        state = step(state, Replay(observation=seen, days=np.full(arms, float(day > 0))), DRIFT, TEMPERATURE).state
    assert state is not None
    return state, ONSET + LIFE - last


def lives_of(state: DriftState) -> list[RemainingLife]:
    """Of the joints that wear."""
    return [remaining_life_of_joint(state, n, DRIFT, PROGNOSIS) for n in range(1, state.joints, state.joints_per_arm)]


def certain(shape: int) -> WearPaths:
    """One component with a rise of 10 % since 100 days, known to 0.1 %."""
    return WearPaths(
        weight=np.ones(1), shape=np.array([shape]), since=np.array([100.0]), mean=np.array([[1.0, 0.0, 0.1]]), cov=1e-6 * np.eye(3)[None]
    )


def life_along(paths: WearPaths | None, limit: float = 0.3) -> RemainingLife:
    """Of a joint that has risen by 10 % and goes on by 0.1 % a day."""
    mean, cov = np.array([np.log(1.1), 0.001]), np.diag([1e-6, 1e-12])
    return remaining_life(mean, cov, wear_walk_per_sqrt_day=1e-4, settings=PrognosisSettings(limit_rise=limit), paths=paths)


def test_a_straight_path_is_what_the_pair_of_wear_and_rate_gives():
    """The same joint by its path and by its (wear, rate): medians and rates agree to 1 %."""
    along, pair = life_along(certain(int(np.flatnonzero(STRAIGHT)[0]))), life_along(None)
    assert along.p50_days == pytest.approx(pair.p50_days, rel=0.01)
    assert along.rate_per_day == pytest.approx(pair.rate_per_day, rel=0.01)
    assert (along.path, pair.path, pair.accelerating_probability) == ("straight", "straight", None)


@given(shape=st.integers(0, len(STRAIGHT) - 1), limits=st.tuples(st.floats(0.12, 1.0), st.floats(0.12, 1.0)))
@settings(max_examples=25, deadline=None)
def test_a_higher_limit_is_reached_later(shape, limits):
    """For every shape, each quantile grows with the limit; beyond 54 years there is none."""
    low, high = (life_along(certain(shape), limit) for limit in sorted(limits))
    for name in ("p10_days", "p50_days", "p90_days"):
        early, late = (np.inf if getattr(life, name) is None else getattr(life, name) for life in (low, high))
        assert early <= late * (1.0 + 1e-9)  # rounding of an interpolation


def test_slowing_paths_come_late_and_accelerating_ones_early():
    """From the same rise since the same day."""
    days = [life_along(certain(int(np.flatnonzero(family)[-1]))).p50_days for family in (ACCELERATING, STRAIGHT, SLOWING)]
    assert days == sorted(days)


@given(replays=st.integers(1, 900), seed=st.integers(0, 9))
@settings(max_examples=20, deadline=None)
@pytest.mark.slow
def test_blocks_keep_every_replay_in_the_order_of_age(replays, seed):
    """The counts and sums are those of all replays, whatever was merged, and ages ascend."""
    rng = np.random.default_rng(seed)
    history, ages, sums = empty_history(1, SLOTS), np.zeros(replays), 0.0
    row = np.zeros((1, 3 + SLOTS))
    row[0, 3] = 1.0
    for k in range(replays):
        days = float(rng.choice([1.0, 1.0, 2.0, 10.0]))
        history, ages[:k] = age_history(history, np.array([0.5 * days]), np.array([days])), ages[:k] + days
        y = float(rng.normal())
        sums += y
        history = add_replay(history, row, np.array([y]), np.array([True]))
    count = history[0, :, COUNT]
    assert count.sum() == replays
    assert history[0, :, AGE].sum() == pytest.approx(ages.sum())
    assert history[0, :, PRODUCTION_AGE].sum() == pytest.approx(0.5 * ages.sum())
    assert history[0, :, -1].sum() == pytest.approx(sums, abs=1e-9)
    used = count > 0
    assert np.all(np.diff(history[0, used, AGE] / count[used]) > 0)
    assert used.sum() <= min(BLOCKS, replays // FULL + 1)


def test_another_measure_of_production_and_another_context_keep_what_was_seen():
    """Twice the work in a usual day makes the past half as many usual days; a slot that is taken keeps its old level in the sums."""
    history = empty_history(1, SLOTS)
    row = np.zeros((1, 3 + SLOTS))
    row[0, 3] = 1.0
    for _ in range(3):
        history = age_history(add_replay(history, row, np.array([2.1]), np.array([True])), np.ones(1), np.ones(1))
    assert rescale_production(history, np.array([2.0]))[0, 0, PRODUCTION_AGE] == pytest.approx(0.5 * history[0, 0, PRODUCTION_AGE])
    settled = settle_slot(history, np.zeros(1, dtype=int), np.array([2.0]), np.array([True]))
    assert settled[0, 0, -1] == pytest.approx(3 * 0.1)
    assert np.all(settled[0, :, 6 : 6 + SLOTS] == 0)


@pytest.mark.slow
def test_a_state_without_a_history_goes_on_along_a_straight_line():
    """A worn joint whose belief kept none begins with a straight path, whose median is within 20 % of that of its (wear, rate)."""
    state, _ = worn_fleet("straight", 2, 0.5)
    joints = begin_history(replace(state.filter_state, history=empty_history(state.joints, SLOTS)), state.slot)
    begun = replace(state, filter_state=joints)
    pair = remaining_life(
        joints.mean[1, [WEAR, RATE]], joints.cov[1][:2, :2], wear_walk_per_sqrt_day=DRIFT.wear_walk_per_sqrt_day, settings=PROGNOSIS
    )
    life = remaining_life_of_joint(begun, 1, DRIFT, PROGNOSIS)
    assert life.p50_days == pytest.approx(pair.p50_days, rel=0.2)
    assert wear_paths(replace(joints, history=empty_history(state.joints, SLOTS)), 1, 0, state.joints_per_arm, DRIFT) is None


@pytest.mark.slow
def test_a_joint_that_did_not_production_has_no_path():
    """Replays of one hour, or of a joint without work: nothing is divided by no work, and the path is straight."""
    state, _ = worn_fleet("straight", 2, 0.5)
    idle = state.filter_state.history.copy()
    idle[:, :, PRODUCTION_AGE] = 0.0
    assert wear_paths(replace(state.filter_state, history=idle), 1, 0, state.joints_per_arm, DRIFT) is None
    life = remaining_life_of_joint(replace(state, filter_state=replace(state.filter_state, history=idle)), 1, DRIFT, PROGNOSIS)
    assert (life.verdict, life.path, life.accelerating_probability) == ("trend", "straight", None)


def test_the_sentence_names_what_the_days_assume():
    """A joint with a date says so; one without, and a document of an older release, say nothing."""
    rows: list[dict[str, object]] = [
        {"joint": 2, "remaining_life": plain(life_along(None))},
        {"joint": 4, "remaining_life": {"p50_days": None, "assumption": None}},
    ]
    assert assumptions(rows).text == "Shoulder (joint 2): the limit in 200 d if friction goes on along a straight line."


@pytest.mark.slow
def test_wear_of_one_joint_leaves_the_paths_of_others_alone() -> None:
    """A joint that does not wear has no date and no path."""
    state, _ = worn_fleet("straight", 2, 0.5)
    quiet: Array = np.array([n for n in range(state.joints) if n % state.joints_per_arm != 1])
    assert all(remaining_life_of_joint(state, int(n), DRIFT, PROGNOSIS).path is None for n in quiet)


@given(seed=st.integers(0, 2**32 - 1), components=st.integers(1, 400), family=st.sampled_from([SLOWING, STRAIGHT, ACCELERATING, None]))
@settings(deadline=None, max_examples=150)
def test_no_probability_of_a_mixture_leaves_its_bounds(seed, components, family):
    """The rounding of a sum of weights is no probability of 1.0000000000000002: the document of the remaining life takes each."""
    rng = np.random.default_rng(seed)
    shapes = np.arange(len(SLOWING)) if family is None else np.flatnonzero(family)
    weight = rng.gamma(rng.choice([0.01, 1.0]), size=components) + 1e-300
    paths = WearPaths(
        weight=weight / weight.sum(),
        shape=rng.choice(shapes, size=components),
        since=rng.uniform(5.0, 500.0, components),
        mean=np.stack([np.ones(components), np.zeros(components), rng.uniform(0.0, 2.0, components)], axis=1),
        cov=np.tile(np.diag([1e-6, 1e-6, 1e-6]), (components, 1, 1)),
    )
    for each in (SLOWING, STRAIGHT, ACCELERATING):
        assert 0.0 <= paths.probability(each) <= 1.0
    mean, cov = np.array([rng.uniform(0.0, 0.25), rng.uniform(1e-4, 0.1)]), np.diag([1e-6, 1e-10])
    life = remaining_life(mean, cov, wear_walk_per_sqrt_day=0.001, settings=PROGNOSIS, paths=paths)
    made(documents.RemainingLife, life)
    assert 0.0 <= life.before_service_probability <= 1.0
