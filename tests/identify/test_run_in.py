"""The run-in after rest: the simulator has one, and a fit that leaves out the first seconds of motion does not scatter with it."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracle_arm import recording, truth

from monitor.config.files import find_excitation
from monitor.errors import BadInput, Unidentifiable
from monitor.identify.identify import identify
from monitor.identify.settings import IdentifySettings, SignalSettings
from monitor.identify.signals.motion import motion
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Recording
from monitor.simulate.arm.friction import REST_S, RUN_S, RunIn
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

UR5 = load_robot("ur5")
PASS_S = 10.0
SHARE = 0.04


def test_a_joint_that_moves_loses_its_run_in_and_rest_brings_it_back():
    """After τ of motion 37 % is left, in one step or in many; a joint that stood keeps all; an hour of rest brings nearly all back."""
    run_in = RunIn(3, SHARE)
    for _ in range(300):
        run_in.pass_by(RUN_S / 300, np.array([0.5, 0.5, 0.0]) * RUN_S / 300)
    at_once = RunIn(3, SHARE)
    at_once.pass_by(RUN_S, np.array([0.5, 0.5, 0.0]) * RUN_S)
    assert run_in.rested == pytest.approx(at_once.rested)
    assert run_in.factor == pytest.approx([1.0 + SHARE * math.exp(-1.0)] * 2 + [1.0 + SHARE])
    run_in.pass_by(4.0 * REST_S, np.zeros(3))
    assert np.all(run_in.rested > 0.98)
    run_in.pass_production(3600.0, 1.0)
    assert np.all(run_in.rested < 0.02)


def test_an_arm_without_a_run_in_is_the_arm_of_before_to_the_bit():
    """The factor is exactly 1, whatever the rest; a share beyond reason is refused."""
    run_in = RunIn(2, 0.0)
    run_in.pass_by(3.0, np.array([1.0, 0.0]))
    assert run_in.factor.tolist() == [1.0, 1.0]
    with pytest.raises(BadInput, match="run_in = 2; expected 0"):
        SimulateSettings(run_in=2.0)


@pytest.fixture(scope="module")
def replays() -> list[Recording]:
    """Three passes each of an arm that has rested and of one that has worked until now, with the same noise."""
    excitation = replace(find_excitation("ur5-ground", Path()), repetitions=3)
    played = []
    for rested in (1.0, 0.0):
        controller = Controller(SimulateSettings(robot="ur5", run_in=SHARE))
        controller.arm.run_in.rested[:] = rested
        controller.arm.set_temperatures(controller.arm.temperatures)  # friction is that of the run-in from the first step on
        played.append(stepped_replay(controller, excitation))
    return played


def log_friction(played: Recording, run_in_s: float = 0.0) -> np.ndarray:
    """(J,) logarithm of F(0.4 rad/s)."""
    found = identify([played], UR5, Mounting(), settings=IdentifySettings(signals=SignalSettings(run_in_s=run_in_s)))
    return np.log(found.coulomb_nm + 0.4 * found.viscous_nm_s_per_rad)


def first_pass(played: Recording) -> Recording:
    rows = slice(0, round(PASS_S / 0.008))
    return replace(played, **{name: signal[rows] for name, signal in played.signals.items()})


@pytest.mark.soak
def test_replays_after_rest_and_after_production_agree_without_the_first_twenty_seconds(replays):
    """One pass from the start differs by 1.8 % or more in every joint, as large as all other scatter; the third pass by 0.8 % at most."""
    rested, worked = (log_friction(first_pass(played)) for played in replays)
    assert np.all(rested - worked > 0.018)
    rested, worked = (log_friction(played, run_in_s=20.0) for played in replays)
    assert np.all(np.abs(rested - worked) < 0.008)


def test_the_run_in_counts_motion_and_not_rest():
    """Five seconds of standstill at the beginning take nothing from the run-in; what is left begins where the arm has moved for so long."""
    known = recording(truth(UR5))
    still = 625
    padded = replace(
        known,
        t_s=np.concatenate([known.t_s[0] - 0.008 * np.arange(still, 0, -1), known.t_s]),
        **{
            name: np.concatenate([np.repeat(getattr(known, name)[:1] * (name != "qd"), still, axis=0), getattr(known, name)])
            for name in ("q", "qd", "current", "temperature_c")
        },
    )
    settings = SignalSettings(run_in_s=12.0)
    begins = [motion(each, settings).t_s[0] for each in (known, padded)]
    assert begins[0] == pytest.approx(begins[1], abs=0.1)
    assert begins[0] - motion(known).t_s[0] == pytest.approx(12.0, abs=1.0)  # between two passes all joints are slow


def test_a_recording_that_is_all_run_in_is_refused_with_the_key():
    """The message names the setting, and what would be right."""
    with pytest.raises(Unidentifiable, match=r"identify\.signals\.run_in_s.*more repetitions"):
        motion(recording(truth(UR5, repetitions=1)), SignalSettings(run_in_s=60.0))
