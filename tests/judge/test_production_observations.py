"""Observations from an arm's ordinary work: a level and a noise of their own, alerts of their own rank, and a replay that arbitrates."""

import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm, History

from monitor.errors import BadInput
from monitor.judge.belief import belief_from_document
from monitor.judge.document import plain, typed
from monitor.judge.drift.filter_state import ORDINARY, OUTLIER, PRODUCTION_LEVEL, STEP, replace_joints
from monitor.judge.drift.from_production import begin_production, correlated_over, observed, swapped
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import new_joints
from monitor.judge.drift.suspicion import DOUBT_REPLAYS, SUSPICIOUS, doubted_rise, suspected_rise
from monitor.judge.drift.update import change_detection
from monitor.judge.drift.update.change_detection import LONG, STEP_STD, SUMMED, JointNoise, thresholds
from monitor.judge.production import ProductionAssessment, assess_production
from monitor.judge.production_observation import ProductionObservation
from monitor.judge.settings import HealthSettings
from monitor.judge.temperature.laws import TemperatureSettings
from monitor.reason import reason_of

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
        found = assess_production(
            observation, context, belief=history.last.belief, health=history.health, settings=DriftSettings(), laws=TemperatureSettings(),
            limits=HealthSettings(),
        )  # fmt: skip
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


def alerts(plant: Plant) -> list:
    return [(alert.joint, alert.tier) for alert in plant.history.health.active_alerts]


@pytest.mark.slow
def test_a_belief_with_production_is_read_back_exactly(plant):
    belief = plant.history.last.belief
    document = belief.as_document()
    assert len(document["filter_state"]["mean"][0]) == 12
    assert belief_from_document(json.loads(json.dumps(document))).as_document() == document


def test_an_observation_is_read_back_exactly():
    one = told(1.0, np.ones(6), np.random.default_rng(0))
    assert plain(typed(ProductionObservation, json.loads(json.dumps(plain(one))), where="observation")) == plain(one)


def test_what_differs_between_production_and_excitation_for_good_is_no_wear(plant):
    """Work shows 12 % more friction than the replays from its first day on: that is its level, and no joint has worn."""
    belief = plant.history.last.belief
    assert np.all(np.abs(belief.wear[OF_PRODUCTION == 1]) < 0.02)
    assert alerts(plant) == []
    state = belief.filter_state
    assert np.allclose((state.mean[:, 10] - state.level(belief.slot))[OF_PRODUCTION == 1], OFFSET, atol=0.03)


def test_a_joint_that_production_does_not_excite_learns_nothing_from_it(plant):
    belief = plant.history.last.belief
    assert belief.filter_state.sources.other_number.tolist() == [20, 20, 20, 0, 20, 20]
    assert np.isnan(belief.production.learnt_at_unix_s[3])
    assert plant.history.health.joints[3].learnt_at_unix_s == START_S + (LEARNT - 1) * DAY_S
    assert plant.history.health.joints[0].learnt_at_unix_s == START_S + (LEARNT + 19) * DAY_S


def test_noise_of_production_is_learnt_from_production_and_that_of_replays_from_replays(plant):
    """Work scatters by 1.2 % here, and neither source changes what is known of the other's noise."""
    settings, state = DriftSettings(), plant.history.last.belief.filter_state
    of_production = np.sqrt(swapped(state).noise_var(6, settings))
    assert np.all((of_production > 0.008) & (of_production < 0.03))
    again = Plant().history.last.belief.filter_state
    assert np.array_equal(state.step_var, again.step_var)
    assert np.array_equal(state.product, again.product)


