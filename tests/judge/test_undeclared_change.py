"""Undeclared changes of payload, mounting or drive gains are detected as such, and never as wear."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_arm import Arm, History

from monitor.assess import AssessSettings, assess
from monitor.identify.identification import Identification
from monitor.identify.warnings import DataWarning
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.assessment import Assessment
from monitor.judge.drift.undeclared_change import (
    GAINS,
    PAYLOAD,
    RigidFit,
    compare_weights,
    rigid_fit,
    rigid_of,
    update_mass_estimate,
)
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.studies.rehearsal.worlds.weights import STD

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
    assert "about 2.5 kg more" in alert.text
    assert np.all(np.abs(history.last.belief.wear) < 0.01)
    assert history.last.belief.filter_state.replays[1] == 20  # nothing learnt of the three


def test_a_gain_that_changed_is_named_and_is_no_wear():
    """All weights are 10 % larger, which no mass at the flange explains."""
    history = lived(20, gain=1.1)
    assert {condition for _, _, _, condition, _ in history.transitions} == {"gain_contradiction"}
    assert np.all(np.abs(history.last.belief.wear) < 0.01)


def weighed(rng: np.random.Generator, kg: float = 0.0, gain: float = 1.0) -> RigidFit:
    """The weights of a UR5 as precisely as a replay of 30 s determines them."""
    fit = rigid_fit(carrying(Arm(seed=1).replay(30.0), 0.0))
    values = gain * (fit.values + fit.of_mass @ (kg * np.array([1.0, 0.01, -0.01, 0.05])))
    return fit._replace(values=values + STD * rng.normal(size=len(STD)), variance=STD**2)


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
        history.add(day, replace(seen, warnings=(DataWarning("mounting_contradiction", "gravity is 90° off"),)) if day >= 9 else seen)
    assert {condition for _, _, _, condition, _ in history.transitions} == {"mounting_contradiction"}
    assert history.health.state == "CHECK_FUNCTION"


def test_wear_and_quiet_replays_contradict_nothing():
    """Friction that rises by 20 % changes no weight: no undeclared change in 40 replays, and the wear is reported."""
    history, arm = History(), Arm(seed=1)
    for day in range(40):
        history.add(day, carrying(arm.replay(30.0, np.array([0, 0, 0.2 * (day > 25), 0, 0, 0])), 0.0))
    assert {(joint, condition) for _, _, joint, condition, _ in history.transitions} == {(3, "sudden_step")}


@pytest.mark.parametrize(("payload", "blind"), [("declared", False), ("undeclared", False), ("undeclared", True)])
def test_ur10e_recordings_raise_no_wear_alert(real_data, tmp_path, monkeypatch, payload, blind):
    """Real recordings in time order. The last carries about 2.6 kg: declared it opens a context, undeclared it is detected.

    They have no temperature. Without temperatures wear cannot be judged, and an alert reports only this. With a constant temperature
    there is no wear alert either.
    """
    from monitor.store import series
    from monitor.store.recordings import read_recording
    from monitor.store.series import Series, assess_series, manifest

    def warm(path: object, columns: str) -> object:
        recording = read_recording(path, columns)
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
