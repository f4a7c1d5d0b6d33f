"""The reference is smooth, ends at its goal and keeps its limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.model.robot import load_robot
from monitor.simulate.arm.reference import SERVO_MAX_RAD_S2, Reference, Servoj

H = 0.002
TICK_S = 0.008  # a move is the same for every length of step
ZERO = np.zeros(6)


def wave(t: float) -> np.ndarray:
    """A motion from rest with at most 1.9 rad/s and 11.8 rad/s²."""
    w = 2 * np.pi
    return np.full(6, 0.15 * (1 - np.cos(w * max(t, 0.0))))


def run(reference: Reference, seconds: float) -> list[tuple[np.ndarray, np.ndarray]]:
    path = []
    for _ in range(round(seconds / H)):
        reference.step(H)
        path.append((reference.q, reference.qd))
    return path


@given(goal=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), speed=st.floats(0.1, 3.0), acceleration=st.floats(0.2, 10.0))
def test_a_move_ends_exactly_at_its_goal_within_its_limits(goal, speed, acceleration):
    """For any goal of a movej, the leading joint keeps speed and acceleration, and so do the others."""
    reference = Reference(load_robot("ur5"), ZERO, 0.008)
    reference.move(np.array(goal), speed, acceleration)
    path = []
    while not reference.at_rest:
        reference.step(TICK_S)
        path.append(reference.qd)
        assert len(path) < 1e6
    assert np.allclose(reference.q, goal, atol=1e-9)
    if path:
        assert np.abs(path).max() <= speed * (1 + 1e-9)
        steps = np.abs(np.diff([ZERO, *path], axis=0)).max()
        assert steps <= acceleration * TICK_S * (1 + 1e-6)


@given(qd=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), deceleration=st.floats(1.0, 30.0))
def test_a_stop_takes_the_time_that_its_deceleration_gives(qd, deceleration):
    """All joints reach standstill together, on a straight line in joint space."""
    reference = Reference(load_robot("ur5"), ZERO, 0.008)
    reference.speed(np.array(qd), 1e6)
    reference.step(H)
    begun = reference.q
    reference.stop(deceleration)
    time_s = 0.0
    while not reference.at_rest:
        reference.step(H)
        time_s += H
    fastest = np.abs(qd).max()
    assert time_s == pytest.approx(fastest / deceleration, abs=2 * H)
    assert np.allclose(reference.q - begun, np.array(qd) * fastest / deceleration / 2, atol=fastest * H)


def test_a_move_from_motion_stops_first():
    """One asynchronous move replaces another without a jump of the position."""
    reference = Reference(load_robot("ur5"), ZERO, 0.008)
    reference.move(np.ones(6), 1.0, 1.0)
    run(reference, 0.6)
    reference.move(-np.ones(6), 1.0, 1.0)
    path = [reference.q, *(q for q, _ in run(reference, 6.0))]
    assert np.abs(np.diff(path, axis=0)).max() <= 1.0 * H * (1 + 1e-9)
    assert np.allclose(reference.q, -1.0)


@pytest.mark.parametrize("tick_s", [0.008, 0.002])
@pytest.mark.parametrize("lost", ["none", "late", "skipped"])
def test_servoj_follows_a_stream_at_125_hz_on_both_generations(tick_s, lost):
    """A motion with 11.8 rad/s² is followed within 8 mrad, even if one packet in a hundred is late or lost."""
    rng = np.random.default_rng(0)
    reference = Reference(load_robot("ur5"), ZERO, tick_s)
    every, errors, accelerations, waiting = round(0.008 / tick_s), [], [], []
    for k in range(round(4.0 / tick_s)):
        t = k * tick_s
        arrived = []
        if k % every == 0:
            arrived, waiting = [*waiting, wave(t)], []
            if lost != "none" and rng.random() < 0.01:
                waiting, arrived = (arrived if lost == "late" else []), []
        reference.follow(arrived, 0.008, 0.03, 500.0)
        for _ in range(round(tick_s / H)):
            reference.step(H)
            accelerations.append(reference.qdd)
        errors.append(reference.q - wave(t + tick_s))
    assert np.abs(errors).max() < 8e-3  # 4.5 mrad of filter lag; a lost packet adds 2–3
    assert np.abs(accelerations).max() < 25.0  # no jerk to the limit of 30: the drives would saturate


def test_targets_that_come_faster_than_servoj_lasts_give_the_same_motion():
    """An e-Series gets targets at 500 Hz with a `time` of 8 ms. The newest counts, and the estimated speed is right."""
    reference = Reference(load_robot("ur5"), ZERO, 0.002)
    errors = []
    for k in range(1000):
        reference.follow([wave(k * 0.002)], 0.008, 0.03, 500.0)
        reference.step(H)
        errors.append(reference.q - wave((k + 1) * 0.002))
    assert np.abs(errors).max() < 6e-3  # the filter's 4.5 mrad


def test_a_dead_stream_goes_back_to_its_last_target():
    """servoj latches: without new targets the arm comes to rest at the last one."""
    reference = Reference(load_robot("ur5"), ZERO, 0.008)
    for k in range(20):
        reference.follow([wave(k * 0.008)], 0.008, 0.03, 500.0)
        run(reference, 0.008)
    for _ in range(125):
        reference.follow([], 0.008, 0.03, 500.0)
        run(reference, 0.008)
    assert np.allclose(reference.q, wave(19 * 0.008), atol=1e-4)
    assert np.allclose(reference.qd, 0.0, atol=1e-3)
    assert not reference.at_rest  # it still servoes


def test_a_distant_target_is_approached_within_the_limits():
    """A target three radians away: speed and acceleration stay within their limits."""
    reference = Reference(load_robot("ur5"), ZERO, 0.008)
    path = []
    for _ in range(300):
        reference.follow([np.full(6, 3.0)], 0.008, 0.03, 500.0)
        path += run(reference, 0.008)
    speeds = np.array([qd for _, qd in path])
    assert np.abs(speeds).max() <= load_robot("ur5").max_speed_rad_s[0] + 1e-9
    assert np.abs(np.diff(speeds, axis=0)).max() <= SERVO_MAX_RAD_S2 * H * (1 + 1e-9)
    assert np.allclose(reference.q, 3.0, atol=1e-3)


def accelerations(late_s):
    """(N, 2) q̈ at 500 Hz of a stream of two sines, and the true q̈. Target i arrives late by `late_s[i]`; `late_s` is (N,)."""
    w, sent_s = np.array([np.pi, 1.7 * np.pi]), 0.008 * np.arange(len(late_s))

    def swing(t_s, change):
        return np.array([1.0, 0.6]) * w**change * np.sin(w * t_s[..., None] + change * np.pi / 2)

    q, qd = (swing(np.zeros(1), change)[0] for change in (0, 1))
    stream, targets, found = Servoj(q.tolist(), qd.tolist(), 0.008, 0.008, [20.0, 20.0]), swing(sent_s, 0), []
    arrives = np.searchsorted(sent_s, np.maximum.accumulate(sent_s + late_s))  # tick of each target: none overtakes another
    for tick in range(len(late_s)):
        stream.receive(targets[arrives == tick].tolist(), 0.008, 0.03, 500.0)
        rows = stream.advance(0.002, 4, q, qd)
        q, qd = rows[-1, 0], rows[-1, 1]
        found.append(rows[:4, 2])
    t_s = 0.002 * (np.arange(4 * len(late_s)) + 0.5)
    return np.concatenate(found), swing(t_s, 2)


def roughness(late_s):
    """RMS of the error of q̈ after the start of the stream, at the delay that gives the smallest error [rad/s²]."""
    found, true = accelerations(late_s)
    return min(np.std(found[1000:] - np.roll(true, shift, axis=0)[1000:]) for shift in range(-5, 20))


def test_a_change_of_acceleration_is_extrapolated_for_even_targets_and_not_for_uneven_ones(monkeypatch):
    """It halves the error for even targets. With 4 ms of jitter it would shake the arm, so there it has no effect."""
    even, jitter = np.full(2000, 0.003), 0.003 + np.abs(np.random.default_rng(0).normal(0.0, 0.004, 2000))
    with_turns = roughness(even), roughness(jitter)
    monkeypatch.setattr("monitor.simulate.arm.reference.QDD_CHANGE_GAIN", 0.0)
    without = roughness(even), roughness(jitter)
    assert with_turns[0] < 0.6 * without[0]
    assert with_turns[1] < 1.05 * without[1]


@pytest.mark.parametrize(("age_ticks", "n"), [(0, 1), (0, 4), (1, 4), (3, 2)])
def test_a_tick_at_once_is_the_tick_step_by_step(age_ticks, n):
    """While no limit is met, the product of matrices equals the loop with limits up to rounding (10⁻¹⁰ rad/s²)."""
    once, slowly = (Servoj([0.1] * 6, [0.0] * 6, 0.008, 0.008, [3.0] * 6) for _ in range(2))
    q, qd = np.full(6, 0.1), np.zeros(6)
    for k in range(4):
        for stream in (once, slowly):
            stream.receive([[0.1 + 1e-5 * j * k * k for j in range(6)]], 0.008, 0.03, 500.0)
        if k < 3:
            once.advance(0.002, 4, q, qd)
            *_, (q, qd, _) = np.array(slowly.step_by_step(0.002, 4, q.tolist(), qd.tolist())).reshape(-1, 3, 6)
    for _ in range(age_ticks):
        once.advance(0.002, 1, q, qd)
        slowly.step_by_step(0.002, 1, q.tolist(), qd.tolist())
    expected = np.array(slowly.step_by_step(0.002, n, q.tolist(), qd.tolist())).reshape(-1, 3, 6)
    assert np.abs(once.advance(0.002, n, q, qd) - expected).max() < 1e-10
    assert np.abs(expected[-1, 2]).max() > 1e-3  # it did move
