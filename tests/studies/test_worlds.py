"""Each world is what its sentence says, measured on what its fleet hands to the judge; and its verdicts are counted as its text says."""

import json
from functools import cache

import numpy as np
import pytest
from evidence.worlds import world_line
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.judge.alerts.remaining_life import RemainingLife
from monitor.judge.settings import AssessSettings
from monitor.studies.rehearsal.play import Episodes, judged_days
from monitor.studies.rehearsal.rehearse import LifeAnswer, life_documents
from monitor.studies.worlds.fleet import WorldFleet
from monitor.studies.worlds.laws import (
    REFERENCE_RAD_S,
    Correlated,
    Friction,
    Heat,
    bad_days,
    exponential,
    level_jumps,
    modulated,
    payload,
    power,
    power_law,
    running_in,
    sawtooth,
    seasonal_std,
    sensor_shift,
    straight,
    swelling_std,
    telegraph,
    wandering,
    yearly,
)
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import judge_world, play_world, world_document

SHAPE = (1000, 20, 6)
ASSESS = AssessSettings()


def drawn(law, seed=1, shape=SHAPE):
    """A law's draw."""
    return law(np.random.default_rng(seed), shape)


@cache
def fleet(name, days=400):
    """A small fleet of a world, played by nobody yet."""
    return WorldFleet(WORLDS[name], healthy=6, worn=6, days=days, seed=1)


def change_of_log_torque(name, days=1000, at_c=30.0):
    """(A, J) true log friction at one temperature on the last day over that on the first, and the fleet."""
    arms = fleet(name, days)
    temperature = np.full((arms.arms, arms.joints), at_c)
    return arms.log_torque_at(days - 1, temperature) - arms.log_torque_at(0, temperature), arms


@pytest.mark.parametrize(("rho", "degrees"), [(0.0, None), (0.5, None), (0.9, None), (0.5, 3.0)])
def test_correlated_noise_has_its_size_and_its_correlation(rho, degrees):
    """120 joints, 1000 days: σ within 3 %, of t₃ within 10 % (its fourth moment is infinite), ρ within 0.02."""
    x = drawn(Correlated(std=0.02, rho=rho, degrees=degrees))
    assert x.std() == pytest.approx(0.02, rel=0.03 if degrees is None else 0.10)
    assert np.mean(x[1:] * x[:-1]) / np.mean(x * x) == pytest.approx(rho, abs=0.02)


def test_noise_may_be_shared_by_the_joints_of_an_arm_and_differ_in_its_correlation():
    """Half of the variance in common is a correlation of a half between joints; ρ between 0 and 0.9 from joint to joint."""
    shared = fleet("noise-shared", 1000)._noise
    between = np.corrcoef(shared[:, 0].T)[np.triu_indices(6, 1)]
    assert between.mean() == pytest.approx(0.5, abs=0.12)
    x = drawn(Correlated(std=0.02, rho=(0.0, 0.9)))
    rho = np.mean(x[1:] * x[:-1], axis=0) / np.mean(x * x, axis=0)
    assert rho.min() < 0.12
    assert rho.max() > 0.8
    assert x.std() == pytest.approx(0.02, rel=0.05)


def test_students_noise_has_students_tails():
    """White t₃ scaled to unit variance exceeds 5 σ in 0.32 % of replays; Gaussian noise never does here."""
    far = [np.mean(np.abs(drawn(Correlated(std=1.0, rho=0.0, degrees=each))) > 5.0) for each in (3.0, None)]
    assert far[0] == pytest.approx(0.0032, rel=0.15)
    assert far[1] == 0.0


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_spectrum_of_power_law_noise_falls_as_named(exponent):
    """The slope of the averaged periodogram between 1/500 and 1/10 a day, and σ about the mean over three years."""
    x = drawn(power_law(std=0.02, exponent=exponent), shape=(1095, 40, 6))
    window = np.hanning(1095)[:, None, None]  # against leakage of what is slower than the window
    power = np.mean(np.abs(np.fft.rfft((x - x.mean(axis=0)) * window, axis=0)) ** 2, axis=(1, 2))
    f = np.fft.rfftfreq(1095)
    band = (f > 1 / 500) & (f < 1 / 10)
    assert np.polyfit(np.log(f[band]), np.log(power[band]), 1)[0] == pytest.approx(-exponent, abs=0.1)
    assert np.sqrt(np.mean(x.var(axis=0))) == pytest.approx(0.02, rel=0.06)


