"""From which level wear counts: running-in and new grease do not hide the wear that follows, and common changes blame no joint."""

from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.judge.alerts.evidence import weigh_evidence
from monitor.judge.drift.step import STEP, Replay, initial_state, new_joints, step
from monitor.judge.friction.decision import DecisionSettings, Odds, crossings
from monitor.judge.friction.figures import change_found, expected, expected_row, found_wear
from monitor.judge.friction.observation import Observation
from monitor.judge.friction.states import RATE, SLOPE, WEAR
from monitor.judge.friction.step import FrictionState, refer
from monitor.judge.settings import AssessSettings

SETTINGS = AssessSettings()
MODEL = SETTINGS.friction
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
        viscous_nm_s_per_rad=0.4 * torque / SETTINGS.drift.reference_speed_rad_s,
    )


class Lived:
    """What was told of A arms whose friction follows a path; each field has a row a day, or one for each of several replays a day."""

    def __init__(self, arms, days, path, seed=0, between_std=0.02, interval_days=1.0):
        rng, N = np.random.default_rng(seed), arms * J
        noise, state = between_std * rng.normal(size=N), None
        self.rises, self.falls, self.found = np.zeros((3, days, arms, J), bool)
        self.together = np.zeros((days, arms), bool)
        for day in range(days):
            noise = 0.5 * noise + np.sqrt(0.75) * between_std * rng.normal(size=N)
            T = 30.0 + rng.normal(size=N)
            seen = observed(np.broadcast_to(path(day), (arms, J)).ravel() + noise - 0.008 * (T - 30.0) + 2.0, T)
            state = state or initial_state(seen, J, SETTINGS)
            replay = Replay(observation=seen, days=np.full(arms, interval_days * (day > 0)))
            state = step(state, replay, SETTINGS, in_place=True).state
            evidence = weigh_evidence(state, SETTINGS.health)
            self.rises[day] = (evidence.raises >= 0).reshape(arms, J)
            self.falls[day] = evidence.falls.reshape(arms, J)
            self.found[day] = (state.event == STEP).reshape(arms, J)
            self.together[day] = evidence.together
        self.state = state

    @property
    def change(self):
        """(A, J) of friction over that at the beginning [log], as found."""
        return change_found(self.state.friction).reshape(-1, J)


def of_joint(j, value):
    """(J,) the value in joint j, from 0, and 0 in the others."""
    return np.where(np.arange(J) == j, value, 0.0)


@pytest.mark.slow
def test_a_common_step_is_told_once_of_the_arm_and_blames_no_joint():
    """All joints rise by 4 % on day 90: common_mode within 50 days. A step of one joint on day 150 is told beyond it."""

    def path(day):
        return 0.04 * (day >= 90) + of_joint(4, 0.08 * (day >= 150))

    lived = Lived(8, 190, path, seed=2)
    assert lived.together[90:140].any(axis=0).sum() >= 6  # of 8
    assert lived.rises[:150].any(axis=0).sum() <= 1  # of 48 joints, one may be so early that the others say nothing yet
    assert lived.rises[150:, :, 4].any(axis=0).sum() >= 7


@pytest.mark.slow
def test_two_joints_that_wear_are_both_told():
    """Two of six joints with 10 % at the same replay are no common change."""
    lived = Lived(8, 110, lambda day: (of_joint(0, 0.1) + of_joint(3, 0.1)) * (day >= 90), seed=3)
    assert lived.rises[:, :, [0, 3]].any(axis=0).all()
    assert not lived.rises[:, :, [1, 2, 4, 5]].any()
    assert not lived.together.any()


def test_a_large_step_after_two_weeks_is_told_within_days():
    """30 % are neither noise nor running-in. (Of a joint that steps in the first ten replays nobody knows the noise yet.)"""
    lived = Lived(8, 24, lambda day: of_joint(5, np.log(1.3) * (day >= 14)), seed=4)
    assert lived.rises[:, :, 5].any(axis=0).all()
    assert not np.delete(lived.rises, 5, axis=2).any()


@pytest.mark.slow
def test_running_in_is_no_fall_and_wear_after_it_is_told():
    """Friction of every joint falls by 8 % in the first weeks, and one joint rises by 6 % once it is over."""

    def path(day):
        return 0.08 * np.exp(-day / 20.0) + of_joint(1, 0.06 * (day >= 120))

    lived = Lived(8, 160, path, seed=5)
    assert not lived.falls.any()
    assert not lived.rises[:120].any()
    assert lived.rises[120:, :, 1].any(axis=0).sum() >= 7
    assert lived.rises[:, :, [0, 2, 3, 4, 5]].any(axis=0).sum() <= 1  # of 40, by chance


