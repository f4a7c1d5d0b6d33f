"""Undeclared changes of payload, mounting or drive gains are detected as such, and never as wear."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_arm import CONTEXT, Arm, History

from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.judge.alerts.life_cycle import acknowledge
from monitor.judge.assess import assess
from monitor.judge.assessment import Assessment
from monitor.judge.belief import belief_from_document
from monitor.judge.drift.undeclared import (
    GAINS,
    PAYLOAD,
    RigidFit,
    Weights,
    compare_weights,
    rigid_fit,
    rigid_of,
    update_mass_estimate,
    weigh,
)
from monitor.judge.learn import enter_declared_context, enter_undeclared_level
from monitor.judge.settings import AssessSettings, HealthSettings
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.reason import Reason
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.studies.worlds.laws import STD

UR5 = load_robot("ur5")
LIMITS = HealthSettings()
ROOT = Path(__file__).parents[2]


def carrying(seen: Identification, mass_kg: float, gain: float = 1.0) -> Identification:
    """The same arm with a mass 5 cm in front of its flange and with other drive gains; noise on the rigid parameters as after identify."""
    standard = np.zeros(seen.combination.shape[1])
    standard[65], standard[68] = mass_kg, 0.05 * mass_kg
    rigid = rigid_of(seen)
    values = seen.values + seen.combination @ standard
    rng = np.random.default_rng(int(1e3 * seen.coulomb_nm[0]))
    return replace(seen, values=np.where(rigid, gain * values, values) + 1e-3 * rigid * rng.normal(size=len(values)))


def lived(days: int, **changed: float) -> History:
    history, arm = History(), Arm(seed=1)
    for day in range(days):
        history.add(day, carrying(arm.replay(30.0), **{"mass_kg": 0.0}))
    for day in range(days, days + 3):
        # a payload raises the friction of loaded joints: what would look like wear
        history.add(day, carrying(arm.replay(30.0, np.array([0, 0.12, 0.15, 0, 0, 0])), **{"mass_kg": 0.0, **changed}))
    return history


def test_an_undeclared_payload_is_named_and_is_no_wear():
    """An undeclared 2.5 kg: CHECK_FUNCTION after the first such replay, an alert after the second, and no wear is learnt meanwhile."""
    history = lived(20, mass_kg=2.5)
    assert history.health.state == "CHECK_FUNCTION"
    assert [(day, joint, condition) for day, _, joint, condition, _ in history.transitions] == [(21, None, "payload_contradiction")]
    [alert] = history.health.active_alerts
    assert "about 2.5 kg more" in alert.text.text
    assert np.all(np.abs(history.last.belief.wear) < 0.01)
    assert history.last.belief.learnt_replays[1] == 20  # nothing learnt of the three


def test_a_gain_that_changed_is_named_and_is_no_wear():
    """All weights are 10 % larger, which no mass at the flange explains."""
    history = lived(20, gain=1.1)
    assert {condition for _, _, _, condition, _ in history.transitions} == {"gain_contradiction"}
    assert np.all(np.abs(history.last.belief.wear) < 0.01)


def weighed(rng: np.random.Generator, kg: float = 0.0, gain: float = 1.0) -> RigidFit:
    """The weights of a UR5 as precisely as a replay of 30 s determines them."""
    fit = rigid_fit(carrying(Arm(seed=1).replay(30.0), 0.0))
    values = gain * (fit.values + fit.of_mass @ (kg * np.array([1.0, 0.01, -0.01, 0.05])))
    return fit._replace(values=values + STD * rng.normal(size=len(STD)), covariance=np.diag(STD**2))


def found(replays: int, **changed: float) -> list[str | None]:
    """What each of 40 replays after so many ordinary ones contradicts."""
    rng, estimate = np.random.default_rng(5), None
    for _ in range(replays):
        estimate = update_mass_estimate(estimate, weighed(rng))
    limits = {"sigma": LIMITS.contradiction_sigma, "mass_kg": LIMITS.contradiction_kg}
    return [compare_weights(weighed(rng, **changed), estimate, **limits).condition for _ in range(40)]


@pytest.mark.parametrize("kg", [0.3, -0.3, 1.0])
@pytest.mark.parametrize("replays", [5, 60])
def test_a_few_hundred_grams_are_told_as_a_payload(kg, replays):
    """A replay determines a mass at the flange of a UR5 within 0.03 kg: 0.3 kg is seen in every replay."""
    assert set(found(replays, kg=kg)) == {PAYLOAD}


@pytest.mark.parametrize("changed", [{}, {"kg": 0.1}, {"gain": 1.03}, {"gain": 0.96}, {"gain": 1.08}])
@pytest.mark.slow
def test_drive_gains_and_trifles_are_no_payload(changed):
    """Magnets weaken by a tenth of a per cent a kelvin, so weights seem to vary by some per cent; a cable weighs a tenth of a kilogram."""
    assert PAYLOAD not in found(30, **changed)
    assert GAINS not in found(30, **changed)


@pytest.mark.soak
def test_the_full_physics_tell_a_payload_of_three_hundred_grams():
    """Replays of the simulated arm at changing temperatures: nothing contradicts until 0.3 kg are mounted, then every replay does.

    What replays say of the weights scatters as the worlds' surrogate has it, within half of it either way.
    """
    excitation = excitation_from_document(json.loads((ROOT / "config/excitation/ur5-ground.json").read_text("utf-8")))
    controller, rng = Controller(SimulateSettings(robot="ur5", seed=7)), np.random.default_rng(7)
    last, conditions, variances = None, [], []
    for day in range(9):
        if day == 6:
            controller.arm.carry(payload_kg=0.3, declared=False)
        controller.pass_time(20.0, rng.uniform(5.0, 32.0), 0.0)
        recording = stepped_replay(controller, excitation)
        context = replace(recording.context, recorded_at_unix_s=1.75e9 + day * 86_400.0, payload_kg=0.0)
        last = assess(
            replace(recording, context=context),
            robot=UR5,
            mounting=Mounting(),
            belief=last.belief if last else None,
            health=last.health if last else None,
            settings=AssessSettings(),
            model=last.model if last else None,
        )
        assert isinstance(last, Assessment)
        conditions.append([warning.code for warning in last.warnings if "contradiction" in warning.code])
        variances.append(rigid_fit(last.identification).variance)
    assert conditions == [[]] * 6 + [[PAYLOAD]] * 3
    ratio = np.sqrt(np.mean(variances, axis=0)) / STD
    assert np.all((ratio > 0.5) & (ratio < 1.5))


def test_a_mounting_that_contradicts_gravity_is_no_wear():
    """The warning of identify about gravity counts at once."""
    history, arm = History(), Arm(seed=1)
    for day in range(12):
        seen = arm.replay(30.0, 0.0 if day < 9 else 0.2)
        history.add(day, replace(seen, warnings=(Reason("mounting_contradiction", {}, "gravity is 90° off"),)) if day >= 9 else seen)
    assert {condition for _, _, _, condition, _ in history.transitions} == {"mounting_contradiction"}
    assert history.health.state == "CHECK_FUNCTION"


def test_wear_and_quiet_replays_contradict_nothing():
    """Friction that rises by 20 % changes no weight: no undeclared change in 40 replays, and the wear is reported."""
    history, arm = History(), Arm(seed=1)
    for day in range(40):
        history.add(day, carrying(arm.replay(30.0, np.array([0, 0, 0.2 * (day > 25), 0, 0, 0])), 0.0))
    assert {(joint, condition) for _, _, joint, condition, _ in history.transitions} == {(3, "sudden_step")}


@pytest.mark.parametrize(
    ("payload", "blind"), [("declared", False), ("undeclared", False), pytest.param("undeclared", True, marks=pytest.mark.soak)]
)
@pytest.mark.slow
def test_ur10e_recordings_raise_no_wear_alert(real_data, tmp_path, monkeypatch, payload, blind):
    """Real recordings in time order. The last carries about 2.6 kg: declared it opens a context, undeclared it is detected.

    They have no temperature. Without temperatures wear cannot be judged, and an alert reports only this. With a constant temperature
    there is no wear alert either.
    """
    from monitor.store.formats.recordings import read_recording
    from monitor.store.from_files import series
    from monitor.store.from_files.series import Series, assess_series, manifest

    def warm(path: object, columns: str, rate_hz: float | None) -> object:
        recording = read_recording(path, columns, rate_hz)
        return replace(recording, temperature_c=np.full((recording.samples, 6), 30.0))

    monkeypatch.setattr(series, "read_recording", read_recording if blind else warm)
    names = {
        "ur-20_02_10-30sec_12harm": 10,
        "ur-20_02_12-50sec_12harm": 12,
        "ur-20_02_19_14harm50sec": 19,
        "ur-20_02_19_14harm50secLoad": 20,
    }
    rows = [
        f"{real_data / 'ur10e' / name}.csv,2020-02-{day}T12:00:00Z,{2.6 if 'Load' in name and payload == 'declared' else 0}"
        for name, day in names.items()
    ]
    listed = tmp_path / "runs.csv"
    listed.write_text("\n".join(["file,recorded_at,payload_kg", *rows]), "utf-8")
    gains = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])
    columns = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
    document = assess_series(Series(entries=manifest(listed), robot=load_robot("ur10e"), columns=columns, gains=gains))
    assert [(alert["joint"], alert["condition"]) for alert in document["alerts"]] == [(None, "temperature_sensor")] * blind
    seen = "payload_contradiction" in {warning["code"] for warning in document["warnings"]}
    assert seen == (payload == "undeclared")
    assert document["health"]["arm"] == ("CHECK_FUNCTION" if seen else "NORMAL")
    assert len(document["contexts"]) == (3 if seen else 4)  # three motions, and the last of them with a declared load


def forgotten(days: int, history: History | None = None, *, first: int = 0, kg: float = 0.0, **more: object) -> History:
    """So many more days with a mass at the flange that raises the friction of shoulder and elbow."""
    history = history or History()
    wear = np.asarray(more.get("wear", 0.0)) + np.array([0, 0.024, 0.02, 0, 0, 0]) * (kg > 0)
    arm = Arm(seed=3 + first, noise=0.01)
    for day in range(first, first + days):
        history.add(day, carrying(arm.replay(30.0, wear), kg), replace(CONTEXT, payload_kg=more.get("declared_kg", 0.0)))
    return history


@pytest.fixture(scope="module")
def with_level() -> History:
    """Half a kilogram since day 15, which nobody has declared until day 40."""
    return forgotten(26, forgotten(15), first=15, kg=0.5)


def again(history: History) -> History:
    """A history that goes on from a belief that was stored and read."""
    copied = History()
    copied.last = replace(history.last, belief=belief_from_document(json.loads(json.dumps(history.last.belief.as_document()))))
    copied.health = history.health
    return copied


def test_a_payload_that_nobody_declares_gets_a_level_of_its_own(with_level):
    """After 20 replays that weigh the same, wear is learnt again, against another level; the alert stands and says so."""
    belief = with_level.last.belief
    assert [(o.undeclared, o.replays, o.slot) for o in belief.contexts] == [(False, 15 + 19, 0), (True, 7, 1)]
    assert np.all(belief.learnt_replays == 15 + 7)
    assert np.all(np.abs(belief.wear) < 0.01)
    assert [(day, kind, condition) for day, kind, _, condition, _ in with_level.transitions] == [
        (16, "raised", "payload_contradiction"),
        (34, "updated", "payload_contradiction"),
    ]
    [alert] = with_level.health.active_alerts
    told = "payload_kg says 0.0 kg, and it weighs about 0.5 kg; wear is judged against a level of its own since 2025-07-20"
    assert alert.text.text.endswith(told)
    assert with_level.health.state == "CHECK_FUNCTION"
    assert {joint.state for joint in with_level.health.joints} == {"NORMAL"}


@pytest.mark.slow
def test_shoulder_and_elbow_that_wear_alike_are_told_where_the_weights_are_as_before():
    """Both rise by 6 % at one replay, as with a payload; the weights say that there is none, and both are told within 25 days."""
    history = History()
    for day in range(85):
        wear = np.array([0, 0.06, 0.06, 0, 0, 0]) * (day >= 60)
        history.add(day, carrying(Arm(seed=day, noise=0.015).replay(30.0, wear), 0.0))
    assert {joint for _, event, joint, _, _ in history.transitions if event == "raised"} == {2, 3}


def test_wear_beside_a_payload_that_nobody_declares_is_found(with_level):
    """A rise of 10 % in joint 3 after that is the joint's, within two weeks; what was stored is read."""
    history = forgotten(14, again(with_level), first=41, kg=0.5, wear=np.array([0, 0, 0.1, 0, 0, 0]))
    assert set(history.first()) == {3}


