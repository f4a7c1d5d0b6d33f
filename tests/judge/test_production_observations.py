"""Observations from an arm's ordinary work: a level and a noise of their own, alerts of their own rank, and a replay that arbitrates."""

import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm, History

from monitor.errors import BadInput
from monitor.judge.belief import belief_from_document
from monitor.judge.document import plain, typed
from monitor.judge.drift.step import OUTLIER, STEP, new_joints
from monitor.judge.friction.figures import change_with_unfound, suspected_rise
from monitor.judge.production import ProductionAssessment, assess_production
from monitor.judge.production_observation import ProductionObservation
from monitor.judge.settings import AssessSettings
from monitor.reason import reason_of

SETTINGS = AssessSettings()
LEARNT = 40  # days of replays before the first work
RESTARTED = 5  # observations after which the belief is read as by a restart: to write and read it costs twice as much as to judge it
OFFSET = 0.12  # [log] of work beside the excitation
OF_PRODUCTION = np.array([1, 1, 1, 0, 1, 1])  # joint 4 is never excited by this work


def told(day: float, friction_nm, rng, *, known=OF_PRODUCTION, arm="replay 1") -> ProductionObservation:
    """What a day's work tells of friction (J,) at 30 °C."""
    torque = friction_nm * np.exp(OFFSET + 0.012 * rng.normal(size=6))
    return ProductionObservation(
        begin_unix_s=START_S + (day - 0.4) * DAY_S,
        end_unix_s=START_S + day * DAY_S,
        reference_speed_rad_s=0.4,
        friction_nm=torque,
        deviation_nm=0.05 * torque,
        noise_nm=0.005 * torque,
        temperature_c=30.0 + 0.5 * rng.normal(size=6),
        share=np.where(known, 2.0, 0.02),
        known=known.astype(float),
        arm=arm,
        reasons=(reason_of("joint 4: 0.02 of what is needed"),),
        left_out_s={"contact": 12.0},
    )


def friction(history: History) -> np.ndarray:
    """(J,) the synthetic arm's friction at the reference speed and about 30 °C, as its replays told it."""
    return np.exp(history.last.belief.level())


class Plant:
    """An arm that was learnt by replays, and is observed at work from then on."""

    def __init__(self) -> None:
        self.history, self.rng, self.observed = History(), np.random.default_rng(3), 0
        for day in range(LEARNT):
            self.replay(day)
        self.friction = friction(self.history)

    def replay(self, day: int, wear=None) -> None:
        self.history.add(day, Arm(seed=day, noise=0.01).replay(30.0, np.zeros(6) if wear is None else wear), CONTEXT)

    def production(self, day: float, wear=None, **different) -> ProductionAssessment:
        risen = self.friction * (1.0 + (np.zeros(6) if wear is None else wear))
        return self.observe(told(day, risen, self.rng, **different))

    def observe(self, observation: ProductionObservation, context=CONTEXT) -> ProductionAssessment:
        history = self.history
        found = assess_production(observation, context, belief=history.last.belief, health=history.health, settings=SETTINGS)
        belief = found.belief
        if self.observed % RESTARTED == 0:
            belief = belief_from_document(json.loads(json.dumps(belief.as_document())))  # as a restart reads it
        self.observed += 1
        history.last, history.health = replace(history.last, belief=belief, health=found.health), found.health
        return found


def worn(joint: int, by: float) -> np.ndarray:
    wear = np.zeros(6)
    wear[joint - 1] = by
    return wear


@pytest.fixture(scope="module")
def settled():
    """A plant after 40 replays and 20 days of work; tests copy it."""
    plant = Plant()
    for day in range(LEARNT, LEARNT + 20):
        plant.production(day)
    return plant


@pytest.fixture
def plant(settled):
    copy = object.__new__(Plant)
    copy.history = object.__new__(History)
    copy.history.__dict__.update(settled.history.__dict__)
    copy.friction, copy.rng, copy.observed = settled.friction, np.random.default_rng(4), 0
    return copy


