"""Replays of a few days that are far off, each by another share: they say no more of a step than they have in common."""

import numpy as np
import pytest
from test_reference import Lived, of_joint

ARMS, AT, WHICH = 20, 100, 2


def spell(values, *, after=0, then=0.0, arms=ARMS, seed=3):
    """What was told of arms of which one joint is off by `values` [log] on some days, and by `then` on so many days after."""

    def path(day):
        return of_joint(WHICH, values[day - AT] if AT <= day < AT + len(values) else then * (day >= AT))

    return Lived(arms, AT + len(values) + after, path, seed=seed)


def evidence(*spells):
    """Further spells that the soak plays."""
    return [pytest.param(values, marks=pytest.mark.soak) for values in spells]


UPWARDS = [(0.08, 0.46, 0.09), (0.1, 0.2, 0.3), (0.1, 0.45, 0.76), (0.15, 0.4, 0.9)]
DOWNWARDS = [(-0.08, -0.46, -0.09), (-0.235, -0.10, -0.314), (-0.3, -0.12, -0.6)]


@pytest.mark.parametrize("values", [UPWARDS[0], DOWNWARDS[0], *evidence(*UPWARDS[1:], *DOWNWARDS[1:])])
@pytest.mark.slow
def test_three_outliers_that_differ_are_no_step_yet_and_what_was_found_of_one_lies_within_their_range(values):
    """Friction that stays at the middle of them is found within three weeks, and its size is that of the replays that agree."""
    middle = float(np.median(values))
    lived = spell(values, after=21, then=middle)
    assert not lived.found[AT : AT + len(values), :, WHICH].any()
    found = (lived.found[AT:, :, WHICH]).any(axis=0)
    assert found.mean() >= 0.9
    assert np.median(lived.change[found, WHICH]) == pytest.approx(middle, abs=0.03 + 0.15 * abs(middle))
    assert np.all(lived.change[:, WHICH] >= min(0.0, *values) - 0.03)
    assert np.all(lived.change[:, WHICH] <= max(0.0, *values) + 0.03)


@pytest.mark.parametrize("values", [UPWARDS[0], *evidence(*UPWARDS[1:], (0.06, 0.07, 0.45, 0.76, 0.1))])
@pytest.mark.slow
def test_friction_that_was_high_for_some_days_leaves_no_alert(values):
    """What followed was told as a fall, and friction as before as wear from there: for years, up to a limit."""
    lived = spell(values, after=60)
    assert lived.rises[-1, :, WHICH].sum() <= 1
    assert lived.falls[-1, :, WHICH].sum() <= 1
    assert np.median(lived.change[:, WHICH]) == pytest.approx(0.0, abs=0.03)
    assert not np.delete(lived.rises, WHICH, axis=2)[AT:].any()