def test_a_payload_that_is_taken_off_again_leaves_the_old_level(with_level):
    """Weights as before: the level from before is in force, and an alert that was acknowledged clears."""
    history = again(with_level)
    history.health = acknowledge(history.health, None, PAYLOAD, by="Ada", why="a camera", at_unix_s=history.last.recorded_at_unix_s)
    history = forgotten(3, history, first=41)
    assert [(day, kind) for day, kind, _, condition, _ in history.transitions if condition == PAYLOAD] == [(41, "cleared")]
    belief = history.last.belief
    assert not belief.contexts[-1].undeclared
    assert belief.contexts[-1].slot == 0
    assert np.all(np.abs(belief.wear) < 0.01)
    back = forgotten(1, history, first=44, kg=0.5).last.belief
    assert (back.contexts[-1].undeclared, back.contexts[-1].slot) == (True, 1)  # the level is known from before


def test_a_payload_that_is_declared_at_last_keeps_what_was_learnt(with_level):
    """The declared payload weighs what the arm did before: its level is the same, and nothing is learnt anew."""
    history = forgotten(1, again(with_level), first=41, kg=0.5, declared_kg=0.5)
    belief = history.last.belief
    assert [(o.undeclared, o.context.payload_kg, o.slot) for o in belief.contexts] == [(False, 0.0, 0), (False, 0.5, 1)]
    assert belief.undeclared_level is None
    assert belief.mass_estimate is not None
    assert belief.mass_estimate.replays == 27
    [warning] = history.last.warnings
    assert warning.text.endswith("its baseline is known from before")