def level_of_production(plant: Plant) -> np.ndarray:
    """(J,) log friction at work, at the temperature of the first replay and without wear."""
    state = plant.history.last.belief.friction
    return state.of_joints((state.p * state.x[:, -1]).sum(axis=0))


def alerts(plant: Plant) -> list:
    return [(alert.joint, alert.tier) for alert in plant.history.health.active_alerts]


@pytest.mark.slow
def test_a_belief_with_production_is_read_back_exactly(plant):
    belief = plant.history.last.belief
    document = belief.as_document()
    assert belief.friction.of_production
    assert belief_from_document(json.loads(json.dumps(document))).as_document() == document


def test_an_observation_is_read_back_exactly():
    one = told(1.0, np.ones(6), np.random.default_rng(0))
    assert plain(typed(ProductionObservation, json.loads(json.dumps(plain(one))), where="observation")) == plain(one)


def test_what_differs_between_production_and_excitation_for_good_is_no_wear(plant):
    """Work shows 12 % more friction than the replays from its first day on: that is its level, and no joint has worn."""
    belief = plant.history.last.belief
    assert np.all(np.abs(belief.wear[OF_PRODUCTION == 1]) < 0.02)
    assert alerts(plant) == []
    assert np.allclose(level_of_production(plant)[OF_PRODUCTION == 1] - np.log(plant.friction)[OF_PRODUCTION == 1], OFFSET, atol=0.03)


def test_a_joint_that_production_does_not_excite_learns_nothing_from_it(plant):
    belief = plant.history.last.belief
    assert belief.friction.of_joints(belief.friction.periods).tolist() == [20, 20, 20, 0, 20, 20]
    assert belief.learnt_replays.tolist() == [LEARNT] * 6
    assert np.isnan(belief.production.learnt_at_unix_s[3])
    assert plant.history.health.joints[3].learnt_at_unix_s == START_S + (LEARNT - 1) * DAY_S
    assert plant.history.health.joints[0].learnt_at_unix_s == START_S + (LEARNT + 19) * DAY_S


def test_noise_of_production_is_learnt_from_production_and_that_of_replays_from_replays(plant):
    """Work scatters by 1.2 % here, and no source changes what is known of the other's noise."""
    state = plant.history.last.belief.friction
    of_production = np.sqrt(state.of_joints(state.production_var))[OF_PRODUCTION == 1]
    assert np.all((of_production > 0.006) & (of_production < 0.03))
    again = Plant().history.last.belief.friction
    assert np.array_equal(state.scale, again.scale)
    assert np.array_equal(state.informed, again.informed)
    assert again.periods.max() == 0


def test_without_production_a_belief_knows_no_level_of_it_and_learns_as_before(plant):
    """An arm that is never listened to has one level less, and no doubt of another source."""
    never = Plant().history.last.belief
    assert not never.friction.of_production
    assert never.production is None
    assert never.friction.x.shape[1] == plant.history.last.belief.friction.x.shape[1] - 1


@pytest.mark.slow
def test_production_alone_raises_an_advisory_and_asks_for_a_replay_before_it_raises_wear(plant):
    """A step of 20 % in joint 2 that only work has seen: an advisory, and one replay that agrees makes it the wear tier."""
    for day in range(LEARNT + 20, LEARNT + 32):
        found = plant.production(day, worn(2, 0.2))
    assert alerts(plant) == [(2, "advisory")]
    assert found.asks == (2,)
    assert "no replay has confirmed it yet" in plant.history.health.active_alerts[0].text.text
    assert plant.history.last.belief.unconfirmed.tolist() == [False, True, False, False, False, False]
    plant.replay(LEARNT + 32, worn(2, 0.2))
    assert alerts(plant) == [(2, "wear")]
    assert plant.history.last.belief.production.asks == ()
    assert not plant.history.last.belief.unconfirmed.any()
    assert "no replay has confirmed it yet" not in plant.history.health.active_alerts[0].text.text


