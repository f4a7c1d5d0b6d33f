"""The slow track of gear ripple: it follows, it begins anew with another context, and it is stored with the belief."""

import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, Arm

from monitor.identify.signals.ripple import Ripple
from monitor.judge.assess import judge_identification
from monitor.judge.belief import belief_from_document
from monitor.judge.document import plain
from monitor.judge.drift.ripple_track import joint_ripple, update_ripple
from monitor.judge.production import assess_production
from monitor.judge.production_observation import ProductionObservation
from monitor.judge.settings import AssessSettings
from monitor.publish.documents import Friction

SETTINGS = AssessSettings()
CYCLES = np.tile([101.0, 202.0, 404.0], (6, 1))


def ripple(level_a: float, seed: int = 0, std_a: float = 0.002) -> Ripple:
    """One replay's ripple of the first order, of this size; the other orders were not seen."""
    amplitude = np.full((6, 3), np.nan)
    amplitude[:, 0] = level_a + std_a * np.random.default_rng(seed).normal(size=6)
    return Ripple(CYCLES, amplitude, np.where(np.isfinite(amplitude), std_a, np.nan), ((None, "too slow", "too slow"),) * 6, CYCLES)


def tracked(levels: list[float], days: float = 1.0):
    track = None
    for k, level in enumerate(levels):
        track = update_ripple(track, ripple(level, seed=k), days, fresh=False)
    return track


def test_the_track_is_surer_than_one_replay_and_follows_a_change():
    """Twenty of 30 mA, then of 45 mA: surer than one alone, and near the new level; the first replays are kept."""
    before, after = tracked([0.030] * 20), tracked([0.030] * 20 + [0.045] * 20)
    alone = np.hypot(0.002, 0.1 * 0.030)
    assert np.all(np.sqrt(before.track_var[:, 0]) < 0.6 * alone)
    assert np.all(np.abs(before.track_a[:, 0] - 0.030) < 3.0 * np.sqrt(before.track_var[:, 0]))
    assert np.all(after.track_a[:, 0] > 0.038)
    assert after.first_a[:, 0] == pytest.approx(np.full(6, 0.030), abs=0.003)
    assert np.all(np.isnan(after.track_a[:, 1:]))
    assert joint_ripple(after)[2].replays == (40, 0, 0)


def test_a_joint_whose_gear_ratio_nobody_knows_leaves_the_others_their_track():
    """Its cycles a turn are no number, in every replay alike: the motors are the same."""
    cycles, track = CYCLES.copy(), None
    cycles[3] = np.nan
    for day in range(3):
        track = update_ripple(track, ripple(0.030, seed=day)._replace(cycles_per_turn=cycles), 1.0, fresh=False)
    assert track.replays[0, 0] == 3


def test_silence_makes_the_track_less_sure_and_a_replay_without_current_changes_nothing():
    """A year without a replay; and a recording of torque alone."""
    track = tracked([0.030] * 10)
    later = update_ripple(track, ripple(0.030, seed=99), 365.0, fresh=False)
    assert np.all(later.track_var[:, 0] > track.track_var[:, 0])
    assert update_ripple(track, None, 1.0, fresh=False) is track


def judged(belief, day: int, level_a: float, context=CONTEXT):
    identification = replace(Arm(seed=day).replay(25.0), ripple=ripple(level_a, seed=day))
    context = replace(context, recorded_at_unix_s=(100 + day) * DAY_S)
    return judge_identification(identification, context, belief=belief, health=None)


def test_ripple_is_published_stored_and_continued():
    """Through JSON and back the next verdict is the same; the published document of a joint holds last replay, track and beginning."""
    first = judged(None, 0, 0.030)
    second = judged(first.belief, 1, 0.032)
    read = belief_from_document(json.loads(json.dumps(second.belief.as_document(), allow_nan=False)))
    there, straight = (judged(belief, 2, 0.031) for belief in (read, second.belief))
    assert json.dumps(there.belief.as_document()) == json.dumps(straight.belief.as_document())
    published = Friction.model_validate(plain(there.friction[3])).ripple
    assert published.cycles_per_turn == [101, 202, 404]
    assert published.track_a[0] == pytest.approx(0.031, abs=0.004)
    assert published.track_a[1] is None
    assert published.replays == [3, 0, 0]


def test_the_track_walks_from_replay_to_replay_whatever_production_told_between():
    """Thirty days without a replay make it as unsure with a period of work just before the next one as without."""
    belief = None
    for day in range(5):
        belief = (known := judged(belief, day, 0.030)).belief
    at, torque, unknown = (100 + 34) * DAY_S - 7200.0, belief.reference_torque_nm(SETTINGS.friction)[0], np.full(6, np.nan)
    seen = ProductionObservation(
        begin_unix_s=at - 3600.0, end_unix_s=at, reference_speed_rad_s=0.4, friction_nm=torque, deviation_nm=0.05 * torque,
        noise_nm=0.005 * torque, temperature_c=np.full(6, 25.0), share=unknown, known=np.ones(6),
    )  # fmt: skip
    told = assess_production(seen, CONTEXT, belief=belief, health=known.health, settings=SETTINGS).belief
    assert told.at_unix_s == at
    alone, after_production = (judged(each, 34, 0.030).belief.ripple for each in (belief, told))
    assert after_production.track_var[:, 0] == pytest.approx(alone.track_var[:, 0], rel=1e-6)


def test_a_threefold_ripple_raises_no_alert():
    """It is evidence: state, alerts and wear are those of an arm without it."""
    belief = belief_plain = None
    for day in range(12):
        belief = (with_ripple := judged(belief, day, 0.030 if day < 6 else 0.090)).belief
        identification = replace(Arm(seed=day).replay(25.0), ripple=None)
        context = replace(CONTEXT, recorded_at_unix_s=(100 + day) * DAY_S)
        belief_plain = (without := judge_identification(identification, context, belief=belief_plain, health=None)).belief
    assert with_ripple.health == without.health
    assert np.array_equal(with_ripple.belief.wear, without.belief.wear)
    assert without.friction[0].ripple is None


def test_another_context_begins_anew():
    """Another payload loads the gear otherwise: its track has one replay."""
    belief = None
    for day in range(3):
        belief = judged(belief, day, 0.030).belief
    loaded = judged(belief, 3, 0.060, replace(CONTEXT, payload_kg=3.0))
    assert loaded.friction[0].ripple.replays == (1, 0, 0)
    assert loaded.friction[0].ripple.first_a[0] == pytest.approx(0.060, abs=0.01)