def test_a_declared_motion_that_was_never_learnt_begins_when_the_payload_is_taken_off(with_level):
    """Files from elsewhere: another motion comes with the payload still on. Without it, that motion has no level yet, in whatever slot."""
    belief, settings = with_level.last.belief, AssessSettings()
    fit, at = rigid_fit(carrying(Arm(seed=3).replay(30.0), 0.5)), with_level.last.recorded_at_unix_s
    there = replace(belief.context, trajectory_digest="motion-1")
    change, found = enter_undeclared_level(enter_declared_context(belief, there, at, fit, settings), fit, at, settings.health)
    assert (found.own_level, change.opened) == (True, True)
    assert sorted(o.slot for o in change.belief.contexts if o.slot is not None) == [0, 1, 2]  # two motions with it, one without
    bare = rigid_fit(carrying(Arm(seed=4).replay(30.0), 0.0))
    change, found = enter_undeclared_level(enter_declared_context(change.belief, there, at, bare, settings), bare, at, settings.health)
    assert (found.condition, change.opened) == (None, True)


def test_two_payloads_in_turn_have_a_level_each():
    """A replay belongs to the level that it weighs most like; a third mass contradicts both, and does not end the second level."""
    rng, weights, limits = np.random.default_rng(8), Weights(), {"sigma": LIMITS.contradiction_sigma, "mass_kg": LIMITS.contradiction_kg}
    levels = []
    for replay in range(60):
        kg = 0.4 * (replay >= 10 and replay % 2)
        weights, found = weigh(weights, weighed(rng, kg), 86_400.0 * replay, **limits)
        levels.append((bool(kg), found.condition, found.own_level))
    assert set(levels[:10]) == {(False, None, False)}
    assert set(levels[10:48]) == {(False, None, False), (True, PAYLOAD, False)}
    assert set(levels[50:]) == {(False, None, False), (True, PAYLOAD, True)}
    other, found = weigh(weights, weighed(rng, 1.5), 0.0, **limits)
    assert found.withheld
    assert other.level == weights.level


