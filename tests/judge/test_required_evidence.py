"""How sure a rise must be for an advisory: by whether a change was found, when it began, and how old a new wear rate is."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_reference import DRIFT, HEALTH, Lived, of_joint

from monitor.judge.alerts.evidence import (
    WearAfterReplay,
    nothing_counted,
    wear_of_state,
    weigh_evidence,
)
from monitor.judge.drift.update.change_detection import (
    LONG,
    MOST_A_DAY,
    NOISY_STD,
    OF_FREQUENT,
    OF_PRODUCTION,
    OLD_REPLAYS,
    RATE_REPLAYS,
    JointNoise,
    thresholds,
)

J = 6
STD = 0.02


def after_replay(sigmas, *, agreeing=1.0, changed=True, day=100.0):
    """The wear of an arm whose second joint has risen by so many standard deviations of 2 %."""
    return WearAfterReplay(
        wear=of_joint(1, sigmas * STD),
        wear_std=np.full(J, STD),
        known=np.ones(J, dtype=bool),
        usable=np.ones(J, dtype=bool),
        day=np.full(J, day),
        agreeing=np.where(np.arange(J) == 1, agreeing, 1.0),
        interval_days=np.ones(J),
        changed=np.where(np.arange(J) == 1, changed, False),
    )


def raised_at_once(after):
    return weigh_evidence(after, nothing_counted(J, 1), J, HEALTH).raises[1] >= 0


def raised_in_four_days(sigmas, changed):
    """Whether four replays on four days that agree, none of which finds a change, raise an advisory."""
    counts = nothing_counted(J, 1)
    for day in range(4):
        evidence = weigh_evidence(after_replay(sigmas, changed=changed, day=100.0 + day), counts, J, HEALTH)
        counts = evidence.counts
    return evidence.raises[1] >= 0


def test_a_rise_that_began_long_ago_needs_less_on_the_replay_that_finds_it():
    """2.8 σ are enough where 60 replays agree since, and not where 20 do: what chance finds is mostly young."""
    assert raised_at_once(after_replay(2.8, agreeing=60.0))
    assert not raised_at_once(after_replay(2.8, agreeing=LONG - 8.0))
    assert raised_at_once(after_replay(3.1, agreeing=LONG - 8.0))
    assert not raised_at_once(after_replay(2.6, agreeing=60.0))


def test_wear_that_no_change_explains_needs_more():
    """What the filter follows without a change having been found, as a sensor that drifts, is told from 3.5 σ on, and not from 3."""
    assert raised_in_four_days(3.2, changed=True)
    assert not raised_in_four_days(3.2, changed=False)
    assert raised_in_four_days(3.7, changed=False)


def needed(age, *, noise=0.02, known=0.0, interval_days=1.0, beside_production=False, drift=DRIFT):
    """(2,) the thresholds of a step and of a rate of an age, in a joint of so much noise."""
    of_joint = JointNoise(*np.array([[known], [noise**2], [interval_days]]))
    return thresholds(np.full((1, 1), age), drift, of_joint, beside_production=beside_production)[0, :, 0]


@given(st.floats(1.0, 300.0), st.floats(1.0, 300.0), st.floats(0.0, 1.0), st.floats(0.0, 0.5), st.booleans())
def test_an_older_change_never_needs_more_evidence(age, other, known, noise, beside_production):
    """Thresholds fall with age; that of a rate is never above that of a step of its age, as far as the joint's noise does not lower it."""
    of = partial(needed, known=known, beside_production=beside_production)
    young, old = (of(each, noise=noise) for each in sorted((age, other)))
    assert np.all(old <= young + 1e-12)
    assert old[1] <= of(max(age, other))[0] + 1e-12


@given(st.floats(1.0, 300.0), st.floats(0.0, 1.0), st.floats(0.0, 0.5), st.booleans())
def test_noise_lowers_the_evidence_of_old_steps_alone(age, known, noise, beside_production):
    """From 28 replays on, between a noise of 2.8 % and one of 5.4 %; not beside work, nor that of a rate."""
    of = partial(needed, age, known=known, beside_production=beside_production)
    usual, noisy = of(), of(noise=noise)
    assert noisy[1] == usual[1]
    assert noisy[0] <= usual[0]
    lowered = age >= LONG and NOISY_STD[0] < noise < NOISY_STD[1] and known < 1.0 and not beside_production
    assert lowered or noisy[0] == usual[0]