def test_noise_that_was_correlated_over_a_day_is_hardly_so_over_a_week(plant):
    """Replays were daily with ρ = 0.6, and are weekly from now on: over a week ρ⁷ is left, of noise that is as large as before."""
    state = plant.history.last.belief.filter_state
    var = np.full(6, 0.02**2)
    state = replace(
        state,
        step_var=0.4 * var,
        product=0.6 * var,
        sources=replace(state.sources, interval_days=np.ones(6), number=np.full(6, 60.0)),
    )
    everyone = np.ones(6, dtype=bool)
    for _ in range(80):
        state = replace(state, sources=replace(state.sources, since_days=np.full(6, 7.0)))
        state = observed(state, everyone, everyone, 6)
    assert state.sources.interval_days == pytest.approx(7.0, rel=0.01)
    assert state.product / (state.product + state.step_var) == pytest.approx(0.6**7, rel=0.05)
    assert state.product + state.step_var == pytest.approx(var)


def test_the_first_observations_of_a_source_set_its_interval_and_leave_the_prior_correlation(plant):
    state = plant.history.last.belief.filter_state
    state = replace(state, sources=replace(state.sources, interval_days=np.ones(6), number=np.zeros(6), since_days=np.full(6, 7.0)))
    everyone = np.ones(6, dtype=bool)
    after = observed(state, everyone, everyone, 6)
    assert after.sources.interval_days == pytest.approx(7.0)
    assert after.product == pytest.approx(state.product)
    assert after.step_var == pytest.approx(state.step_var)


def test_observations_within_minutes_do_not_make_every_later_one_a_holiday(plant):
    state = plant.history.last.belief.filter_state
    state = replace(state, sources=replace(state.sources, interval_days=np.full(6, 0.01)))
    everyone = np.ones(6, dtype=bool)
    for _ in range(40):
        state = replace(state, sources=replace(state.sources, since_days=np.ones(6)))
        state = observed(state, everyone, everyone, 6)
    assert state.sources.interval_days == pytest.approx(1.0, rel=0.15)


def test_the_size_of_each_joints_noise_stays_when_replays_become_frequent(plant):
    """Weekly replays showed the same noise in each joint, and its correlation only to ±0.1. Now they are daily, and back."""
    state, settings = plant.history.last.belief.filter_state, DriftSettings()
    shown = np.array([0.15, -0.05, 0.05, 0.1, 0.0, 0.05])
    state = replace(state, step_var=0.02**2 * (1.0 - shown), product=0.02**2 * shown, noise_weight=np.full(6, 60.0), activity=np.ones(6))
    daily = correlated_over(state, np.full(6, 1.0 / 7.0), 6)
    sizes = np.sqrt(daily.noise_var(6, settings) / state.noise_var(6, settings))
    assert sizes == pytest.approx(1.0, abs=0.06)
    assert daily.autocorrelation(6, settings) == pytest.approx(0.62, abs=0.02)
    again = correlated_over(daily, np.full(6, 7.0), 6)
    assert again.step_var == pytest.approx(state.step_var)
    assert again.product == pytest.approx(state.product)


def test_noise_that_alternates_keeps_its_correlation_when_the_interval_changes(plant):
    """A negative correlation is none of noise that fades with time."""
    state = plant.history.last.belief.filter_state
    state = replace(state, step_var=np.full(6, 5e-4), product=np.full(6, -1e-4))
    after = correlated_over(state, np.full(6, 7.0), 6)
    assert after.product == pytest.approx(state.product)
    assert after.step_var == pytest.approx(state.step_var)


def test_the_other_source_twice_is_the_state_itself(plant):
    state = plant.history.last.belief.filter_state
    twice = swapped(swapped(state))
    assert np.array_equal(twice.mean, state.mean)
    assert np.array_equal(twice.cov, state.cov)
    assert np.array_equal(twice.step_var, state.step_var)
    assert begin_production(state, 6, DriftSettings()) is state