def test_seasonal_noise_is_largest_half_a_year_from_where_it_is_smallest():
    """Winter 4 %, summer 1 %: each joint's σ over windows of 30 days swings between them once a year."""
    x = drawn(modulated(seasonal_std(0.04, 0.01), rho=0.0), shape=(730, 30, 6))
    std = x.reshape(-1, 10, 30, 6).std(axis=(1, 3))  # of each arm over ten days and its six joints
    assert np.quantile(std, 0.97) == pytest.approx(0.04, rel=0.15)
    assert np.quantile(std, 0.03) == pytest.approx(0.01, rel=0.25)
    year = np.arange(73) * 10.0 / 365.0 * 2.0 * np.pi
    swing = np.abs(np.exp(-1j * year) @ std) / len(year) * 2.0
    assert swing.mean() == pytest.approx(0.015, rel=0.05)


def test_noise_that_swells_is_each_joint_s_own_and_keeps_its_size_over_years():
    """A factor of two either way about 2 %, within a month: joints of an arm have nothing to do with each other."""
    size = swelling_std(0.02, 30.0, 0.6)(np.random.default_rng(4), (3000, 20, 6))
    log = np.log(size) - np.log(size).mean(axis=0)
    assert np.sqrt(np.mean(size**2)) == pytest.approx(0.02, rel=0.05)
    assert log.std() == pytest.approx(0.6, rel=0.05)
    assert np.mean(log[30:] * log[:-30]) == pytest.approx(0.36 / np.e, rel=0.15)
    assert abs(np.mean(log[:, :, 0] * log[:, :, 1])) < 0.03


def test_mixed_noise_differs_from_joint_to_joint():
    """σ between 0.5 and 5 %, a decade apart."""
    std = drawn(Correlated(std=(0.005, 0.05))).std(axis=0)
    assert 0.0045 < std.min() < 0.007
    assert 0.035 < std.max() < 0.056


def test_running_in_falls_by_its_share_and_then_stays():
    """5–10 % in the first months: nothing moves by more than 0.1 % in the third year."""
    log = drawn(running_in()).dry
    assert np.all((np.exp(log[-1]) >= 0.90) & (np.exp(log[-1]) <= 0.95))
    assert np.all(np.diff(log, axis=0) <= 0.0)
    assert np.all(np.abs(log[730] - log[-1]) < 0.001)


@given(common=st.booleans(), seed=st.integers(0, 99))
@settings(max_examples=10)
def test_a_year_that_is_not_temperature_has_its_size(common, seed):
    """A swing of about ±2 % with the period of a year, of all joints of an arm or of each joint."""
    log = yearly(amplitude=0.02, common=common)(np.random.default_rng(seed), (730, 20, 6)).dry
    assert log.shape == (730, 20, 1 if common else 6)
    assert np.median(np.ptp(log, axis=0) / 2.0) == pytest.approx(0.02, rel=0.25)
    assert np.allclose(log[:365], log[365:], atol=1e-12)


def test_a_walk_begins_at_nothing():
    """So that it is a change since the first replay."""
    log = drawn(wandering(std=0.02, common=False)).dry
    assert np.all(log[0] == 0.0)
    assert log[500:].std() == pytest.approx(0.02 * np.sqrt(2.0), rel=0.15)  # of the difference to the first day


def test_a_payload_is_felt_at_shoulder_and_elbow():
    """One or two per cent of friction there, less in the wrists, and away again after its time."""
    felt = drawn(payload(kept_days=30.0)).dry
    rise = felt.max(axis=0)
    assert np.all(rise[:, [1, 2]] > 2.0 * rise[:, [3, 4, 5]].max(axis=1, keepdims=True))
    assert np.all((felt > 0).all(axis=2).sum(axis=0) == 30)


