"""From which level wear counts: running-in and new grease do not hide the wear that follows, and common changes blame no joint."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.judge.alerts.evidence import nothing_counted, wear_of_state, weigh_evidence
from monitor.judge.document import plain, typed
from monitor.judge.drift.filter_state import LEVELS, RATE, SLOPE, SLOPE_CHANGE, STEP, WEAR, initial_filter, replace_joints
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.reference import Reference, from_beginning
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import Replay, initial_state, step
from monitor.judge.drift.update.blame import common_changes
from monitor.judge.drift.update.lowest_level import begin_here
from monitor.judge.settings import HealthSettings
from monitor.judge.temperature.laws import TemperatureSettings

DRIFT, TEMPERATURE, HEALTH = DriftSettings(), TemperatureSettings(), HealthSettings()
J = 6


def observed(log_torque, temperature_c):
    N, torque = len(log_torque), np.exp(log_torque)
    return Observation(
        log_torque=log_torque,
        variance=np.full(N, 0.005**2),
        temperature_c=temperature_c,
        viscous_share=np.full(N, 0.4),
        warming_k_per_min=np.zeros(N),
        coulomb_nm=0.6 * torque,
        viscous_nm_s_per_rad=0.4 * torque / DRIFT.reference_speed_rad_s,
    )


class Lived:
    """What was told of A arms whose friction follows a path; each field has a row a day, or one for each of several replays a day."""

    def __init__(self, arms, days, path, seed=0, between_std=0.02, interval_days=1.0):
        rng, N = np.random.default_rng(seed), arms * J
        noise, state, counts = between_std * rng.normal(size=N), None, nothing_counted(N, arms)
        self.rises, self.falls, self.found = np.zeros((3, days, arms, J), bool)
        self.together = np.zeros((days, arms), bool)
        for day in range(days):
            noise = 0.5 * noise + np.sqrt(0.75) * between_std * rng.normal(size=N)
            T = 30.0 + rng.normal(size=N)
            seen = observed(np.broadcast_to(path(day), (arms, J)).ravel() + noise - 0.008 * (T - 30.0) + 2.0, T)
            state = state or initial_state(seen, J, DRIFT, TEMPERATURE)
            result = step(state, Replay(observation=seen, days=np.full(arms, interval_days * (day > 0))), DRIFT, TEMPERATURE)
            state, joints = result.state, result.state.filter_state
            evidence = weigh_evidence(
                wear_of_state(joints, joints.learnt_from & result.inside_range, np.floor(interval_days * day)), counts, J, HEALTH
            )
            counts = evidence.counts
            self.rises[day] = (evidence.raises >= 0).reshape(arms, J)
            self.falls[day] = evidence.falls.reshape(arms, J)
            self.found[day] = (joints.event == STEP).reshape(arms, J)
            self.together[day] = evidence.together
        self.joints = joints


def of_joint(j, value):
    """(J,) the value in joint j, from 0, and 0 in the others."""
    return np.where(np.arange(J) == j, value, 0.0)


@pytest.mark.slow
def test_a_common_step_is_told_once_of_the_arm_and_blames_no_joint():
    """All joints rise by 4 % on day 90: common_mode within 50 days. A step of one joint on day 150 is told beyond it."""

    def path(day):
        return 0.04 * (day >= 90) + of_joint(4, 0.08 * (day >= 150))

    lived = Lived(8, 190, path, seed=2)
    assert lived.together[90:140].any(axis=0).sum() >= 6  # of 8; with other seeds, 94 % of 64 arms
    assert lived.rises[:150].any(axis=0).sum() <= 1  # of 48 joints, one may be so early that the others say nothing yet
    assert lived.rises[150:, :, 4].any(axis=0).sum() >= 7


@pytest.mark.soak
def test_two_joints_that_wear_are_both_told():
    """Two of six joints with 10 % at the same replay are no common change."""
    lived = Lived(8, 110, lambda day: (of_joint(0, 0.1) + of_joint(3, 0.1)) * (day >= 90), seed=3)
    assert lived.rises[:, :, [0, 3]].any(axis=0).all()
    assert not lived.together.any()


def test_a_large_step_in_the_first_days_is_told():
    """30 % at the fifth replay are neither noise nor running-in."""
    lived = Lived(4, 12, lambda day: of_joint(5, np.log(1.3) * (day >= 4)), seed=4)
    assert lived.rises[:, :, 5].any(axis=0).all()


def some_state(seed):
    """A filter state of two arms with arbitrary correlated states."""
    rng, N = np.random.default_rng(seed), 2 * J
    state = initial_filter(
        observed(rng.normal(size=N), 30.0 + rng.normal(size=N)), DRIFT, fall_per_k=0.015, fall_std_per_k=0.005, coulomb_std_per_k=0.003
    )
    A = 0.1 * rng.normal(size=state.cov.shape)
    return replace(state, mean=0.1 * rng.normal(size=state.mean.shape), cov=A @ np.swapaxes(A, 1, 2), replays=np.full(N, 50.0))


@given(seed=st.integers(0, 10_000))
def test_where_wear_counts_from_changes_no_prediction(seed):
    """Wear that moves into the levels leaves the expected friction and its uncertainty as they were, in every slot."""
    state = some_state(seed)
    which = np.random.default_rng(seed).random(state.joints) < 0.5
    moved = begin_here(state, which, DRIFT.rate_std_per_day)
    T, slot = np.full(state.joints, 31.0), np.random.default_rng(seed).integers(0, 4, state.joints)
    for before, after in zip(state.reference(T, slot), moved.reference(T, slot), strict=True):
        assert np.allclose(before, after, rtol=1e-9, atol=1e-12)
    assert not moved.mean[which][:, [WEAR, RATE]].any()
    assert not moved.cov[which][:, WEAR].any()
    assert np.array_equal(moved.mean[~which], state.mean[~which])


def test_a_replaced_joint_doubts_its_slope_once_and_not_once_a_slot():
    """The joint's four levels are opened; its slope's variance grows by one `SLOPE_CHANGE`, and its reference is the new joint's."""
    state = some_state(1)
    state = replace(state, counted_from=replace(from_beginning(state.joints), fallen=np.full(state.joints, -0.1)))
    new = np.arange(state.joints) == 3
    after = replace_joints(state, new, DRIFT)
    assert after.cov[3, SLOPE, SLOPE] == pytest.approx(state.cov[3, SLOPE, SLOPE] + (SLOPE_CHANGE * state.mean[3, SLOPE]) ** 2)
    assert (np.diag(after.cov[3])[LEVELS:] == 100.0).all()
    assert after.counted_from.fallen[2:4].tolist() == [-0.1, 0.0]


def test_the_reference_goes_through_json():
    some = replace(from_beginning(6), run_in=np.linspace(-0.08, 0.0, 6), held_days=np.array([np.nan, 1.0, 2.0, 3.0, 4.0, 5.0]))
    back = typed(Reference, json.loads(json.dumps(plain(some))), where="reference", sizes={"N": 6})
    assert np.array_equal(back.run_in, some.run_in)
    assert np.array_equal(back.held_days, some.held_days, equal_nan=True)


@given(st.permutations(range(J)), st.integers(1, 6))
def test_a_change_is_common_where_most_joints_show_it_whichever_they_are(order, count):
    """Of six joints with 6 σ each, one to two are their own, and five or six are the arm's."""
    score, info = np.zeros((J, 2, 3)), np.ones((J, 2, 3))
    score[list(order)[:count], 1, 1] = 6.0  # a new rate: what a payload makes is a step
    found = np.arange(J) == order[0]
    common = common_changes(found, score**2 / 25.0, score, info, info, np.ones(J, bool), J)
    if count <= 2:
        assert not common.any()
    if count >= 5:
        assert common.all()