@pytest.mark.slow
def test_a_rise_counts_from_the_friction_after_new_grease():
    """Nobody declared the grease: friction falls by 10 %, which is told; 6 % more after that are wear, though still below the beginning."""
    lived = Lived(8, 200, lambda day: of_joint(2, -0.10 * (day >= 100) + 0.06 * (day >= 150)), seed=6)
    assert lived.falls[100:150, :, 2].any(axis=0).sum() >= 7
    assert not lived.rises[:150].any()
    assert lived.rises[150:, :, 2].any(axis=0).sum() >= 7
    assert np.median(lived.change[:, 2]) == pytest.approx(-0.04, abs=0.015)


@pytest.mark.slow
def test_a_fall_is_told_by_the_size_that_the_replays_after_it_show():
    """20 % less, of which a few replays told 16 %: after three weeks it is known to 2 %."""
    lived = Lived(8, 125, lambda day: of_joint(2, -0.2 * (day >= 100)), seed=8)
    assert lived.falls[-1, :, 2].all()
    assert lived.change[:, 2] == pytest.approx(-0.2, abs=0.035)
    assert np.median(lived.change[:, 2]) == pytest.approx(-0.2, abs=0.015)
    assert not lived.rises.any()


def some_state(seed) -> FrictionState:
    """The model's state of two arms with arbitrary correlated states."""
    rng, N = np.random.default_rng(seed), 2 * J
    seen = observed(rng.normal(size=N), 30.0 + rng.normal(size=N))
    state = step(initial_state(seen, J, SETTINGS), Replay(observation=seen, days=np.zeros(2)), SETTINGS).state.friction
    A = 0.1 * rng.normal(size=state.P.shape)
    state.P = np.einsum("hikn,hjkn->hijn", A, A)
    state.x = 0.1 * rng.normal(size=state.x.shape)
    return state


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_where_wear_counts_from_changes_no_expected_friction(seed):
    """Wear that moves into the levels leaves the expected friction, its uncertainty and the change since the beginning as they were."""
    before = some_state(seed)
    state, which = deepcopy(before), np.random.default_rng(seed).random(2 * J) < 0.5
    n = state.channels_of(which)
    refer(state, n)
    T = np.full(2 * J, 31.0)
    H = expected_row(before, T, np.zeros(2 * J), MODEL)
    for one, other in zip(expected(before, H), expected(state, H), strict=True):
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12)
    assert np.allclose(change_found(state), change_found(before), atol=1e-12)
    assert not state.x[:, [WEAR, RATE]][..., n].any()
    assert not state.P[:, WEAR][..., n].any()
    others = state.channels_of(~which)
    assert np.array_equal(state.x[..., others], before.x[..., others])


def test_a_replaced_joint_keeps_its_slope_as_a_first_guess_with_the_doubt_of_a_new_one_and_no_other_changes():
    """Its levels are unknown, its wear is none, and what was learnt of the others stays."""
    lived = Lived(2, 60, lambda day: of_joint(3, 0.1 * (day >= 40)), seed=1).state
    new = np.arange(2 * J) == 3
    after = new_joints(lived, new, SETTINGS)
    fresh = initial_state(observed(np.full(2 * J, 2.0), np.full(2 * J, 30.0)), J, SETTINGS).friction

    def slope(state):
        return state.of_joints((state.p * state.x[:, SLOPE]).sum(axis=0))

    assert slope(after.friction) == pytest.approx(slope(lived.friction), abs=1e-12)
    assert after.friction.P[0, SLOPE, SLOPE, 3] >= fresh.P[0, SLOPE, SLOPE, 3]
    assert after.friction.of_joints(after.friction.replays).tolist() == [60.0] * 3 + [0.0] + [60.0] * 8
    assert found_wear(after.friction)[0][3] == 0.0
    assert change_found(after.friction)[new].tolist() == [0.0]
    kept = after.friction.channels_of(~new)
    assert np.array_equal(after.friction.x[..., kept], lived.friction.x[..., kept])


@given(order=st.permutations(range(J)), count=st.integers(1, 6), fall=st.booleans())
def test_a_change_is_common_where_most_joints_show_it_whichever_they_are(order, count, fall):
    """Of six joints that changed by 5 % each, one to two are their own, and five or six are the arm's."""
    which = np.isin(np.arange(J + 1), list(order)[:count])
    odds = np.where(which, 1e7, 1.0)
    odds[J] = 1e9 if count > 2 else 1e6
    change = np.where(which, 0.05, 0.0)
    change[J] = change[:J].mean()
    R = np.ones((2, J + 1))
    R[int(fall)] = odds
    limits = np.repeat(DecisionSettings().limits(J)[:, None], J + 1, axis=1)
    every = np.ones(J + 1, dtype=bool)
    of_change = Odds(R, -change if fall else change, np.ones((1, J + 1)))
    told = crossings(of_change, limits, every, np.ones((1, J), dtype=bool), J, DecisionSettings())
    of_joints = (told.falls if fall else told.rises)[:J]
    if count <= 2:
        assert not told.common.any()
        assert np.array_equal(of_joints, which[:J])
    if count >= 5:
        assert told.common[int(fall)].all()
        assert not of_joints.any()
