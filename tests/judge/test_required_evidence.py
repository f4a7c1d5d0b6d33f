"""How sure a rise must be for an advisory: by whether a change was found, when it began, and how old a new wear rate is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_reference import DRIFT, HEALTH, Lived, of_joint

from monitor.judge.alerts.evidence import (
    WearAfterReplay,
    advisory_sigmas,
    nothing_counted,
    required_of_joints,
    wear_of_state,
    weigh_evidence,
)
from monitor.judge.drift.noise.chance import chance_from_document
from monitor.judge.drift.update.change_detection import LONG, OF_WORK, OLD_REPLAYS, RATE_REPLAYS, thresholds

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


def test_where_nobody_knows_of_changes_the_evidence_is_that_of_before():
    """An arm whose belief is of a release that did not remember changes."""
    joints = Lived(1, 30, lambda day: np.zeros(J)).joints
    older = replace(joints, chance=chance_from_document(None, J))
    required = advisory_sigmas(J, HEALTH)
    assert required_of_joints(wear_of_state(older, joints.learnt_from, 29.0), required) == pytest.approx(required)


@given(st.floats(1.0, 300.0), st.floats(1.0, 300.0), st.floats(0.0, 1.0), st.booleans())
def test_an_older_change_never_needs_more_evidence(age, other, known, beside_work):
    """Thresholds fall with age; that of a rate is never above that of a step of its age."""
    young, old = (
        thresholds(np.full((1, 1), each), DRIFT, np.full(1, known), beside_work=beside_work)[0, :, 0] for each in sorted((age, other))
    )
    assert np.all(old <= young + 1e-12)
    assert old[1] <= old[0] + 1e-12


@given(st.floats(1.0, 300.0), st.floats(0.0, 1.0))
def test_who_switched_steps_or_rates_off_has_the_other_kind_as_before(age, known):
    """Thresholds of 20 σ: of a kind that is off, no candidate of any age is found."""
    ages, known = np.full((1, 1), age), np.full(1, known)
    for beside_work in (False, True):
        as_set = thresholds(ages, DRIFT, known, beside_work=beside_work)[0, :, 0]
        no_steps = thresholds(ages, replace(DRIFT, shift_sigma=20.0), known, beside_work=beside_work)[0, :, 0]
        no_rates = thresholds(ages, replace(DRIFT, pace_sigma=20.0), known, beside_work=beside_work)[0, :, 0]
        assert no_steps[0] > 300.0
        assert no_rates[0] == as_set[0]
        if age >= RATE_REPLAYS:  # a younger rate is hardly distinct from a step, and has its threshold
            assert no_rates[1] > 300.0
            assert no_steps[1] == as_set[1]


def test_an_old_step_needs_no_more_evidence_than_a_rate_did_at_once():
    """From 20 replays on both have the same threshold, until that of a rate falls faster; beside work, a step keeps its own."""
    of_step, of_rate = thresholds(np.array([[19.0, 20.0, 40.0, 80.0]]), DRIFT, np.zeros(1))[0]
    assert of_step[:3] == pytest.approx(of_rate[:3])
    assert of_step[3] > of_rate[3]
    assert np.sqrt(of_step) == pytest.approx([4.54, 4.30, 4.14, 3.97], abs=0.01)
    beside = thresholds(np.array([[20.0]]), DRIFT, np.zeros(1), beside_work=True)[0, 0, 0]
    assert beside == pytest.approx(DRIFT.shift_sigma**2 - 2.0 * np.log(20.0) + OF_WORK)


def test_a_rate_that_began_months_ago_needs_less_than_before():
    """After 80 replays a rate needs 3.79 σ, where 3.97 are by the frequency of chance alone; after 40 the two are the same."""
    by_chance = np.sqrt(DRIFT.pace_sigma**2 - 2.0 * np.log([OLD_REPLAYS, 2.0 * OLD_REPLAYS]))
    of_rate = np.sqrt(thresholds(np.array([[OLD_REPLAYS, 2.0 * OLD_REPLAYS]]), DRIFT, np.zeros(1))[0, 1])
    assert of_rate[0] == pytest.approx(by_chance[0])
    assert of_rate[1] == pytest.approx(np.sqrt(by_chance[1] ** 2 - 2.0 * np.log(2.0)))
    assert np.all(of_rate > 3.5)
    assert by_chance == pytest.approx([4.14, 3.97], abs=0.01)
    assert of_rate == pytest.approx([4.14, 3.79], abs=0.01)


def test_joints_in_which_nothing_was_found_are_known_as_such_and_a_step_is_remembered():
    """Eight healthy arms of 100 days, and a step of 15 % in their third joints: only those have changed."""
    lived = Lived(8, 100, lambda day: of_joint(2, 0.15 * (day >= 70)), seed=11)
    changed = wear_of_state(lived.joints, lived.joints.learnt_from, 99.0).changed.reshape(8, J)
    assert changed[:, 2].all()
    assert np.delete(changed, 2, axis=1).sum() <= 1
