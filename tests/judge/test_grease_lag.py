"""The grease lags behind the motor's sensor: what the filter learns of it, and what it says of the steady state."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.judge.drift.filter_state import FAST_K_PER_MIN, LAG, SLOPE, FilterState, initial_filter, remember_warming, saturating
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.temperature.laws import TemperatureSettings

DRIFT, LAWS = DriftSettings(), TemperatureSettings()
J = 6
TAU_MIN, RISE_K = 30.0, 12.0  # of the motor after the start of work


@given(rate=st.floats(-5.0, 5.0))
def test_the_lags_shape_is_odd_grows_and_saturates(rate: float):
    """So the noise of a rate about zero cancels, and a slow rate counts as itself."""
    one, other = saturating(np.array([rate, -rate]))
    assert one == -other
    assert abs(one) <= min(abs(rate), FAST_K_PER_MIN)
    assert saturating(np.array([rate + 0.1]))[0] > one


def replays(lag_min: float, days: int) -> DriftState:
    """The state of 10 arms after daily replays at random times after the start, σ = 1 %, with grease of that lag."""
    rng, arms = np.random.default_rng(5), 10
    N, state = 6 * arms, None
    for day in range(days):
        since = np.repeat(rng.uniform(0.0, 90.0, arms), 6)
        room = 22.0 + np.repeat(3.0 * rng.normal(size=arms), 6)
        left = np.exp(-since / TAU_MIN)
        motor = room + RISE_K * (1.0 - left)
        grease = room + RISE_K * (1.0 - (TAU_MIN * left - lag_min * np.exp(-since / lag_min)) / (TAU_MIN - lag_min))
        y = log_torque(grease) + 0.01 * rng.normal(size=N)
        seen = Observation(y, np.full(N, 1e-5), motor, np.full(N, 0.4), RISE_K / TAU_MIN * left, 0.6 * np.exp(y), np.exp(y))
        state = state or initial_state(seen, 6, DRIFT, LAWS)
        state = step(state, Replay(observation=seen, days=np.full(arms, float(day > 0))), DRIFT, LAWS).state
    assert state is not None
    return state


def log_torque(grease_c: np.ndarray) -> np.ndarray:
    """Friction falls by 0.6 % a kelvin."""
    return 2.0 - 0.006 * (grease_c - 25.0)


@pytest.mark.soak
def test_a_lag_of_twenty_minutes_is_learnt_and_the_steady_state_stays_within_its_interval():
    """After 100 replays the lag is found to be longer than a short one, and four of five 90 % intervals at least hold the steady state."""
    short, long = replays(2.0, 100), replays(20.0, 100)
    lag = [np.median(s.filter_state.mean[:, LAG] / s.filter_state.mean[:, SLOPE]) for s in (short, long)]
    assert lag[1] > lag[0] + 3.0
    T0 = long.reference_temperature_c
    mean, std = long.filter_state.reference(T0, long.slot)
    assert np.mean(np.abs(mean - log_torque(T0)) < 1.645 * std) >= 0.8


def unlearnt() -> FilterState:
    """The state of an arm's joints before the first replay."""
    seen = Observation(np.zeros(J), np.full(J, 1e-5), np.full(J, 30.0), np.full(J, 0.4), np.zeros(J), np.ones(J), np.ones(J))
    return initial_filter(seen, DRIFT, fall_per_k=0.015, fall_std_per_k=0.007, coulomb_std_per_k=0.003)


def test_a_replay_that_taught_nothing_leaves_the_usual_warming_rate():
    """Nor does one of an unknown rate; the steady state is less certain the faster a joint usually warms."""
    state = unlearnt()
    assert np.array_equal(remember_warming(state, np.full(J, 0.3)).usual_warming, state.usual_warming)  # nothing was learnt yet
    learnt = replace(state, event=np.zeros(J), replays=np.ones(J))
    assert np.array_equal(remember_warming(learnt, np.full(J, np.nan)).usual_warming, state.usual_warming)
    warm = remember_warming(learnt, np.full(J, 0.3))
    slot = np.zeros(J, dtype=int)
    assert np.all(warm.reference(np.full(J, 30.0), slot)[1] > state.reference(np.full(J, 30.0), slot)[1])


def warmed(rates: list[float]) -> FilterState:
    """A joint's state after replays at these warming rates, with a lag of 10 min."""
    state = unlearnt()
    mean = state.mean.copy()
    mean[:, LAG] = 10.0 * mean[:, SLOPE]
    for n, rate in enumerate(rates, 1):
        state = remember_warming(replace(state, mean=mean, event=np.zeros(J), replays=np.full(J, float(n))), np.full(J, rate))
    return state


@given(rates=st.lists(st.floats(0.001, 1.0), min_size=1, max_size=80))
def test_the_share_that_is_extrapolated_is_one_where_all_replays_warm_alike_and_never_more(rates: list[float]):
    """By the inequality of Cauchy and Schwarz, whatever the weights of the replays."""
    assert np.all(warmed(rates).extrapolated <= 1.0 + 1e-12)
    assert np.allclose(warmed([rates[0]] * len(rates)).extrapolated, 1.0)


def test_the_steady_state_is_more_certain_where_some_replays_saw_it():
    """Of two joints with one mean warming rate, the one whose replays come cold and warm; a rate that is known late counts in full."""
    at, slot = np.full(J, 30.0), np.zeros(J, dtype=int)
    alike, apart = warmed([0.05] * 40), warmed([0.0, 0.2] * 20)  # h is 0 and 0.067 in turn
    assert np.allclose(apart.extrapolated, 0.5)
    assert np.all(apart.reference(at, slot)[1] < alike.reference(at, slot)[1])
    late = warmed([np.nan] * 30 + [0.05])
    assert np.allclose(late.usual_warming, alike.usual_warming)
    assert np.allclose(late.extrapolated, 1.0)


def test_a_rare_cold_start_does_not_make_the_steady_state_much_more_certain():
    """Of twenty replays nineteen see one rate: what they have in common stays unknown by half at least."""
    usual = warmed([0.01] * 60)
    rare = warmed([*[0.01] * 19, 1.0] * 3)
    assert np.all(rare.extrapolated < 0.6)
    none = replace(usual, usual_warming=np.zeros(J))
    at, slot = np.full(J, 30.0), np.zeros(J, dtype=int)

    def unknown_var(state: FilterState) -> np.ndarray:
        return state.reference(at, slot)[1] ** 2 - none.reference(at, slot)[1] ** 2

    each = (rare.usual_warming / usual.usual_warming) ** 2
    assert np.all(unknown_var(rare) > 0.24 * each * unknown_var(usual))
