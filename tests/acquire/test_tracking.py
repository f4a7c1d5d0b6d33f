"""The arm against the controller's own target, and that target against what was sent. Values only."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.acquire.safety.way import joint_path
from monitor.acquire.ur.failures import Tracking

TICK_S = 0.008
RECENT = 25


ELSEWHERE = {"late", "stalled", "program_stopped"}  # the controller's own target is not where it was sent: another program may move it


def ended(q, own, sent, *, late=lambda n: False):
    """(cause, text, number of the row) of the first failure in rows (N, J); None where there is none."""
    tracking = Tracking(TICK_S, largest_rad=0.05, lasting_rad=0.005)
    speeds = np.gradient(own, TICK_S, axis=0)
    for n in range(1, len(q)):
        failure = tracking.failure(q[n], own[n], speeds[n], sent[max(0, n - RECENT) : n], late=late(n))
        if failure:
            assert failure.ours == (failure.cause not in ELSEWHERE)
            return failure.cause, str(failure), n
    return None


def sweep(speeds, seconds=1.0):
    t = np.arange(0.0, seconds, TICK_S)
    return np.outer(t, speeds)


def delayed(rows, ticks):
    return rows[np.maximum(np.arange(len(rows)) - ticks, 0)]


@pytest.mark.parametrize("speed_rad_s", [0.033, 0.1, 0.5, 2.5])
def test_a_joint_that_sticks_is_seen_within_a_quarter_of_a_second(speed_rad_s):
    """Also a slow one: beside a joint that has far to go, another moves at 0.03 rad/s; it took 1.7 s to be seen before."""
    sent = sweep([2.5, speed_rad_s, 0.0, 0.0, 0.0, 0.0])
    own = delayed(sent, 2)
    q = delayed(own, 1)
    stuck_at = 40
    q[stuck_at:, 1] = q[stuck_at, 1]
    cause, text, n = ended(q, own, sent)
    assert cause == "following_error"
    assert "joint 2" in text
    assert "own target" in text
    assert (n - stuck_at) * TICK_S <= 0.25


def test_every_joint_that_sticks_anywhere_in_an_approach_is_seen_before_it_is_1_degree_behind():
    """From the first moment on, where the path is slow: what counts is how far the arm is from its target."""
    there = joint_path(np.zeros(6), np.array([1.5, 0.05, -0.6, 0.3, 0.02, -1.0]), speed_rad_s=0.5, acceleration_rad_s2=1.5)
    t = np.arange(0.0, there.duration_s, TICK_S)
    sent = np.array([there.at(each) for each in t])
    own = delayed(sent, 2)
    for joint in (0, 2, 3, 5):
        for stuck_at in (1, 20, 60, 150):
            q = delayed(own, 1)
            q[stuck_at:, joint] = q[stuck_at, joint]
            _, text, n = ended(q, own, sent)
            assert f"joint {joint + 1}" in text
            assert abs(own[n, joint] - q[n, joint]) < np.radians(1.0) + 0.06 * 0.5


@given(speeds=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), lag=st.integers(0, 4), seed=st.integers(0, 100))
def test_a_servo_that_lags_by_up_to_four_ticks_is_no_failure(speeds, lag, seed):
    """Ten times the lag of real arms, with the noise of encoders."""
    sent = sweep(speeds)
    own = delayed(sent, 3)
    q = delayed(own, lag) + np.random.default_rng(seed).normal(0.0, 1e-4, own.shape)
    assert ended(q, own, sent) is None


def test_late_targets_are_no_deviation_of_the_arm():
    """A gap of 60 ms: the controller's target waits, the arm waits with it, and both go on. Nothing ends, and nobody is asked."""
    sent = sweep([2.5, -1.0, 0.0, 0.0, 0.0, 0.0])
    sent[60:68] = sent[60]  # nothing came
    sent[68:] = sent[60] + sweep([2.5, -1.0, 0.0, 0.0, 0.0, 0.0])[: len(sent) - 68]
    own = delayed(sent, 2)
    assert ended(delayed(own, 1), own, sent, late=lambda n: 60 <= n <= 125) is None