def test_an_old_step_in_a_noisy_joint_needs_less_evidence():
    """After 40 replays 4.14 σ at σ 2 %, 4.05 at 3 %, 3.90 at 4 %, 4.04 at 5 % and 4.14 again at 6 %."""
    of_step = [needed(40.0, noise=noise)[0] for noise in (0.02, 0.03, 0.04, 0.05, 0.06)]
    assert np.sqrt(of_step) == pytest.approx([4.14, 4.05, 3.90, 4.04, 4.14], abs=0.01)


@given(st.floats(1.0, 300.0), st.floats(1e-3, 30.0), st.floats(0.0, 0.5), st.booleans())
def test_frequent_replays_need_more_evidence_each(age, interval_days, noise, beside_production):
    """By 3·ln of their number a day, up to four; replays once a day and more rarely, and those beside work, need what they did."""
    daily, of = (
        needed(age, noise=noise, beside_production=beside_production),
        needed(age, noise=noise, interval_days=interval_days, beside_production=beside_production),
    )
    a_day = 1.0 if beside_production else np.clip(1.0 / interval_days, 1.0, MOST_A_DAY)
    assert of == pytest.approx(daily + OF_FREQUENT * np.log(a_day))
    if interval_days >= 1.0:
        assert np.array_equal(of, daily)


@given(st.floats(1.0, 300.0), st.floats(0.0, 1.0), st.floats(0.0, 0.5))
def test_who_switched_steps_or_rates_off_has_the_other_kind_as_before(age, known, noise):
    """Thresholds of 20 σ: of a kind that is off, no candidate of any age is found."""
    for beside_production in (False, True):
        of = partial(needed, age, noise=noise, known=known, beside_production=beside_production)
        as_set, no_steps, no_rates = of(), of(drift=replace(DRIFT, shift_sigma=20.0)), of(drift=replace(DRIFT, pace_sigma=20.0))
        assert no_steps[0] > 300.0
        assert no_rates[0] == as_set[0]
        if age >= RATE_REPLAYS:  # a younger rate is hardly distinct from a step, and has its threshold
            assert no_rates[1] > 300.0
            assert no_steps[1] == as_set[1]


def test_an_old_step_needs_no_more_evidence_than_a_rate_did_at_once():
    """From 20 replays on both have the same threshold, until that of a rate falls faster; beside work, a step keeps its own."""
    of_step, of_rate = np.transpose([needed(age) for age in (19.0, 20.0, 40.0, 80.0)])
    assert of_step[:3] == pytest.approx(of_rate[:3])
    assert of_step[3] > of_rate[3]
    assert np.sqrt(of_step) == pytest.approx([4.54, 4.30, 4.14, 3.97], abs=0.01)
    assert needed(20.0, beside_production=True)[0] == pytest.approx(DRIFT.shift_sigma**2 - 2.0 * np.log(20.0) + OF_PRODUCTION)


def test_a_rate_that_began_months_ago_needs_less_than_before():
    """After 80 replays a rate needs 3.79 σ, where 3.97 are by the frequency of chance alone; after 40 the two are the same."""
    by_chance = np.sqrt(DRIFT.pace_sigma**2 - 2.0 * np.log([OLD_REPLAYS, 2.0 * OLD_REPLAYS]))
    of_rate = np.sqrt([needed(OLD_REPLAYS)[1], needed(2.0 * OLD_REPLAYS)[1]])
    assert of_rate[0] == pytest.approx(by_chance[0])
    assert of_rate[1] == pytest.approx(np.sqrt(by_chance[1] ** 2 - 2.0 * np.log(2.0)))
    assert np.all(of_rate > 3.5)
    assert by_chance == pytest.approx([4.14, 3.97], abs=0.01)
    assert of_rate == pytest.approx([4.14, 3.79], abs=0.01)


@pytest.mark.slow
def test_joints_in_which_nothing_was_found_are_known_as_such_and_a_step_is_remembered():
    """Eight healthy arms of 100 days, and a step of 15 % in their third joints: only those have changed."""
    lived = Lived(8, 100, lambda day: of_joint(2, 0.15 * (day >= 70)), seed=11)
    changed = wear_of_state(lived.joints, lived.joints.learnt_from, 99.0).changed.reshape(8, J)
    assert changed[:, 2].all()
    assert np.delete(changed, 2, axis=1).sum() <= 1
