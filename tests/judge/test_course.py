"""The course of friction in blocks: what they keep of the replays, and when it begins anew."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_friction_model import J, lived, noise, seen

from monitor.judge.friction.course import (
    BLOCKS,
    COUNT,
    DAYS,
    FULL,
    LAW_SUM,
    LEVEL_AT,
    USE,
    empty_course,
    move_course,
    remember,
    rescale_course,
    settle_level,
)
from monitor.judge.friction.states import LEVEL, SLOPE
from monitor.judge.friction.step import FrictionModel, initial_state, refer, rescale_use, step


def rows(levels: int = 1, slot: int = 0) -> np.ndarray:
    """H (D, 1) of a replay at 2 K in a context."""
    H = np.zeros((LEVEL + levels, 1))
    H[SLOPE], H[LEVEL + slot] = 2.0, 1.0
    return H


@given(replays=st.integers(1, 900), seed=st.integers(0, 9))
@settings(max_examples=20, deadline=None)
@pytest.mark.slow
def test_blocks_keep_every_replay_in_the_order_of_age(replays, seed):
    """The counts and sums are those of all replays, whatever was merged, and the youngest come first."""
    rng = np.random.default_rng(seed)
    course, at = empty_course(1, 1), np.cumsum(rng.choice([1.0, 1.0, 2.0, 10.0], replays))
    y = rng.normal(size=replays)
    for day, value in zip(at, y, strict=True):
        remember(course, np.array([value]), rows(), np.array([day]), np.array([0.5 * day]), np.array([True]))
    count = course[0, :, COUNT]
    assert count.sum() == replays
    assert course[0, :, DAYS].sum() == pytest.approx(at.sum())
    assert course[0, :, USE].sum() == pytest.approx(0.5 * at.sum())
    assert course[0, :, -1].sum() == pytest.approx(y.sum(), abs=1e-9)
    assert course[0, :, LAW_SUM].sum() == 2.0 * replays
    assert course[0, :, LAW_SUM + LEVEL_AT].sum() == replays
    used = count > 0
    assert np.all(np.diff(course[0, used, DAYS] / count[used]) < 0)
    assert used.sum() <= min(BLOCKS, replays // FULL + 1)


def test_another_measure_of_use_another_context_and_a_common_change_keep_what_was_seen():
    """Twice the use in a usual day makes the past half as many usual days; a slot that is taken keeps its old level in the sums."""
    course = empty_course(1, 2)
    for day in range(3):
        remember(course, np.array([2.1]), rows(2, 1), np.array([float(day)]), np.array([float(day)]), np.array([True]))
    rescaled = rescale_course(course, np.array([4.0]), np.array([2.0]))
    assert 3 * 4.0 - rescaled[0, 0, USE] == pytest.approx(0.5 * (3 * 4.0 - course[0, 0, USE]))
    settled = settle_level(course, np.array([0]), np.array([1]), np.array([2.0]))
    assert settled[0, 0, -1] == pytest.approx(3 * 0.1)
    assert settled[0, 0, LAW_SUM + LEVEL_AT + 1] == 0.0
    assert move_course(course, np.array([0.5]))[0, 0, -1] == pytest.approx(3 * 2.6)


def test_the_step_keeps_replays_that_it_learnt_from_and_ages_them_while_the_arm_works():
    """A joint that was not resolved is not kept, nor is an observation of normal work; its days pass all the same."""
    rng, model = np.random.default_rng(3), FrictionModel()
    state = initial_state(seen(np.zeros(J)), J, model, levels=2)
    for day in range(20):
        y = 0.02 * rng.normal(size=J)
        y[3] = np.nan if day % 2 else y[3]
        state = step(state, seen(y), np.array([float(day > 0)]), model, use=np.full(J, 0.5 * (day > 0)), in_place=True)
    state = step(state, seen(np.full(J, 0.3)), np.array([2.0]), model, production=True, in_place=True)
    count = state.course[:, :, COUNT].sum(axis=1)
    assert count.tolist() == [20.0, 20.0, 20.0, 10.0, 20.0, 20.0, 20.0]

    def ago(total: np.ndarray, k: int) -> float:
        return float(20 * total[0] - state.course[0, :, k].sum())

    assert ago(state.age_days, DAYS) == pytest.approx(sum(age + 2.0 for age in range(20)))
    assert ago(state.use, USE) == pytest.approx(sum(0.5 * age + 2.0 for age in range(20)))
    rescale_use(state, np.full(J + 1, 2.0))
    assert ago(state.use, USE) == pytest.approx(0.5 * sum(0.5 * age + 2.0 for age in range(20)))


def test_a_gross_outlier_is_kept_as_no_more_than_the_filters_believe():
    """One replay of twice the friction moves its block by a hundredth at most: it is no part of a path."""
    y = noise(np.random.default_rng(4), 61, J, std=0.01)
    without = lived(y, FrictionModel()).course[2, :, -1].sum()
    y[-1, 2] += np.log(2.0)
    assert 0.0 < lived(y, FrictionModel()).course[2, :, -1].sum() - without < 0.06


def test_the_course_begins_anew_with_a_new_joint_and_where_wear_counts_from_a_new_level():
    """Of that joint, and of the mean where it is asked for; not of others."""
    y, model = noise(np.random.default_rng(5), 60, J), FrictionModel()
    state = lived(y, model)
    new = np.arange(J) == 1
    after = step(state, seen(y[-1]), np.ones(1), model, replaced=new)
    assert after.course[:, :, COUNT].sum(axis=1).tolist() == [61.0, 1.0, 61.0, 61.0, 61.0, 61.0, 61.0]
    refer(after, np.array([2]))
    assert after.course[2].sum() == 0.0
    assert after.course[3, :, COUNT].sum() == 61.0


def test_a_change_of_all_joints_moves_the_course_with_the_level():
    """Six per cent in every joint on day 100: what was seen before is kept as if it had been seen after it, to a hundredth."""
    y = noise(np.random.default_rng(8), 160, 3 * J)
    y[100:, J : 2 * J] += 0.06
    state = lived(y, FrictionModel())
    of_arm = state.course[J + 1 : 2 * J + 1]
    blocks = of_arm[:, :, -1] / np.maximum(of_arm[:, :, COUNT], 1.0)
    age = state.age_days[0] - of_arm[:, :, DAYS] / np.maximum(of_arm[:, :, COUNT], 1.0)
    used = of_arm[:, :, COUNT] > 0
    before, after = (blocks[used & side].mean() for side in (age > 65.0, age < 40.0))
    assert abs(after - before) < 0.02