@pytest.mark.parametrize(("late", "cause"), [(True, "late"), (False, "stalled")])
@pytest.mark.parametrize("share", [0.2, 0.4])
def test_a_controller_that_is_behind_what_it_was_sent_gets_its_targets_late(late, cause, share):
    """The arm is where its controller wants it, and that goes where it was sent long ago: nothing holds it, and nobody need look at it."""
    sent = sweep([0.5] * 6)
    own = sent.copy()
    own[60:] = sent[60] + share * (sent[60:] - sent[60])
    found, text, _ = ended(own, own, sent, late=lambda n: late)
    assert found == cause
    assert "was sent" in text or "late" in text


@pytest.mark.parametrize("speeds", [[0.3, 0.0, 0.0, 0.0, 0.0, 0.0], [0.5, -0.3, 2.0, 0.0, 0.0, 0.2]])
@pytest.mark.parametrize("its_speed", [-0.4, 0.0, 1.0])
def test_a_controller_that_goes_its_own_way_has_another_program(speeds, its_speed):
    """It took the place of ours within one tick, so that no row shows a stopped one. It was named stalled, as if the network were slow.

    Ours would have ended by then, because it lives 0.1 s without targets.
    """
    sent = sweep(speeds)
    own = delayed(sent, 2)
    own[60:] = own[60]
    own[60:, 3] += its_speed * TICK_S * np.arange(len(own) - 60)
    cause, text, _ = ended(delayed(own, 1), own, sent)
    assert cause == "program_stopped"
    assert "the place of ours" in text


def test_targets_that_stop_for_less_than_our_program_lives_without_them_are_no_other_program():
    """At 500 Hz a fast motion leaves what was sent before the watchdog has spoken."""
    tracking = Tracking(0.002, largest_rad=0.05, lasting_rad=0.005)
    sent = np.outer(np.arange(0.0, 1.0, 0.002), [2.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    q = sent[100]
    found = [tracking.failure(q, q, np.zeros(6), sent[n - RECENT : n], late=False) for n in range(101, 160)]
    assert next(each for each in found if each is not None).cause == "stalled"


def test_an_arm_that_leaves_its_controllers_target_is_no_host_that_is_late():
    """Also where the host was late just before: a person must look."""
    sent = sweep([0.5] * 6)
    q = sent.copy()
    q[50:, 2] -= 0.2
    assert ended(q, sent, sent, late=lambda n: True)[0] == "following_error"


def test_a_position_that_is_no_number_is_a_failure():
    """Also for a single row."""
    q = sweep([0.1] * 6)
    broken = q.copy()
    broken[30, 4] = np.nan
    assert ended(broken, q, q)[2] == 30


@pytest.mark.parametrize("late", [False, True])
def test_an_encoder_whose_zero_moves_is_no_late_target_although_the_controller_believes_it(late):
    """Measured position and the controller's own target jump together, by more than a joint can move: a person must look."""
    sent = sweep([0.5, 0.2, -0.4, 0.1, 0.0, 0.3])
    own = delayed(sent, 2)
    own[40:, 2] += 0.2
    cause, text, n = ended(delayed(own, 0), own, sent, late=lambda _: late)
    assert cause == "following_error"
    assert "joint 3" in text
    assert n == 40


def test_rows_that_are_far_apart_are_no_jump():
    """Up to the gap at which the stream ends, at the fastest joint's speed."""
    tracking = Tracking(TICK_S, largest_rad=0.05, lasting_rad=0.005)
    t = np.cumsum([0.0, 0.008, 0.096, 0.008, 0.048])
    sent = np.outer(t, [2.5] * 6)
    for q, step_s in zip(sent, [TICK_S, *np.diff(t)], strict=True):
        assert tracking.failure(q, q, np.full(6, 2.5), sent, late=True, step_s=step_s) is None