def correlated(rng: np.random.Generator, change: float = 0.0) -> RigidFit:
    """Weights of which each replay knows a combination twenty times as well as any of them; `change` of it, in its deviations."""
    R = len(STD)
    combination = np.linalg.qr(np.random.default_rng(0).normal(size=(R, 8)))[0]
    within = np.eye(R) - (1.0 - 0.05**2) * combination @ combination.T
    values = np.linspace(1.0, 3.0, R) + np.linalg.cholesky(within) @ rng.normal(size=R) + change * 0.05 * combination.sum(axis=1)
    return weighed(rng)._replace(values=values, covariance=within)


@pytest.mark.parametrize(("change", "expected"), [(0.0, {None}), (14.0, {GAINS})])
def test_weights_that_are_known_together_only_show_another_gain(change, expected):
    """Eight combinations that moved by 14 σ each, no weight far beyond its own scatter: a gain. None where nothing moved."""
    rng, estimate, limits = np.random.default_rng(3), None, {"sigma": LIMITS.contradiction_sigma, "mass_kg": LIMITS.contradiction_kg}
    for _ in range(12):
        fit = correlated(rng)
        assert compare_weights(fit, estimate, **limits).condition is None
        estimate = update_mass_estimate(estimate, fit)
    fits = [correlated(rng, change) for _ in range(20)]
    assert np.max(np.abs(fits[0].values - estimate.mean)) < 4.0
    assert {compare_weights(fit, estimate, **limits).condition for fit in fits} == expected


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_the_full_physics_tell_another_gain_from_wear():
    """+10 % on the current of base, shoulder or elbow is told in every replay; wear of 30 % in any joint, and quiet replays, never."""
    excitation = excitation_from_document(json.loads((ROOT / "config/excitation/ur5-ground.json").read_text("utf-8")))
    controller, rng = Controller(SimulateSettings(robot="ur5", seed=5)), np.random.default_rng(5)
    limits = {"sigma": LIMITS.contradiction_sigma, "mass_kg": LIMITS.contradiction_kg}

    def replayed(scale: np.ndarray | float = 1.0) -> RigidFit:
        controller.pass_time(20.0, rng.uniform(8.0, 30.0), rng.uniform(0.0, 0.5))
        recording = stepped_replay(controller, excitation)
        return rigid_fit(identify([replace(recording, current=recording.current * scale)], UR5, Mounting(), residual_friction=True))

    estimate = None
    for _ in range(12):
        fit = replayed()
        assert compare_weights(fit, estimate, **limits).condition is None
        estimate = update_mass_estimate(estimate, fit)
    for joint in range(3):
        scale = np.where(np.arange(6) == joint, 1.1, 1.0)
        assert compare_weights(replayed(scale), estimate, **limits).condition == GAINS
    for joint in range(6):
        controller.arm.set_wear(joint, coulomb=1.3, viscous=1.3)
        assert compare_weights(replayed(), estimate, **limits).condition is None
        controller.arm.set_wear(joint, coulomb=1.0, viscous=1.0)


def test_a_mass_that_is_seen_only_with_its_place_excludes_no_payload():
    """Weights in which m and mx always come together say nothing of m. A replay knows it to 0.03 kg; 0.25 kg excludes nothing."""
    rng, estimate = np.random.default_rng(6), None
    for _ in range(10):
        estimate = update_mass_estimate(estimate, weighed(rng))
    limits = {"sigma": LIMITS.contradiction_sigma, "mass_kg": 0.5}
    assert compare_weights(weighed(rng), estimate, **limits).same_mass
    assert not compare_weights(weighed(rng, kg=0.25), estimate, **limits).same_mass
    fit = weighed(rng)
    together = fit._replace(of_mass=np.column_stack([fit.of_mass[:, 1], fit.of_mass[:, 1:]]))
    assert not compare_weights(together, estimate, **limits).same_mass
