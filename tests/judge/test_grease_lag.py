"""The grease lags behind the motor's sensor: what the model learns of it, and what it says of the steady state."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.friction.figures import slope_per_k, uneven_std
from monitor.judge.friction.observation import Observation
from monitor.judge.friction.states import FAST_K_PER_MIN, LAG, saturating
from monitor.judge.settings import AssessSettings

SETTINGS = AssessSettings()
J = 6
TAU_MIN, RISE_K = 30.0, 12.0  # of the motor after the start of work


@given(rate=st.floats(-5.0, 5.0))
def test_the_lags_shape_is_odd_grows_and_saturates(rate: float):
    """So the noise of a rate about zero cancels, and a slow rate counts as itself."""
    one, other = saturating(np.array([rate, -rate]))
    assert one == -other
    assert abs(one) <= min(abs(rate), FAST_K_PER_MIN)
    assert saturating(np.array([rate + 0.1]))[0] > one


def replays(lag_min: float, days: int, *, settled: bool = False, arms: int = 10) -> DriftState:
    """The state of arms after daily replays at random times after the start, σ = 1 %, with grease of that lag.

    settled : whether the last third of the replays comes hours after the start of work.
    """
    rng = np.random.default_rng(5)
    N, state = 6 * arms, None
    for day in range(days):
        since = np.repeat(rng.uniform(0.0, 90.0, arms), 6) + (600.0 if settled and day % 3 == 2 else 0.0)
        room = 22.0 + np.repeat(3.0 * rng.normal(size=arms), 6)
        left = np.exp(-since / TAU_MIN)
        motor = room + RISE_K * (1.0 - left)
        grease = room + RISE_K * (1.0 - (TAU_MIN * left - lag_min * np.exp(-since / lag_min)) / (TAU_MIN - lag_min))
        y = log_torque(grease) + 0.01 * rng.normal(size=N)
        seen = Observation(y, np.full(N, 1e-5), motor, np.full(N, 0.4), RISE_K / TAU_MIN * left, 0.6 * np.exp(y), np.exp(y))
        state = state or initial_state(seen, 6, SETTINGS)
        state = step(state, Replay(observation=seen, days=np.full(arms, float(day > 0))), SETTINGS, in_place=True).state
    assert state is not None
    return state


def log_torque(grease_c: np.ndarray) -> np.ndarray:
    """Friction falls by 0.6 % a kelvin."""
    return 2.0 - 0.006 * (grease_c - 25.0)


def steady(state: DriftState) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of log friction at T0, warm and still, (N,) each."""
    mean, var = state.friction.friction(state.friction.reference_c, SETTINGS.friction).moments()
    return state.friction.of_joints(mean), np.sqrt(state.friction.of_joints(var))


def lag_min(state: DriftState) -> np.ndarray:
    """(N,) by which the grease is believed to lag."""
    lag = state.friction.of_joints((state.friction.p * state.friction.x[:, LAG]).sum(axis=0))
    return lag / slope_per_k(state.friction, state.reference_temperature_c)


@pytest.mark.slow
def test_a_lag_of_twenty_minutes_is_learnt_and_the_steady_state_stays_within_its_interval():
    """After 100 replays the lag is found to be longer than a short one, and four of five 90 % intervals at least hold the steady state."""
    short, long = replays(2.0, 100), replays(20.0, 100)
    assert np.median(lag_min(long)) > np.median(lag_min(short)) + 3.0
    mean, std = steady(long)
    assert np.mean(np.abs(mean - log_torque(long.reference_temperature_c)) < 1.645 * std) >= 0.8


def test_a_replay_that_taught_nothing_or_whose_rate_nobody_knows_leaves_the_steady_state_as_it_was():
    """Nor does a joint that was not resolved forget how it usually warms; the rate of a replay that nobody told counts as none."""
    state = replays(8.0, 12, arms=1)
    usual = state.friction.usual_warming.copy()
    nothing = np.full(J, np.nan)
    seen = Observation(nothing, np.full(J, 1e-5), np.full(J, 30.0), np.full(J, 0.4), np.full(J, 0.3), nothing, nothing)
    after = step(state, Replay(observation=seen, days=np.ones(1)), SETTINGS).state
    assert np.array_equal(after.friction.usual_warming, usual)
    told = seen._replace(log_torque=log_torque(np.full(J, 30.0)), warming_k_per_min=nothing)
    after = step(state, Replay(observation=told, days=np.ones(1)), SETTINGS).state
    assert np.isfinite(after.friction.x).all()
    assert np.all(after.friction.usual_warming <= usual)


@pytest.mark.slow
def test_the_steady_state_is_more_certain_where_some_replays_saw_it():
    """Of two fleets of the same grease, the one of which every third replay comes hours after the start."""
    alike, apart = replays(20.0, 60), replays(20.0, 60, settled=True)
    assert np.median(steady(apart)[1]) < np.median(steady(alike)[1])


def test_the_faster_a_joint_warms_the_less_a_single_replay_says():
    """What of the lag's effect differs from replay to replay is a share of it."""
    state = replays(20.0, 30, arms=1)
    slow, fast = (uneven_std(state.friction, np.full(J, rate), SETTINGS.friction) for rate in (0.02, 0.4))
    assert np.all(fast > 3.0 * slow)
    assert np.all(slow > 0.0)
    assert np.array_equal(uneven_std(state.friction, np.zeros(J), SETTINGS.friction), np.zeros(J))