def test_the_friction_law_is_none_of_the_monitors():
    """Its torque rises with speed less than in proportion, falls with temperature, and its line through a replay misses it by per cents."""
    law = Friction.drawn(np.random.default_rng(1), 50)
    T = np.full((50, 6), 30.0)
    slow, here, fast = (law.torque(v, T) for v in (0.1, REFERENCE_RAD_S, 1.0))
    assert np.all(fast - here < (here - slow) * 2.0)
    per_k = np.log(law.torque(REFERENCE_RAD_S, T + 1.0) / here)
    assert np.all((per_k < -0.003) & (per_k > -0.015))
    intercept, slope = law.line(T, 1.0, 1.0)
    missed = np.log((intercept + slope * 0.1) / slow)
    assert 0.01 < np.mean(np.abs(missed)) < 0.15


def test_the_grease_follows_the_motor():
    """Equal at the start and long after it, behind it between; a lag of 20 min holds it back by kelvins."""
    rng = np.random.default_rng(1)
    at = {}
    for minutes in (0.01, 30.0, 600.0):
        heat = Heat(lag_min=(20.0, 20.0), started_min=(minutes, minutes)).at_replays(rng, (50, 10, 6))
        at[minutes] = np.mean(heat.motor_c - heat.grease_c)
    assert at[0.01] == pytest.approx(0.0, abs=0.01)
    assert at[600.0] == pytest.approx(0.0, abs=0.01)
    assert 0.5 < at[30.0] < 4.0


def test_summer_is_24_kelvins_warmer_where_a_world_says_so():
    """From the coldest days of the first winter to the following summer, with weather and Mondays."""
    motor = fleet("summer-24").heat.motor_c.mean(axis=(1, 2))
    assert motor[180:215].mean() - motor[:30].mean() == pytest.approx(24.0, abs=1.5)
    assert WORLDS["summer-24"].heat.coldest_day == 15.0


def test_low_speed_wear_hardly_moves_the_reference_torque():
    """Within ±3 % at 0.4 rad/s, while fc rises and fv falls."""
    change, arms = change_of_log_torque("low-speed-wear")
    assert np.all(np.abs(change[arms.worn]) < 0.03)
    assert np.all(change[~arms.worn] == 0.0)
    first, last = arms.morning(0).seen, arms.morning(999).seen
    worn = arms.worn.ravel()
    assert np.mean(np.log(last.coulomb_nm / first.coulomb_nm)[worn]) > 0.03
    assert np.mean(np.log(last.viscous_nm_s_per_rad / first.viscous_nm_s_per_rad)[worn]) < -0.1
    assert np.mean((last.log_torque_slow - last.log_torque_fast - first.log_torque_slow + first.log_torque_fast)[worn]) > 0.08


def test_local_wear_doubles_what_the_fit_leaves():
    """The residual's RMS doubles within its scatter, friction rises by 2 %."""
    change, arms = change_of_log_torque("local-wear")
    assert np.all(np.abs(change[arms.worn] - 0.02) < 0.002)
    residual = [np.log(arms.morning(day).seen.residual_rms_nm.reshape(arms.arms, 6)[arms.worn]) for day in (0, 10, 20, 970, 980, 990)]
    assert np.mean(np.nanmean(residual[3:], axis=0) - np.nanmean(residual[:3], axis=0)) == pytest.approx(np.log(2.0), abs=0.1)


def test_a_scale_of_current_changes_everything_at_once_but_nothing_beside():
    """+3 % in every joint, for good, from one day on; of wear there is none in healthy arms."""
    change, arms = change_of_log_torque("all-joints-3")
    assert np.allclose(change[arms.group < 0], np.log(1.03))


