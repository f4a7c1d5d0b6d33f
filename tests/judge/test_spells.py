"""Replays of a few days that are far off: unequal ones say no more than they have in common, and friction that is back has not risen."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_reference import DRIFT, J, Lived, of_joint

from monitor.judge.document import plain
from monitor.judge.drift.filter_state import LEVELS, STEP, WEAR
from monitor.judge.drift.reference import from_beginning, reference_from_document
from monitor.judge.drift.slots import SLOTS
from monitor.judge.drift.update.lowest_level import HELD_DAYS, LEAST_FALL, SURE, count_from_lowest

ARMS, AT, WHICH = 20, 100, 2


def spell(values, *, after=0, arms=ARMS, then=0.0):
    """What was told of arms of which one joint is off by `values` [log] on some days, and by `then` on so many days after."""

    def path(day):
        return of_joint(WHICH, values[day - AT] if AT <= day < AT + len(values) else then * (day >= AT))

    return Lived(arms, AT + len(values) + after, path, seed=3)


def changes(lived):
    """(A,) change of the joint's friction over the beginning [log], and (A,) whether a step was found on the last day."""
    return lived.joints.change.reshape(-1, J)[:, WHICH], lived.found[-1, :, WHICH]


UNEQUAL = [(-0.08, -0.46, -0.09), (0.08, 0.46, 0.09), (-0.235, -0.10, -0.314), (0.1, 0.2, 0.3), (0.1, 0.45, 0.76), (-0.3, -0.12, -0.6)]


@pytest.mark.parametrize("values", UNEQUAL)
def test_outliers_that_differ_are_a_step_within_their_range_and_no_tier_yet(values):
    """Not (y₃ − ρ·y₂)/(1 − ρ), which was a rise of 18 % after falls of 8, 46 and 9 %. They do not agree, so nothing is raised by them."""
    lived = spell(values)
    size, found = changes(lived)
    assert found.sum() >= 5
    assert np.all(size[found] >= min(values) - 0.03)
    assert np.all(size[found] <= max(values) + 0.03)
    assert size[found] == pytest.approx(np.mean(values), abs=0.5 * np.ptp(values))
    assert not lived.rises[-1][found].any()
    assert not lived.falls[-1][found].any()


@given(st.integers(1, 3), st.lists(st.floats(0.1, 0.7), min_size=3, max_size=5), st.booleans())
@settings(max_examples=10, deadline=None)
def test_a_step_is_never_found_on_the_other_side_of_the_outliers_that_found_it(seed, sizes, downwards):
    """Whatever they are, and however many; nor is it much larger than the largest."""
    side = -1.0 if downwards else 1.0
    lived = Lived(6, AT + len(sizes), lambda day: of_joint(WHICH, side * sizes[day - AT] if day >= AT else 0.0), seed=seed)
    size, _ = changes(lived)
    assert np.all(side * size >= -0.05)
    assert np.all(side * size <= 1.25 * max(sizes) + 0.05)


def test_outliers_that_agree_are_told_at_once():
    """Three replays that are 20 % off raise an alert of the joint on the third day, in both directions."""
    for value, told in ((0.2, "rises"), (-0.2, "falls")):
        lived = spell((value,) * 3)
        size, found = changes(lived)
        assert found.sum() >= 18
        assert size[found] == pytest.approx(value, abs=0.04)
        assert getattr(lived, told)[-1, :, WHICH].sum() >= 18


def test_a_joint_that_rises_day_by_day_is_told_within_days():
    """Friction that is higher every day differs too: the alert waits for replays that agree, and no longer."""
    lived = spell((0.1, 0.45, 0.76), after=20, then=0.76)
    assert lived.rises[AT + 6 :, :, WHICH].all()
    assert changes(lived)[0] == pytest.approx(0.76, abs=0.05)


