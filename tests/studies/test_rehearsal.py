"""A small fleet: how many false alerts there are, and how soon wear is detected. The large fleet is in the soak tests and on the card."""

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy
from synthetic_arm import CONTEXT, START_S, Arm

from monitor.identify.identify import identify
from monitor.judge.drift.step import Replay, initial_state, step
from monitor.judge.friction.figures import found_wear
from monitor.judge.friction.observation import Observation, observe
from monitor.judge.friction.settings import DriftSettings
from monitor.judge.learn import begin, learn
from monitor.judge.settings import AssessSettings
from monitor.model.robot import Mounting, load_robot
from monitor.studies.figures import Rate, Share
from monitor.studies.rehearsal import rehearse as detection
from monitor.studies.rehearsal.fleet import SCENARIOS, WITHIN_SHARE, Fleet, FleetSettings, Wear
from monitor.studies.rehearsal.play import COMPARABLE, play
from monitor.studies.rehearsal.rehearse import Covered, Kind, Reported, delay, detection_row, false_alarms, life, onsets, rehearse

NOTHING = Covered(float("nan"), float("nan"))
ASSESS = AssessSettings()


@pytest.mark.soak
def test_a_healthy_fleet_has_few_alerts():
    """48 robot-years, six of each scenario: at 0.08 a year 4 alerts are expected; 11 or more would come once in 300 times."""
    quiet = play(FleetSettings(arms=48, seed=7), ASSESS)
    assert false_alarms(quiet).events <= 10
    assert np.isfinite(quiet.tier_day[:, :, 1]).sum() <= 1
    assert 0.80 < np.mean(quiet.covered) < 0.98  # 90 %, with 48 arms' luck
    assert np.nanmedian(np.abs(quiet.slope_error_per_k)) < 0.001


@pytest.mark.soak
def test_a_step_of_five_percent_is_detected_within_weeks_in_its_joint():
    """σ = 2 %, ρ = 0.5: the median of 24 arms is below 20 days, two of three within 30, and nine of ten name the right joint."""
    wear = onsets(24, 1, step=0.05, latest=200)
    delays = delay(Reported.of(play(FleetSettings(arms=24, days=240, seed=3, scenarios=COMPARABLE), ASSESS, wear), wear))
    assert delays.median_days < 20
    assert delays.within_30.hits >= 0.67 * delays.arms
    assert delays.right_joint.hits >= 0.9 * delays.right_joint.of


@pytest.mark.soak
def test_wear_is_not_taken_for_noise():
    """60 % a year in one joint of 24 arms: σ of each joint is the fleet's 2 %, to 5 %; and hardly any is believed to wander."""
    wear = Wear(joint=np.arange(24) % 6.0, onset_day=np.full(24, 40.0), step=np.zeros(24), per_day=np.full(24, 0.6 / 365.0))
    played = play(FleetSettings(arms=24, days=160, seed=4, scenarios=("steady", "seasons", "warm_ups")), ASSESS, wear)
    friction, kappa = played.state.friction, ASSESS.friction.noise.column("kappa")
    std = np.sqrt(friction.of_joints((friction.p * friction.scale).sum(axis=0))).reshape(24, 6)
    wanders = friction.of_joints((friction.p * (kappa > 0.0)).sum(axis=0)).reshape(24, 6)
    worn = np.zeros((24, 6), dtype=bool)
    worn[np.arange(24), wear.joint.astype(int)] = True
    assert np.mean(std[worn]) == pytest.approx(0.02, rel=0.05)
    assert np.mean(std[~worn]) == pytest.approx(0.02, rel=0.05)
    assert np.mean(wanders[worn]) < 0.1


@pytest.mark.soak
def test_undetected_changes_widen_the_interval_and_change_no_alert():
    """10 % a year in 24 arms: 90 % intervals of friction hold it until it is detected, where the filter's do not; alerts are the same.

    Over all joints, of which most do not wear, they hold it in 85 to 97 %.
    """
    wear = Wear(joint=np.arange(24) % 6.0, onset_day=np.full(24, 60.0), step=np.zeros(24), per_day=np.full(24, 0.1 / 365.0))
    blind = replace(ASSESS, drift=replace(ASSESS.drift, onsets_per_year=0.0))
    with_mixture, before = (play(FleetSettings(arms=24, days=170, seed=5, scenarios=COMPARABLE), one, wear) for one in (ASSESS, blind))
    assert with_mixture.covered_undetected > max(0.65, before.covered_undetected + 0.2)  # 82 % where wear may begin on any day of a year
    assert 0.85 < np.mean(with_mixture.covered) < 0.97
    assert np.array_equal(with_mixture.tier_day, before.tier_day, equal_nan=True)