def test_production_alone_raises_an_advisory_and_asks_for_a_replay_before_it_raises_wear(plant):
    """A step of 20 % in joint 2 that only work has seen: an advisory, and one replay that agrees makes it the wear tier."""
    for day in range(LEARNT + 20, LEARNT + 32):
        found = plant.production(day, worn(2, 0.2))
    assert alerts(plant) == [(2, "advisory")]
    assert found.asks == (2,)
    assert "no replay has confirmed it yet" in plant.history.health.active_alerts[0].text.text
    plant.replay(LEARNT + 32, worn(2, 0.2))
    assert alerts(plant) == [(2, "wear")]
    assert plant.history.last.belief.production.asks == ()


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
def test_a_doubtful_replay_of_a_joint_that_production_never_moves_asks_for_the_next_one_until_replays_have_told(plant):
    """Joint 4 is known by replays alone: one that shows 6 % more is a doubt, a few without it end the doubt, and a step stays in
    doubt until it is found. Joint 2, of which work tells, is not asked for so.
    """

    def doubted() -> list[int]:
        return (np.flatnonzero(doubted_rise(plant.history.last.belief.filter_state)) + 1).tolist()

    for day in range(LEARNT + 20, LEARNT + 30):
        plant.production(day)
    assert doubted() == []
    plant.replay(LEARNT + 30, worn(4, 0.06) + worn(2, 0.06))
    assert doubted() == [4]
    for day in range(LEARNT + 31, LEARNT + 31 + DOUBT_REPLAYS):
        plant.replay(day)
    assert 4 not in doubted()
    found = []
    for day in range(LEARNT + 31 + DOUBT_REPLAYS, LEARNT + 75):
        if day < LEARNT + 60:
            plant.production(day)
            continue
        plant.replay(day, worn(4, 0.1))
        if (4, "advisory") in alerts(plant) or (4, "wear") in alerts(plant):
            found.append(day)
            break
        assert doubted() == [4]
    assert found[0] < LEARNT + 68


def risen(plant: Plant) -> list[float]:
    """(J,) 1 where a rise was found, and wear has held it since."""
    return plant.history.last.belief.filter_state.sources.risen.tolist()


@pytest.mark.soak
def test_a_rise_that_was_found_is_remembered_until_observations_speak_against_it(plant):
    """Joint 2 rises slowly by work and a replay a week; then friction is as before again."""
    found = []
    for day in range(LEARNT + 20, LEARNT + 90):
        wear = worn(2, 0.0005 * (day - LEARNT - 20))
        plant.production(day - 0.2, wear)
        if day % 7 == 0:
            plant.replay(day, wear)
        found.append(risen(plant))
    of_joint = [each[1] for each in found]
    assert of_joint == sorted(of_joint)
    assert of_joint[0] == 0.0
    assert of_joint[-1] == 1.0
    assert not np.array(found)[:, [0, 2, 3, 4, 5]].any()
    for day in range(LEARNT + 90, LEARNT + 110):
        plant.replay(day)
    assert not any(risen(plant))


def test_a_rise_is_found_by_all_starts_together_where_none_of_them_is_sure(plant, monkeypatch):
    """Twenty starts of a step of joint 2 explain what was seen equally well, each with nine tenths of the likelihood ratio of a change."""
    state = plant.history.last.belief.filter_state
    scores, raw, informations = state.glr_scores.copy(), state.raw_glr_scores.copy(), state.glr_informations.copy()
    told, starts = 1e4, slice(28, 48)
    noise = JointNoise(known=np.zeros(6), var=np.zeros(6), interval_days=np.ones(6))
    asked = thresholds(state.ages + 1.0, DriftSettings(), noise, beside_production=True)[1, 0, starts]
    chance = told * state.chance.of_starts()[1, 0, starts]
    scores[1], raw[1], informations[1] = 0.0, 0.0, 0.0
    scores[1, 0, starts] = raw[1, 0, starts] = np.sqrt(0.9 * asked * chance * (1.0 + STEP_STD**-2 / told))
    informations[1, 0, starts] = told
    state = replace(state, glr_scores=scores, raw_glr_scores=raw, glr_informations=informations)
    before = replace(plant.history.last, belief=replace(plant.history.last.belief, filter_state=state))
    events = []
    for summed in (SUMMED, np.inf):
        monkeypatch.setattr(change_detection, "SUMMED", summed)
        plant.history.last = before
        plant.production(LEARNT + 20)
        events.append(plant.history.last.belief.filter_state.event[1])
    assert events == [STEP, ORDINARY]