def test_wear_is_put_into_the_joints_that_are_named():
    """One of each arm, two, or all; healthy arms have none; nothing before the onset."""
    for name, joints in (("plain", 1), ("two-joints", 2), ("all-six", 6)):
        change, arms = change_of_log_torque(name)
        assert np.all(arms.worn.sum(axis=1) == np.where(arms.group < 0, 0, joints))
        assert np.array_equal(change > 0.01, arms.worn)
        assert np.all(arms.onset_day[arms.group >= 0] >= 60)


def test_paths_reach_the_limit_at_the_end_of_life():
    """Straight, exponential and √t: +30 % after one life, and at half of it 15, 6 and 21 %; lives are as long as the world says."""
    paths = (straight(0.30), exponential(0.30), power(0.30, 0.5))
    assert [float(path(np.array(1.0))) for path in paths] == pytest.approx([0.30, 0.30, 0.30])
    assert [float(path(np.array(0.5))) for path in paths] == pytest.approx([0.15, 0.06, 0.212], abs=0.001)
    arms = fleet("paths")
    lives = arms.unit_days[arms.group >= 0]
    assert np.all((lives >= 365.0) & (lives <= 2.5 * 365.0))
    assert np.ptp(lives) > 100.0


def test_gaps_are_whole_weeks():
    """Where a world has gaps of three weeks, silences of 21 days and more occur, elsewhere none."""
    for name, gaps in (("missing-weeks", True), ("plain", False)):
        here = fleet(name, 1000)
        replayed = np.array([here.morning(day).replayed for day in range(1000)])
        longest = max(np.diff(np.flatnonzero(row)).max() for row in replayed.T)
        assert (longest > 21) == gaps


@pytest.mark.parametrize("name", sorted(WORLDS))
def test_a_world_is_its_seed(name):
    """Every world of the table hands complete observations to the judge; the same seed is the same world, another one is another."""
    one, two, three = (WorldFleet(WORLDS[name], healthy=1, worn=1, days=80, seed=seed).morning(70).seen for seed in (4, 4, 5))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a, b, equal_nan=True)
    assert not np.array_equal(one.log_torque, three.log_torque, equal_nan=True)
    assert np.all(np.isfinite(one.coulomb_nm) & (one.variance > 0) & (one.coulomb_nm > 0) & (one.viscous_nm_s_per_rad > 0))


def test_an_episode_ends_after_thirty_days_without():
    """On for a day, away for 29 days, on again: one episode; away for 30: another one. What began while learning is none."""
    episodes = Episodes(3)
    for day in range(200):
        on = np.array([day in (70, 100, 131), day < 100, day == 65])
        episodes.add(day, on, 60)
    assert episodes.count.tolist() == [2, 0, 1]
    assert episodes.first[[0, 2]].tolist() == [70, 65]


@cache
def judged(name):
    """A document of six healthy arms, and of three with each kind of wear."""
    return json.loads(json.dumps(play_world(WORLDS[name], ASSESS, arms=6, days=480, seed=2), allow_nan=False))


@pytest.mark.soak
def test_a_plain_world_is_judged_and_its_document_is_plain_json():
    """Steps are found, in their joints; every figure is JSON."""
    document = judged("plain")
    step, rate = document["detection"]
    assert step["arms"] + step["raised_before"] == 3
    assert step["median_days"] < 40
    assert rate["never"]["of"] == rate["arms"]
    assert document["robot_years"] == pytest.approx(6 * 420 / 365)
    assert document["false_advisories"]["counted"]["events"] <= 4
    assert 0.7 < document["interval_90"]["healthy"] <= 1.0
    assert world_line(document).startswith("plain")


@pytest.mark.soak
def test_false_advisories_are_counted_apart_by_the_arms_age():
    """The parts of life follow on each other without a gap, and hold every advisory of friction that is counted, once."""
    document = judged("plain")
    false, parts = document["false_advisories"], document["false_advisories"]["by_life"]
    assert [(part["from_day"], part["to_day"]) for part in parts] == [(60, 120), (120, 425), (425, 480)]
    assert sum(part["events"] for part in parts) == sum(false[kind]["events"] for kind in false["counted"]["kinds"])
    assert sum(part["robot_years"] for part in parts) == pytest.approx(document["robot_years"])
    assert all(f"day {part['from_day']:.0f}–{part['to_day']:.0f} " in world_line(document) for part in parts)