@pytest.mark.slow
def test_production_that_makes_wear_likely_asks_for_replays_before_it_is_sure(plant):
    """A step of 5 % that only work sees is suspected before it is found, of that joint alone, and a replay answers; noise asks for none."""
    quiet = [plant.production(day).suspects for day in range(LEARNT + 20, LEARNT + 30)]
    assert quiet == [()] * 10
    told_of = [plant.production(day, worn(2, 0.05)) for day in range(LEARNT + 30, LEARNT + 42)]
    suspected = [k for k, found in enumerate(told_of) if 2 in found.suspects]
    found = [k for k, found in enumerate(told_of) if 2 in found.asks or found.transitions]
    assert suspected
    assert suspected[0] < min(found, default=12)
    assert all(set(found.suspects) <= {2} for found in told_of)
    assert plant.history.last.belief.production.suspects in {(), (2,)}
    plant.replay(LEARNT + 42, worn(2, 0.05))
    assert plant.history.last.belief.production.suspects == ()


@pytest.mark.slow
def test_replays_of_a_joint_that_production_never_moves_are_doubted_until_more_have_told(plant):
    """Joint 4 is known by replays alone: some that show 10 % more are a doubt before they are found."""

    def doubted() -> list[int]:
        return (np.flatnonzero(suspected_rise(plant.history.last.belief.friction, SETTINGS.friction)) + 1).tolist()

    for day in range(LEARNT + 20, LEARNT + 30):
        plant.production(day)
    assert doubted() == []
    first = LEARNT + 30
    seen = []
    for day in range(first, first + 12):
        plant.replay(day, worn(4, 0.1))
        seen.append((doubted(), [joint for joint, _ in alerts(plant)]))
        if seen[-1][1]:
            break
    assert seen[-1][1] == [4]
    assert ([4], []) in seen
    assert all(set(suspects) <= {4} for suspects, _ in seen)


@pytest.mark.slow
def test_a_doubt_that_a_single_replay_leaves_ends_with_the_next_ones(plant):
    """One replay of joint 4 that shows 10 % more may be anything: ten without it leave neither a doubt nor wear."""
    plant.replay(LEARNT + 20, worn(4, 0.1))
    for day in range(LEARNT + 21, LEARNT + 31):
        plant.replay(day)
    assert not suspected_rise(plant.history.last.belief.friction, SETTINGS.friction).any()
    assert abs(plant.history.last.belief.wear[3]) < 0.01


def risen(plant: Plant) -> list[bool]:
    """(J,) whether a rise was found, and is held."""
    state = plant.history.last.belief.friction
    return state.of_joints(state.risen).tolist()


@pytest.mark.slow
def test_a_rise_that_was_found_is_remembered_until_observations_speak_against_it(plant):
    """Joint 2 rises slowly by work and a replay a week; then friction is as before again."""
    found = []
    for day in range(LEARNT + 20, LEARNT + 130):
        wear = worn(2, 0.0008 * (day - LEARNT - 20))
        plant.production(day - 0.2, wear)
        if day % 7 == 0:
            plant.replay(day, wear)
        found.append(risen(plant))
    of_joint = [each[1] for each in found]
    assert of_joint == sorted(of_joint)
    assert not of_joint[0]
    assert of_joint[-1]
    assert not np.array(found)[:, [0, 2, 3, 4, 5]].any()
    for day in range(LEARNT + 130, LEARNT + 160):
        plant.replay(day)
    assert not any(risen(plant))