@pytest.mark.parametrize("values", [(-0.1,) * 3, (-0.1,) * 7, (-0.1,) * 14, (-0.2,) * 3, (0.1,) * 7, *UNEQUAL], ids=str)
def test_friction_that_is_back_within_weeks_leaves_no_alert(values):
    """Low replays of some days were a lower level that was held, and what followed was wear from there: for years, up to a limit."""
    lived = spell(values, after=60)
    assert lived.rises[-1, :, WHICH].sum() <= 1
    assert lived.falls[-1, :, WHICH].sum() <= 1
    assert np.median(changes(lived)[0]) == pytest.approx(0.0, abs=0.02)
    assert np.mean(np.abs(changes(lived)[0]) > 0.06) <= 0.1


def test_a_level_that_was_held_for_longer_is_where_wear_counts_from():
    """Friction that falls by 10 %, and rises by as much two months later, has risen: new grease, and then wear."""
    lived = spell((-0.1,) * 60, after=30)
    assert lived.falls[AT : AT + 60, :, WHICH].any(axis=0).sum() >= 18
    assert lived.rises[-1, :, WHICH].sum() >= 18


@cache
def healthy():
    """The state of one arm after some months."""
    return spell((), after=1, arms=1).joints


def fallen_by(last_fall, wear, *, wear_std=0.015, held_days=5.0):
    """A state of six joints of which the first fell so much some days ago, and now has so much wear."""
    state = healthy()
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[0, WEAR], cov[0, WEAR, WEAR] = wear, wear_std**2
    fell = of_joint(0, last_fall)
    reference = replace(state.counted_from, fallen=fell, last_fall=fell, held_days=np.where(np.arange(J) == 0, held_days, np.nan))
    return replace(state, mean=mean, cov=cov, counted_from=reference, event=np.full(J, STEP))


@given(st.floats(-0.6, -0.05), st.floats(0.0, 0.8), st.floats(0.0, 60.0))
def test_a_fall_is_undone_where_friction_is_back_and_changes_no_prediction(fall, wear, held_days):
    """Levels and wear together are what they were; what counts as wear is what friction has more than before the fall."""
    before = fallen_by(fall, wear, held_days=held_days)
    after = count_from_lowest(before, np.ones(J), DRIFT)
    levels = slice(LEVELS, LEVELS + SLOTS)
    assert after.mean[:, levels] + after.mean[:, [WEAR]] == pytest.approx(before.mean[:, levels] + before.mean[:, [WEAR]])
    assert after.change == pytest.approx(before.change)
    assert np.array_equal(after.cov, before.cov)
    sure = SURE * before.wear_std[0]
    back = held_days + 1.0 <= HELD_DAYS and wear >= max(-fall - sure, sure)
    if min(abs(wear + fall + sure), abs(wear - sure)) > 1e-6:
        assert after.wear[0] == pytest.approx(wear + fall if back else wear)
        assert after.counted_from.fallen[0] == pytest.approx(0.0 if back else fall)


def test_a_fall_whose_size_is_hardly_known_is_not_yet_a_level():
    """It stays in wear, for the replays that follow to say how large it is: as a level of its own it would take up whatever comes next."""
    known, unknown = (fallen_by(0.0, -0.2, wear_std=std) for std in (0.005, 0.08))
    moved, stays = (count_from_lowest(each, np.ones(J), DRIFT) for each in (known, unknown))
    assert moved.wear[0] == pytest.approx(0.0, abs=LEAST_FALL)
    assert stays.wear[0] == pytest.approx(-0.2)


def test_beliefs_of_releases_that_knew_no_last_fall_are_read():
    """As if every fall had been held for long."""
    some = replace(from_beginning(J), fallen=of_joint(1, -0.1), last_fall=of_joint(1, -0.1))
    document = json.loads(json.dumps(plain(some)))
    assert np.array_equal(reference_from_document(document, J).last_fall, some.last_fall)
    del document["last_fall"]
    assert not reference_from_document(document, J).last_fall.any()
