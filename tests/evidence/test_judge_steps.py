"""Steps, spells of outliers and common changes, over fleets: what is found, how soon, and how large it is told."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evidence.lived import J, Lived, correlated, fleet, lived, of_joint
from monitor.judge.friction.figures import unseen_step
from monitor.judge.settings import AssessSettings

pytestmark = pytest.mark.soak
MODEL = AssessSettings().friction
AT, WHICH = 100, 2
DOWNWARDS = [(-0.08, -0.46, -0.09), (-0.235, -0.10, -0.314), (-0.3, -0.12, -0.6)]


def spell(values: tuple[float, ...], *, after: int = 0, then: float = 0.0, arms: int = 20, seed: int = 3) -> Lived:
    """Friction of one joint is off by these values from day `AT` on, then by `then`."""
    course = np.concatenate([np.zeros(AT), values, np.full(after, then)])
    return fleet(arms, of_joint(WHICH, course), seed=seed)


@given(st.integers(1, 3), st.lists(st.floats(0.1, 0.7), min_size=3, max_size=5), st.booleans())
@settings(max_examples=10, deadline=None)
def test_a_step_is_never_found_on_the_other_side_of_the_outliers_that_found_it(seed, sizes, downwards):
    """Whatever they are, and however many; nor is it much larger than the largest."""
    side = -1.0 if downwards else 1.0
    found = spell(tuple(side * each for each in sizes), arms=6, seed=seed).state.friction
    change = found.of_joints((found.p * found.x[:, 0]).sum(axis=0) + found.moved).reshape(-1, J)[:, WHICH]
    assert np.all(side * change >= -0.05)
    assert np.all(side * change <= 1.25 * max(sizes) + 0.05)


def test_a_step_of_a_fifth_is_told_within_ten_days_however_long_noise_lasts() -> None:
    """Joint 2 steps by 20 % on day 120, in 8 arms of ρ 0, 8 of 0.5 and 8 of 0.9: an alert of it within ten days in 7 or more of each."""
    y = correlated(np.random.default_rng(4), 130, 24 * J, rho=np.repeat([0.0, 0.5, 0.9], 8 * J))
    y[120:, 1::J] += np.log(1.2)
    raised = lived(y).raises >= 0
    assert (raised[120:, :, 1].any(axis=0).reshape(3, 8).sum(axis=1) >= 7).all()
    assert raised[60:120].any(axis=0).sum() <= 1


@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_the_size_of_a_step_is_known_no_better_than_outliers_that_share_their_noise_tell(rho: float) -> None:
    """Joint 2 of 80 arms steps by 20 % on day 90: over the six days from its alert on, wear is within 1.645 of its ± in 84 % and more."""
    course, arms = of_joint(1, np.log(1.2) * (np.arange(115) >= 90)), 80
    found = fleet(arms, course, seed=6, rho=rho)
    raised = found.raises[90:, :, 1] >= 0
    assert raised.any(axis=0).all()
    days = np.minimum(90 + np.argmax(raised, axis=0) + np.arange(6)[:, None], 114)
    wear, std = (each[days, np.arange(arms), 1] for each in (found.wear, found.std))
    assert np.mean(np.abs(wear - np.log(1.2)) < 1.645 * std) > 0.84


@pytest.mark.parametrize(("value", "within_days"), [(0.2, 8), (-0.2, 8)])
def test_a_large_step_is_told_within_eight_replays_whichever_way_it_goes(value: float, within_days: int) -> None:
    """No replay counts for more than 2.3 σ: so 20 % takes some replays, of which half the arms need no more than seven."""
    found = spell((value,) * within_days)
    told = (found.raises >= 0 if value > 0 else found.falls)[AT:, :, WHICH]
    assert told.any(axis=0).sum() >= 16
    change = found.state.friction
    size = change.of_joints((change.p * change.x[:, 0]).sum(axis=0) + change.moved).reshape(-1, J)[:, WHICH]
    assert size[told.any(axis=0)] == pytest.approx(value, abs=0.08)


def test_outliers_do_not_prove_a_step_in_noise_that_has_them() -> None:
    """2.5 % of the replays are off by 15 %, in 20 arms for ten months: hardly a joint has an alert."""
    rng, arms, days = np.random.default_rng(9), 20, 300
    y = correlated(rng, days, arms * J)
    y += (rng.random(y.shape) < 0.025) * rng.choice([-0.15, 0.15], size=y.shape)
    assert lived(y).told().sum() <= 4


def test_a_joint_that_rises_day_by_day_is_told_within_days():
    """Friction that is higher every day differs too: it is told within ten days, and its size is known to a tenth after a month."""
    found = spell((0.1, 0.45, 0.76), after=30, then=0.76)
    assert (found.raises[: AT + 11, :, WHICH] >= 0).any(axis=0).all()
    assert found.wear[-1, :, WHICH] == pytest.approx(0.76, abs=0.1)


@pytest.mark.parametrize("values", DOWNWARDS)
def test_friction_that_was_low_for_some_days_is_no_wear_afterwards(values):
    """No sound joint stands at a tier because three low days differed."""
    assert (spell(values, after=60).raises[-1, :, WHICH] >= 0).sum() <= 1


def test_running_in_is_no_alert_and_hides_no_step():
    """Friction falls by 8 % in two months, in all joints: nothing is told of it. A step of 8 % on day 200 is told of its joint alone."""
    day = np.arange(250)
    course = -0.08 * (1.0 - np.exp(-day / 60.0))[:, None] + of_joint(2, 0.08 * (day >= 200))
    found = fleet(8, course, seed=3)
    assert not (found.raises[:200] >= 0).any()
    assert not found.falls.any()
    assert not found.together.any()
    assert (found.raises[:, :, 2] >= 0).any(axis=0).sum() >= 7
    assert not (np.delete(found.raises, 2, axis=2) >= 0).any()


def test_new_grease_that_nobody_declared_is_told_and_hides_no_wear():
    """A fall of 10 % at once is told within three weeks in most of 24 arms; wear of 20 % a year from then on is told within eight months.

    It is told although friction stays below the beginning.
    """
    day = np.arange(300)
    course = of_joint(1, np.log(0.9) * (day >= 70) + np.log1p(0.2 * np.maximum(day - 70, 0) / 365.0))
    assert course[220, 1] < -0.02
    found = fleet(24, course, seed=1)
    assert found.falls[70:91, :, 1].any(axis=0).sum() >= 14
    assert not (found.raises[:70] >= 0).any()
    assert (found.raises[:220, :, 1] >= 0).any(axis=0).sum() >= 12
    assert (found.raises[:, :, 1] >= 0).any(axis=0).sum() >= 18


def test_a_rise_of_all_joints_together_is_told_of_the_arm_and_of_no_joint():
    """8 % on day 80 in all joints of 16 arms, as a supply or a load makes it."""
    found = fleet(16, np.tile(0.08 * (np.arange(130) >= 80)[:, None], (1, J)), seed=5)
    assert found.together[80:].any(axis=0).sum() >= 14
    assert (found.raises >= 0).any(axis=(0, 2)).sum() <= 2


def test_four_replays_a_day_find_no_more_by_chance_than_one():
    """Sixty healthy arms for three months, ρ 0.5 from replay to replay: R counts days, and not replays."""
    often = fleet(60, np.zeros((360, J)), seed=4, interval_days=0.25)
    assert often.told(slice(40, None)).any(axis=1).sum() <= 4
    assert often.together[40:].any(axis=0).sum() <= 4


def test_the_step_that_may_be_unseen_is_the_one_that_is_found():
    """In 60 arms of σ = 2 % one joint steps by the size that is told for it: nine of ten are found within ten days, to 80 %."""
    arms, day = 60, 90
    noise = correlated(np.random.default_rng(3), day + 11, arms * J)
    unseen = unseen_step(lived(noise[:day]).state.friction, MODEL)
    stepped = (np.arange(arms * J) % J == 1) & np.isfinite(unseen.days)
    assert stepped.sum() >= 57
    assert np.all(unseen.days[stepped] < 16.0)
    assert np.all((unseen.log_rise[stepped] > 0.02) & (unseen.log_rise[stepped] < 0.12))
    noise[day:] += np.where(stepped, unseen.log_rise, 0.0)
    assert (lived(noise).raises[day:] >= 0).any(axis=0).ravel()[stepped].mean() >= 0.8