def test_healthy_joints_jump_go_back_and_forth_and_cycle_as_their_worlds_say():
    """Jumps are rare and common; a telegraph has two levels; a sawtooth rises far longer than it falls; a sensor shifts in one joint."""
    jumps = np.diff(drawn(level_jumps()).dry, axis=0)
    assert np.mean(jumps != 0.0) == pytest.approx(3.0 / 365.0, rel=0.3)
    assert jumps.shape[2] == 1
    off = drawn(bad_days(a_year=3.0)).dry
    assert np.all((off == 0.0) | (np.abs(np.expm1(off)) >= 0.05))
    assert np.abs(np.expm1(off)).max() <= 0.4
    assert 0.01 <= (off != 0.0).any(axis=2).mean() <= 0.05
    levels = drawn(telegraph()).dry
    assert np.unique(levels).tolist() == [-0.015, 0.015]
    assert np.mean(np.diff(levels, axis=0) != 0.0) == pytest.approx(1.0 / 20.0, rel=0.1)
    tooth = np.diff(drawn(sawtooth()).dry, axis=0)
    assert np.mean(tooth > 0.0) == pytest.approx(0.88, abs=0.03)
    shifted = drawn(sensor_shift()).sensor_k
    assert np.all(shifted[0] == 0.0)
    assert np.all((shifted[-1] == 2.0).sum(axis=1) == 1)


@pytest.mark.soak
def test_an_undeclared_payload_is_told_as_a_payload_and_its_declaration_opens_a_context():
    """Every arm's weights contradict from the day on which 0.3 kg are mounted until they are declared, and on no other day."""
    arms = WorldFleet(WORLDS["payload-03"], healthy=4, worn=0, days=560, seed=3)
    seen = [judged.undeclared & judged.now.replayed for judged in judged_days(arms, arms.days, ASSESS, count_use=False)]
    assert np.array_equal(np.array(seen), arms.undeclared & arms._replayed)
    assert arms.undeclared.any(axis=0).all()
    assert np.array_equal(arms._opened.sum(axis=0), np.ones(4))
    assert np.all((arms._slot == 1)[-1])


def said(days):
    """A prediction whose P10 and P90 are ten per cent off its P50; None: no date."""
    return RemainingLife(1.0, None if days is None else 0.9 * days, days, None if days is None else 1.1 * days, "trend")


def test_an_advisory_of_the_worn_joint_before_the_onset_is_no_detection():
    """Where every worn joint was raised before, nothing is left to detect: counts, and null for figures."""
    healthy = judge_world(WorldFleet(WORLDS["plain"], healthy=2, worn=0, days=80, seed=2), ASSESS)
    worn = judge_world(WorldFleet(WORLDS["plain"], healthy=0, worn=2, days=80, seed=2), ASSESS)
    worn.before[:] = True
    row = world_document(healthy, worn)["detection"][0]
    assert row["arms"] == 0
    assert row["raised_before"] == 2
    assert row["median_days"] is None
    assert row["remaining_life"] == []


def test_remaining_life_is_asked_at_half_and_at_three_quarters():
    """Exact predictions hold and are near; one that is twice the truth is not near; no date is counted as such."""
    answers = [LifeAnswer(0, 0.5, said(days), 100.0) for days in (100.0, 200.0, None)] + [LifeAnswer(0, 0.75, said(100.0), 100.0)]
    half, late = life_documents(answers)
    assert half["p10_p90_holds"]["hits"] == 1
    assert half["p10_p90_holds"]["of"] == 2
    assert half["p50_near"]["of"] == 3
    assert half["p50_over_truth"] == pytest.approx(1.5)
    assert half["without_date"] == 1
    assert late["at_share_of_life"] == 0.75
