"""Usage: wear comes from work, and remaining life is given in revolutions."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_arm import CONTEXT, Arm, History

from monitor.errors import BadInput
from monitor.judge.drift.usage import no_usage, update_usage

J = 6


@given(daily=st.floats(10.0, 1e5), days=st.lists(st.floats(0.1, 10.0), min_size=1, max_size=20))
def test_equal_production_on_every_day_is_one_usual_day_per_day(daily, days):
    """This holds for every interval between replays."""
    usage, count = update_usage(no_usage(1), np.array([0.0]), np.array([0.0])).usage, 0.0
    for span in days:
        count += daily * span
        done = update_usage(usage, np.array([count]), np.array([span]))
        usage = done.usage
        assert done.usual_days[0] == pytest.approx(span)
        assert usage.per_day[0] == pytest.approx(daily)


def test_a_counter_that_is_missing_or_ran_backwards_means_usual_production():
    """Counting continues from its new value."""
    usage = update_usage(no_usage(1), np.array([1000.0]), np.array([0.0])).usage
    usage = update_usage(usage, np.array([2000.0]), np.array([1.0])).usage
    for odd in (np.nan, 5.0):
        done = update_usage(usage, np.array([odd]), np.array([3.0]))
        assert done.usual_days[0] == 3.0
        assert done.factor[0] == 1.0
        assert done.usage.per_day[0] == usage.per_day[0]


@cache
def wearing(*, count: bool) -> History:
    """0.3 % a day of work, on five days of seven; then six weeks of holidays and a replay."""
    history, revolutions, wear = History(), 0.0, 0.0
    for day in range(120):
        maintenance = day % 7 < 5 and day < 78
        revolutions += 4000.0 * maintenance
        wear += 0.003 * maintenance * (day >= 20)
        if day < 78 or day == 119:
            context = replace(CONTEXT, revolutions=(revolutions,) * J if count else None)
            history.add(day, Arm(seed=day, noise=0.008).replay(30.0, np.array([0, wear, 0, 0, 0, 0])), context)
    return history


@pytest.mark.slow
def test_a_holiday_causes_no_wear_where_revolutions_are_counted():
    """Six weeks off after 40 days of work: with a count no wear is predicted for them; without one, days count as work."""
    counted, not_counted = wearing(count=True).last.friction[1], wearing(count=False).last
    assert counted.wear == pytest.approx(0.003 * 42, abs=0.02)
    assert not_counted.belief.friction.innovation[1] < -0.03  # days alone foresaw more
    assert abs(wearing(count=True).last.belief.friction.innovation[1]) < 0.03


@pytest.mark.slow
def test_remaining_life_is_given_in_revolutions():
    """The wear per revolution is constant: from +12.6 % to +30 % at 0.3 % a working day of 4000 revolutions."""
    friction_2 = wearing(count=True).last.friction[1]
    assert friction_2.remaining_revolutions[1] == pytest.approx((0.30 - 0.126) / 0.003 * 4000.0, rel=0.25)
    assert friction_2.revolutions == pytest.approx(4000.0 * 56)
    assert wearing(count=False).last.friction[1].remaining_revolutions == (None, None, None)


def test_counts_of_another_arm_are_refused():
    """One count is expected for each joint."""
    history = History()
    history.add(0, Arm().replay(30.0))
    with pytest.raises(BadInput, match="revolutions has 2 figures; expected 6"):
        history.add(1, Arm().replay(30.0), replace(CONTEXT, revolutions=(1.0, 2.0)))


@pytest.mark.slow
def test_a_replaced_joint_starts_without_wear_and_the_others_keep_theirs():
    """A new serial number shows the replacement; joints 2 and 5 had worn by 20 %."""
    history, serials = History(), ("a", "b", "c", "d", "e", "f")
    worn = np.array([0, 0.2, 0, 0, 0.2, 0])
    for day in range(60):
        history.add(day, Arm(seed=day).replay(30.0, worn * (day >= 30)), replace(CONTEXT, joint_serials=serials))
    assert history.last.friction[1].wear == pytest.approx(0.2, abs=0.04)
    renewed = ("a", "B2", "c", "d", "e", "f")
    for day in range(60, 90):
        verdict = history.add(day, Arm(seed=day).replay(30.0, np.array([0, -0.1, 0, 0, 0.2, 0])), replace(CONTEXT, joint_serials=renewed))
        if day == 60:
            assert any("joints 2 were replaced" in warning.text for warning in verdict.warnings)
    assert abs(verdict.friction[1].wear) < 0.03
    assert verdict.friction[4].wear == pytest.approx(0.2, abs=0.04)


@pytest.mark.slow
def test_maintenance_is_neither_a_fall_nor_the_wear_of_another_joint():
    """Grease lowers friction of joint 3 by 15 %, declared as maintenance: no alert of a fall, and joint 5 keeps the wear that it had."""
    history = History()
    for day in range(80):
        greased = day >= 50
        context = replace(CONTEXT, maintenance="2025-08-05 joint 3 greased" if greased else None)
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0, 0.1 * (day >= 25) - 0.15 * greased, 0, 0.1 * (day >= 25), 0])), context)
    assert abs(history.last.friction[2].wear) < 0.04
    assert history.last.friction[4].wear == pytest.approx(0.1, abs=0.04)
    assert not [transition for transition in history.transitions if transition[3] == "friction_falling"]


@pytest.mark.parametrize(
    "declared",
    [{"maintenance": "joint 3 greased"}, {"joint_serials": ("a", "b", "X", "d", "e", "f")}],
    ids=lambda declared: next(iter(declared)),
)
@pytest.mark.slow
def test_maintenance_that_is_declared_once_holds_for_later_replays(declared):
    """A manifest states it on the line of that day only: it holds for every payload."""
    history, serials = History(), ("a", "b", "c", "d", "e", "f")
    for day in range(60):
        context = replace(CONTEXT, joint_serials=serials) if day == 0 else replace(CONTEXT, **declared) if day == 30 else CONTEXT
        if day in {35, 36}:
            context = replace(CONTEXT, payload_kg=2.0)
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0, -0.15 * (day >= 30), 0, 0, 0])), context)
    assert history.transitions == []
    assert len(history.last.belief.contexts) == 2  # work is of the arm, and no context: without the payload, and with it