@pytest.mark.slow
def test_the_rise_of_a_joint_that_was_replaced_is_forgotten(plant):
    for day in range(LEARNT + 20, LEARNT + 40):
        plant.production(day, worn(3, 0.2))
    assert risen(plant)[2]
    belief = plant.history.last.belief
    state = new_joints(belief.drift_state, np.arange(6) == 2, SETTINGS).friction
    assert not state.of_joints(state.risen).any()
    assert not state.of_joints(state.unconfirmed).any()
    assert state.of_joints(state.periods).tolist() == [40, 40, 0, 0, 40, 40]
    assert state.of_joints(state.replays).tolist() == [LEARNT, LEARNT, 0, LEARNT, LEARNT, LEARNT]


@pytest.mark.parametrize("by", [0.06, pytest.param(-0.06, marks=pytest.mark.soak)])
@pytest.mark.slow
def test_the_production_of_a_joint_that_was_replaced_has_a_new_level_and_nothing_found_of_the_old_one(plant, by):
    """A new joint has another friction: its work is neither worn nor in doubt, before the next replay and after it."""
    for day in range(LEARNT + 20, LEARNT + 36):
        plant.production(day, worn(3, 0.15))
    assert plant.history.last.belief.unconfirmed[2]
    belief = plant.history.last.belief
    state = new_joints(belief.drift_state, np.arange(6) == 2, SETTINGS)
    plant.history.last = replace(plant.history.last, belief=belief.with_drift_state(state))
    events = []
    for day in range(LEARNT + 37, LEARNT + 90):
        plant.production(day - 0.2, worn(3, by))
        events.append(plant.history.last.belief.event[2])
        if day % 7 == 0:
            plant.replay(day, worn(3, by))
    assert OUTLIER not in events
    assert STEP not in events
    belief = plant.history.last.belief
    assert abs(belief.wear[2]) < 0.005
    assert abs(change_with_unfound(belief.friction, SETTINGS.friction)[0][2]) < 0.02
    assert np.exp(level_of_production(plant)[2]) == pytest.approx(plant.friction[2] * (1.0 + by) * np.exp(OFFSET), rel=0.02)
    assert not belief.unconfirmed[2]


@pytest.mark.slow
def test_a_replay_that_disagrees_with_production_keeps_the_wear_tier_from_being_raised(plant):
    """The work has changed, not the joint: after one replay nothing is asked for, and after a few the wear is gone."""
    for day in range(LEARNT + 20, LEARNT + 32):
        plant.production(day, worn(2, 0.2))
    claimed = plant.history.last.belief.wear[1]
    for day in range(LEARNT + 32, LEARNT + 36):
        plant.replay(day)
        assert plant.history.last.belief.production.asks == ()
        assert (2, "wear") not in alerts(plant)
    assert claimed > 0.15
    assert plant.history.last.belief.wear[1] < 0.05


def test_production_with_another_payload_or_another_model_of_the_arm_has_another_level(plant):
    """What is 15 % higher under another payload, or by another frozen model, is the level of that work."""
    heavy = replace(CONTEXT, payload_kg=3.0)
    for day in range(LEARNT + 20, LEARNT + 30):
        plant.observe(told(day, plant.friction * 1.15, plant.rng), heavy)
    for day in range(LEARNT + 30, LEARNT + 40):
        plant.observe(told(day, plant.friction * 0.9, plant.rng, arm="replay 60"), heavy)
    assert np.all(np.abs(plant.history.last.belief.wear) < 0.03)
    assert alerts(plant) == []


def test_production_of_another_arm_another_speed_or_an_earlier_day_is_refused(plant):
    one = told(LEARNT + 20, plant.friction, plant.rng)
    with pytest.raises(BadInput, match="rad/s"):
        plant.observe(replace(one, reference_speed_rad_s=0.5))
    with pytest.raises(BadInput, match="ended"):
        plant.observe(replace(one, end_unix_s=START_S))
    small = {name: getattr(one, name)[:5] for name in ("friction_nm", "deviation_nm", "noise_nm", "temperature_c", "share", "known")}
    with pytest.raises(BadInput, match="5 joints"):
        plant.observe(replace(one, **small))
