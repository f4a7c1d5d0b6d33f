"""The path that is fitted to the course of friction, and the life along it."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.judge.alerts.remaining_life import RemainingLife, assumptions, remaining_life, remaining_life_of_joint
from monitor.judge.alerts.wear_paths import ACCELERATING, SLOWING, STRAIGHT, WearPaths, wear_paths
from monitor.judge.document import plain
from monitor.judge.friction.course import COUNT, USE, empty_course
from monitor.judge.friction.observation import Observation
from monitor.judge.friction.step import FrictionModel, FrictionState, initial_state, step
from monitor.judge.settings import PrognosisSettings
from monitor.publish import documents
from monitor.publish.documents import made

pytestmark = pytest.mark.xdist_group("worn fleets")  # one worker judges each fleet once

MODEL, PROGNOSIS = FrictionModel(), PrognosisSettings()
ONSET, LIFE = 80.0, 300.0  # days
PATHS = {"straight": lambda x: x, "accelerating": lambda x: np.expm1(3.0 * x) / np.expm1(3.0), "slowing": np.sqrt}


@functools.cache
def worn_fleet(path: str, arms: int, asked_at: float, *, std: float = 0.02, seed: int = 0) -> tuple[FrictionState, float]:
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
        state = initial_state(seen, J, MODEL) if state is None else state
        state = step(state, seen, np.full(arms, float(day > 0)), MODEL, in_place=True)
    assert state is not None
    return state, ONSET + LIFE - last


def lives_of(state: FrictionState) -> list[RemainingLife]:
    """Of the joints that wear."""
    return [remaining_life_of_joint(state, n, MODEL, PROGNOSIS) for n in range(1, len(state.replays), state.joints_per_arm + 1)]


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


@pytest.mark.slow
def test_a_joint_without_a_course_or_without_work_goes_on_along_a_straight_line():
    """A history that begins anew, and replays of a joint without work: nothing is divided by no work, and there is a date."""
    state, _ = worn_fleet("straight", 2, 0.5)
    idle, kept = state.course[1].copy(), state.course
    idle[:, USE] = state.use[1] * idle[:, COUNT]
    for course in (empty_course(1, 1)[0], idle):
        assert wear_paths(course, state, 1, MODEL) is None
        state.course = kept.copy()
        state.course[1] = course
        life = remaining_life_of_joint(state, 1, MODEL, PROGNOSIS)
        state.course = kept
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
    quiet = [n for n in range(len(state.replays)) if n % (state.joints_per_arm + 1) not in (1, state.joints_per_arm)]
    assert all(remaining_life_of_joint(state, n, MODEL, PROGNOSIS).path is None for n in quiet)


@pytest.mark.slow
def test_wear_that_slows_down_is_still_wear():
    """Friction that rises with the root of time stays below the straight line that was found first: it has not fallen to where it was."""
    state, _ = worn_fleet("slowing", 16, 0.75)
    wear = [state.of_kinds(np.array([0]), n)[0][0] for n in range(1, len(state.replays), 5)]
    assert state.risen[1::5].all()
    assert np.abs(np.array(wear) - np.log1p(0.3 * np.sqrt(0.75))).max() < 0.05


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