def test_the_fleets_filter_is_the_daemons():
    """The same replays of four arms, one arm at a time through the belief and all at once through the step: the same state to rounding."""
    arms = [Arm(seed=seed) for seed in range(4)]
    beliefs: list = [None] * 4
    state = None
    for day in range(40):
        replays = [arm.replay(28.0 + (day % 7), np.array([0, 0, 0.1 * (day >= 25), 0, 0, 0])) for arm in arms]
        for k, seen in enumerate(replays):
            at = START_S + day * 86_400.0
            beliefs[k] = beliefs[k] or begin("ur5", CONTEXT, seen, at, ASSESS)
            beliefs[k] = learn(beliefs[k], seen, CONTEXT, at, settings=ASSESS).belief
        rows = [observe(seen, ASSESS.drift) for seen in replays]
        together = Observation(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))
        state = state or initial_state(together, 6, ASSESS)
        result = step(state, Replay(observation=together, days=np.full(4, float(day > 0))), ASSESS)
        state = result.state

    def of_beliefs(value):
        return np.concatenate([value(belief) for belief in beliefs])

    assert np.allclose(found_wear(state.friction)[0], of_beliefs(lambda belief: belief.wear), atol=1e-9)
    assert np.max(found_wear(state.friction)[0]) > 0.05
    assert np.array_equal(state.reference_temperature_c, of_beliefs(lambda belief: belief.reference_temperature_c))
    assert np.array_equal(result.inside_range, of_beliefs(lambda belief: belief.inside_range) > 0)
    assert np.array_equal(state.first_log_torque, of_beliefs(lambda belief: belief.first_log_torque))
    assert np.allclose(state.viscous.sums, of_beliefs(lambda belief: belief.viscous.sums), rtol=1e-9)


def test_the_same_seed_is_the_same_fleet():
    """Bit for bit, day by day; another seed is another fleet."""
    a, b, c = (Fleet(FleetSettings(arms=4, seed=seed)) for seed in (1, 1, 2))
    for day in range(5):
        one, two, three = (fleet.morning(day).seen.log_torque for fleet in (a, b, c))
        assert np.array_equal(one, two, equal_nan=True)
        assert not np.array_equal(one, three, equal_nan=True)


@pytest.mark.parametrize(("events", "years", "at_most"), [(0, 30.0, 0.0999), (5, 100.0, 0.1051)])
def test_the_bound_of_a_rate_is_garwoods(events, years, at_most):
    """0 events: −ln 0.05 over the time; 5 events: χ²(12)/2 = 10.51."""
    assert Rate(events=events, robot_years=years).at_most == pytest.approx(at_most, abs=1e-4)


def test_the_bounds_of_a_share_are_exact():
    """59 of 59 prove 95 %; none of none proves nothing."""
    assert Share(hits=59, of=59).at_least == pytest.approx(0.05 ** (1 / 59))
    assert Share(hits=0, of=10).at_least == 0.0
    assert np.isnan(Share(hits=0, of=0).value)


def test_thresholds_that_alert_never_or_always_still_give_plain_json():
    """Without any alert the right joint is unknown; where every arm had a false alert, there is no delay. Both are null in the document."""
    wear = onsets(2, 1, step=0.02, latest=62)
    deaf = play(FleetSettings(arms=2, days=63, seed=3, scenarios=COMPARABLE), ASSESS, wear)
    wolf = replace(deaf, tier_day=np.zeros_like(deaf.tier_day))
    for played in (deaf, wolf):
        row = json.loads(json.dumps(detection_row("2 % step", 0.02, 0.0, delay(Reported.of(played, wear)), NOTHING), allow_nan=False))
        assert row["median_days"] is None
        assert row["right_joint"]["share"] is None
        assert row["interval_90"] is None