@pytest.mark.parametrize(("share", "suspected"), [(0.97, False), (1.03, True)])
def test_production_makes_an_old_step_suspected_by_the_threshold_that_it_has_beside_production(plant, share, suspected):
    """A step of joint 2 that began 28 observations ago, just below and just above `SUSPICIOUS` times (5.15 σ)² − 2·ln 28."""
    state = plant.history.last.belief.filter_state
    scores, informations = np.zeros_like(state.glr_scores), np.zeros_like(state.glr_informations)
    told, start = 1e4, int(np.argmax(state.ages[1] >= LONG))
    asked = DriftSettings().shift_sigma ** 2 - 2.0 * np.log(state.ages[1, start])
    chance = told * state.chance.of_starts()[1, 0, start]
    scores[1, 0, start] = np.sqrt(share * SUSPICIOUS * asked * chance * (1.0 + STEP_STD**-2 / told))
    informations[1, 0, start] = told
    state = replace(state, glr_scores=scores, glr_informations=informations)
    assert suspected_rise(state, DriftSettings()).tolist() == [False, suspected, False, False, False, False]


def test_the_rise_of_a_joint_that_was_replaced_is_forgotten(plant):
    state = plant.history.last.belief.filter_state
    state = replace(state, sources=replace(state.sources, risen=np.ones(6)))
    after = replace_joints(state, np.arange(6) == 2, DriftSettings())
    assert after.sources.risen.tolist() == [1.0, 1.0, 0.0, 1.0, 1.0, 1.0]


@pytest.mark.soak
def test_a_step_that_is_found_later_keeps_the_rise_that_was_found_before(plant):
    steps = []
    for day in range(LEARNT + 20, LEARNT + 115):
        wear = worn(2, 0.0005 * (day - LEARNT - 20) + (0.03 if day >= LEARNT + 100 else 0.0))
        plant.production(day - 0.2, wear)
        steps.append(plant.history.last.belief.filter_state.event[1] == STEP)
        if day % 7 == 0:
            plant.replay(day, wear)
        if day == LEARNT + 99:
            assert risen(plant)[1] == 1.0
    assert any(steps[80:])
    assert risen(plant)[1] == 1.0


@pytest.mark.parametrize("by", [0.06, pytest.param(-0.06, marks=pytest.mark.soak)])
@pytest.mark.slow
def test_the_production_of_a_joint_that_was_replaced_has_a_new_level_and_nothing_found_of_the_old_one(plant, by):
    """A new joint has another friction: its work is neither worn nor in doubt, before the next replay and after it."""
    for day in range(LEARNT + 20, LEARNT + 32):
        plant.production(day, worn(3, 0.12))
    belief = plant.history.last.belief
    assert belief.filter_state.sources.unconfirmed[2] > 0.1
    state = new_joints(belief.drift_state, np.arange(6) == 2, DriftSettings(), TemperatureSettings())
    plant.history.last = replace(plant.history.last, belief=belief.with_drift_state(state))
    events = []
    for day in range(LEARNT + 33, LEARNT + 90):
        plant.production(day - 0.2, worn(3, by))
        events.append(plant.history.last.belief.filter_state.event[2])
        if day % 7 == 0:
            plant.replay(day, worn(3, by))
    assert OUTLIER not in events
    assert STEP not in events
    state = plant.history.last.belief.filter_state
    assert abs(state.wear[2]) < 0.005
    assert state.wear_std[2] < 0.01
    assert np.exp(state.mean[2, PRODUCTION_LEVEL]) == pytest.approx(plant.friction[2] * (1.0 + by) * np.exp(OFFSET), rel=0.01)
    assert state.sources.unconfirmed[2] == 0.0


def test_a_replay_that_disagrees_with_production_keeps_the_wear_tier_from_being_raised(plant):
    """The work has changed, not the joint: after one replay nothing is asked for, and after a few the wear is gone."""
    for day in range(LEARNT + 20, LEARNT + 32):
        plant.production(day, worn(2, 0.2))
    claimed = plant.history.last.belief.wear[1]
    for day in range(LEARNT + 32, LEARNT + 36):
        plant.replay(day)
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
