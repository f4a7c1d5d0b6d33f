"""Replays of a few days that are far off, each by another share: they say no more of a step than they have in common."""

import numpy as np
import pytest
from test_reference import J, Lived, of_joint

ARMS, AT, WHICH = 20, 100, 2


def spell(values, *, after=0, then=0.0, arms=ARMS, seed=3):
    """What was told of arms of which one joint is off by `values` [log] on some days, and by `then` on so many days after."""

    def path(day):
        return of_joint(WHICH, values[day - AT] if AT <= day < AT + len(values) else then * (day >= AT))

    return Lived(arms, AT + len(values) + after, path, seed=seed)


def changes(lived):
    """(A,) change of the joint's friction over the beginning [log], and (A,) whether a step was found on the last day."""
    return lived.joints.change.reshape(-1, J)[:, WHICH], lived.found[-1, :, WHICH]


def evidence(*spells):
    """Further spells that the soak plays."""
    return [pytest.param(values, marks=pytest.mark.soak) for values in spells]


UPWARDS = [(0.08, 0.46, 0.09), (0.1, 0.2, 0.3), (0.1, 0.45, 0.76), (0.15, 0.4, 0.9)]
DOWNWARDS = [(-0.08, -0.46, -0.09), (-0.235, -0.10, -0.314), (-0.3, -0.12, -0.6)]


@pytest.mark.parametrize("values", [UPWARDS[0], DOWNWARDS[0], *evidence(*UPWARDS[1:], *DOWNWARDS[1:])])
@pytest.mark.slow
def test_outliers_that_differ_are_a_step_within_their_range(values):
    """Not (y₃ − ρ·y₂)/(1 − ρ), which was a rise of 18 % after falls of 8, 46 and 9 %."""
    size, found = changes(spell(values))
    assert found.sum() >= 5
    assert np.all(size[found] >= min(values) - 0.03)
    assert np.all(size[found] <= max(values) + 0.03)
    assert size[found] == pytest.approx(np.mean(values), abs=0.5 * np.ptp(values))


@pytest.mark.parametrize("values", [UPWARDS[0], *evidence(*UPWARDS[1:], (0.06, 0.07, 0.45, 0.76, 0.1))])
@pytest.mark.slow
def test_friction_that_was_high_for_some_days_leaves_no_alert(values):
    """What followed was told as a fall, and friction as before as wear from there: for years, up to a limit."""
    lived = spell(values, after=60)
    assert lived.rises[-1, :, WHICH].sum() <= 1
    assert lived.falls[-1, :, WHICH].sum() <= 1
    assert np.median(changes(lived)[0]) == pytest.approx(0.0, abs=0.03)