@pytest.mark.soak
def test_wear_played_in_groups_gives_one_answer(monkeypatch):
    """Groups have other arms with other days; together they are as many arms as were asked for."""
    base, kind = FleetSettings(arms=8, between_std=0.01), Kind("100 %/year", 0.0, 1.0, 8)
    monkeypatch.setattr(detection, "LATEST_ONSET", 62)
    monkeypatch.setattr(detection, "days_to_play", lambda step, per_year: 100)
    whole = detection.detected(base, ASSESS, kind, 3)
    monkeypatch.setattr(detection, "GROUP", 3)
    parted = detection.detected(base, ASSESS, kind, 3)
    assert parted["arms"] == whole["arms"] == 8
    assert parted["within_30_days"]["of"] == 8
    assert parted["median_days"] == pytest.approx(whole["median_days"], abs=8)
    onset = Reported.together([Reported(*(np.arange(3.0) + k for _ in range(4))) for k in (0, 10)]).onset
    assert np.array_equal(onset, [0, 1, 2, 10, 11, 12])


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_the_figures_hold_on_a_thousand_arm_years():
    """One-sided 95 % bounds, as on the performance card; another seed than the card's. Prints the whole document."""
    document = rehearse(ASSESS, arms=1000, seed=77)
    print(json.dumps(document, indent=1))
    alarms = document["false_alarms"]
    assert alarms["all"]["at_most"] <= 0.1
    assert all(alarms[name]["at_most"] <= 0.2 for name in SCENARIOS)
    rows = {row["wear"]: row for row in document["detection"]}
    assert rows["5 % step"]["median_at_most_days"] <= 12
    assert rows["10 %/year"]["median_at_most_days"] <= 110
    assert document["friction_interval_90"]["at_least"] >= 0.85
    assert document["friction_interval_90"]["at_most"] <= 0.95
    for row in document["remaining_life"]["by_path"]:
        assert row["p10_p90_holds"]["at_most"] >= 0.75
        assert row["p10_p90_holds"]["at_least"] <= 0.88
        assert 0.7 <= row["p50_over_truth"] <= 1.4


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_surrogate_is_what_identify_makes_of_full_physics(seed):
    """150 stepped replays each, from 5 to 35 °C, cold and at work: what identify adds to the law is the surrogate's noise within a replay.

    A constant factor of up to 3 % (a line through a concave law), which no drift can come from, is taken off. What is left has the
    surrogate's distribution (Kolmogorov and Smirnov, 1 %), and no course with temperature beyond 0.1 %/K.
    """
    from pathlib import Path

    from monitor.model.fourier import excitation_from_document
    from monitor.simulate.controller.controller import Controller
    from monitor.simulate.settings import SimulateSettings
    from monitor.simulate.stepped import stepped_replay

    text = (Path(__file__).parents[2] / "config/excitation/ur5-ground.json").read_text("utf-8")
    excitation = replace(excitation_from_document(json.loads(text)), repetitions=1)
    controller, robot, rng = Controller(SimulateSettings(seed=seed)), load_robot("ur5"), np.random.default_rng(seed)
    left, grease = [], []
    for _ in range(150):
        controller.pass_time(20.0, rng.uniform(5.0, 35.0), 0.0)
        controller.pass_time(rng.uniform(0.0, 1.0), controller.arm.ambient_c, rng.uniform(0.0, 1.0))
        before = controller.arm.temperatures.grease_c.copy()
        recording = stepped_replay(controller, excitation)
        mean = 0.5 * (before + controller.arm.temperatures.grease_c)
        wear = controller.arm.wear
        load = np.mean(np.abs(recording.target_moment), axis=0)
        law = controller.arm.law.torque(np.full(6, 0.4), load, mean, wear.coulomb, wear.viscous)
        left.append(observe(identify([recording], robot, Mounting()), DriftSettings()).log_torque - np.log(law))
        grease.append(mean)
    left, grease = np.array(left), np.array(grease)
    assert np.all(np.abs(left.mean(axis=0)) < 0.03)
    slopes = [np.polyfit(grease[:, j], left[:, j], 1)[0] for j in range(6)]
    spread = (left - left.mean(axis=0)).std(axis=0)
    within = FleetSettings().within_std * rng.uniform(*WITHIN_SHARE, 3000) * rng.normal(size=3000)
    p = [scipy.stats.kstest((left[:, j] - left[:, j].mean()) / spread[j], within / within.std()).pvalue for j in range(6)]
    print("slopes %/K", np.round(100 * np.array(slopes), 4), "spread %", np.round(100 * spread, 3), "KS p", np.round(p, 3))
    assert np.max(np.abs(slopes)) < 0.001
    assert np.all(spread < 0.009)
    assert np.all(spread > 0.0015)
    assert np.min(p) > 0.01 / 12  # six joints, two seeds


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_remaining_life_is_calibrated_on_every_path():
    """96 arms on a straight path, 48 each on an exponential and a root path; few arms, so the limits are a little wider."""
    found = life(96, ASSESS, seed=5, base=FleetSettings())
    print(json.dumps(found.by_path, indent=1))
    assert 0.7 <= found.interval.value <= 0.95
    for row in found.by_path:
        assert row["p10_p90_holds"]["at_most"] >= 0.72
        assert 0.65 <= row["p50_over_truth"] <= 1.6
