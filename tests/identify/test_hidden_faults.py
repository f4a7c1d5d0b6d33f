"""Faults that leave a small residual: each is told, or friction that it makes unknown is not quoted."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from faults import DRIVES, permuted
from oracle_arm import GROUND, VISCOUS, friction, recording, rigid_torque, truth
from own_physics import UR5, late, productioned_arm

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.detectors import Predicted, warnings_of
from monitor.identify.identify import identify
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Recording
from monitor.store.formats.recordings import read_recording
from monitor.store.from_files.series import in_order
from monitor.store.identify_files import Request, identify_files

HEALTHY = productioned_arm(4)


def codes(found):
    return [warning.code for warning in found.warnings]


def test_a_fit_without_noise_is_told_as_none_of_a_measurement():
    """What a controller wanted, by its own model; with a drive's noise nothing is told."""
    known = truth(UR5)
    assert "no_noise" in codes(identify([recording(known, noise=0.02)], UR5, GROUND))[:2]
    assert "no_noise" not in codes(identify([recording(known)], UR5, GROUND))


def one_way(offset_nm):
    """Every joint turns forward alone, at changing speeds, with the same offset of its torque."""
    t_s = np.arange(0.0, 20.0, 0.008)
    rates = 0.2 + 0.03 * np.arange(6)
    qd = 0.15 + 0.12 * np.sin(rates * 2.0 * t_s[:, None] + np.arange(6))
    q, qdd = np.cumsum(qd, axis=0) * 0.008 - 1.0, np.gradient(qd, 0.008, axis=0)
    rng = np.random.default_rng(1)
    torque = rigid_torque(UR5, GROUND, q, qd, qdd) + friction(qd) + offset_nm + 0.2 * rng.normal(size=q.shape)
    return Recording(t_s=t_s, q=q, qd=qd, torque=torque, source="forward")


@pytest.mark.parametrize("law", ["paper", "concave"])
def test_of_a_joint_that_turns_one_way_viscous_friction_alone_is_quoted(law):
    """An offset of its drive would be Coulomb friction in full; every joint is told. What changes with speed is no offset."""
    found = identify([one_way(1.0)], UR5, GROUND, friction=law)
    assert codes(found).count("one_direction") == 6
    assert np.isnan(found.coulomb_nm).all()
    assert np.isnan(found.friction_at(0.4)[0]).all()
    assert np.isnan(found.line_at(0.4)[0]).all()
    std = np.sqrt(found.friction_cov[:, 1, 1] + found.misfit_cov[:, 1, 1])
    assert np.all(np.abs(found.viscous_nm_s_per_rad - VISCOUS) < 2.5 * std)
    assert np.all(std < VISCOUS)


def written(folder, name, given):
    """A recording as CSV in RTDE's names."""
    header = ["timestamp", *(f"actual_{s}_{j}" for s in ("q", "qd", "current") for j in range(6))]
    rows = np.column_stack([given.t_s, given.q, given.qd, given.current])
    np.savetxt(folder / name, rows, delimiter=",", header=",".join(header), comments="")
    return folder / name


def held_out_told(folder, held):
    """Warnings of a held-out recording beside a sound fit."""
    files = [written(folder, "fitted.csv", productioned_arm(1))]
    outcome = identify_files(Request(files=files, robot=UR5, mounting=GROUND, held_out=[written(folder, "held.csv", held)]))
    return [warning for warning in outcome.document["warnings"] if warning["code"] == "held_out_poor"]


def test_a_held_out_recording_that_does_not_fit_is_told_with_its_cause(tmp_path):
    """With the joints, how much is missed, and what it is by itself; one that fits is not told."""
    (told,) = held_out_told(tmp_path, permuted(HEALTHY, [0, 1, 2, 3, 5, 4], DRIVES))
    assert "joints 5, 6" in told["text"]
    assert "currents or torques of joints 5 and 6 are exchanged" in told["text"]
    (late_told,) = held_out_told(tmp_path, late(HEALTHY, 0.2))
    assert "held.csv: the model misses up to" in late_told["text"]
    assert held_out_told(tmp_path, HEALTHY) == []


def test_one_recording_under_two_dates_is_refused():
    """A copy whose clock begins elsewhere is the same measurement; another replay of the same motion is another one."""

    def dated(given, day):
        context = replace(given.context, recorded_at_unix_s=86400.0 * day)
        return replace(given, source=f"day {day}", context=context), Mounting()

    copy = replace(HEALTHY, t_s=HEALTHY.t_s + 1e6)
    assert copy.samples_digest == HEALTHY.samples_digest
    with pytest.raises(BadInput, match="day 2 is day 1 once more"):
        in_order([dated(HEALTHY, 1), dated(copy, 2)])
    assert len(in_order([dated(HEALTHY, 1), dated(productioned_arm(5), 2)])) == 2


def test_a_drives_own_units_are_read_with_gains_and_refused_without():
    """Thousands that are no amperes: with the torque of one unit they are a measurement like any other."""
    units = 400.0
    raw = replace(HEALTHY, current=units * HEALTHY.current)
    gains = UR5.drive_gain_nm_per_a / units
    with pytest.raises(Unidentifiable, match=r"no amperes: expected \[A\].*say with --gains what torque one of them is"):
        identify([raw], UR5, GROUND)
    found, sound = identify([raw], UR5, GROUND, gains=gains), identify([HEALTHY], UR5, GROUND)
    np.testing.assert_allclose(found.friction_at(0.4)[0], sound.friction_at(0.4)[0], rtol=1e-6)
    assert found.warnings == ()


@pytest.mark.parametrize("step_rad_s", [0.022, 0.05])
def test_coarse_speeds_of_a_slow_arm_are_compared_where_they_are_resolved(step_rad_s):
    """Speeds written in steps, mostly slower than a few of these: neither refused nor doubted."""
    known = truth(UR5, speed_rad_s=0.5)
    sound = recording(known)
    coarse = replace(sound, qd=step_rad_s * np.floor(sound.qd / step_rad_s) + step_rad_s / 2.0)
    found = identify([coarse], UR5, GROUND)
    assert not {"clock_doubtful", "speeds_doubtful"} & set(codes(found))
    wrong_clock = replace(coarse, t_s=1.12 * coarse.t_s)
    assert {"clock_doubtful", "speeds_doubtful"} & set(codes(identify([wrong_clock], UR5, GROUND)))


@pytest.mark.parametrize(("folder", "urdf"), [("kuka_lwr4", "flobaroid_kuka_lwr4.urdf"), ("lbr_med7", "lbr_med7dock.urdf")])
def test_a_torque_sensor_behind_the_gear_needs_to_see_no_friction(folder, urdf, real_data):
    """Friction of next to nothing is no wrong gain there."""
    from monitor.store.identify_files import robot_from_urdf

    path = real_data / "arms" / folder
    if not path.exists():
        pytest.skip(f"{path} is not here")
    for file in sorted(path.glob("*.csv")):
        found = identify([read_recording(file)], robot_from_urdf(path / urdf), GROUND)
        assert not [warning.text for warning in found.warnings if warning.code == "gain_doubtful" and "friction of" in warning.text]


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["ur3_brasilia", "ur5_kufieta"])
def test_no_real_arm_is_told_as_smoothed_or_without_noise(folder, real_data):
    """The quick changes of their currents are there."""
    path = real_data / "arms" / folder
    if not path.exists():
        pytest.skip(f"{path} is not here")
    for file in sorted(path.glob("*.csv")):
        try:
            found = identify([read_recording(file)], load_robot(folder[:3]), GROUND)
        except (BadInput, Unidentifiable):
            continue
        assert not {"torque_smoothed", "no_noise"} & set(codes(found)), file.name


def test_a_model_that_is_wrong_by_more_than_all_of_the_torque_where_joints_stand_still_says_so():
    """In motion it fits: no joint was excited by what holds it at rest."""
    sound = np.full(6, 0.05)
    at_rest = np.array([0.1, 90.0, 0.2, np.nan, 1.5, 0.1])
    (told,) = warnings_of(Predicted("held.csv", sound, at_rest, sound, None))
    assert told.code == "held_out_at_rest"
    assert "joints 2 stand still" in str(told)
    assert not warnings_of(Predicted("held.csv", sound, np.full(6, 1.0), sound, None))


@pytest.mark.parametrize("smooth", ["6 Hz", "9 Hz", "80 ms"])
def test_torque_that_was_smoothed_above_what_the_fit_uses_is_told_by_its_noise(smooth):
    """1 to 3 % of friction are lost; the quick changes of the torque itself still look sound."""
    rate_hz = 1.0 / float(np.median(np.diff(HEALTHY.t_s)))
    if smooth == "80 ms":
        window = np.ones(round(0.08 * rate_hz)) / round(0.08 * rate_hz)
        current = np.apply_along_axis(lambda own: np.convolve(own, window, "same"), 0, HEALTHY.current)
    else:
        b, a = scipy.signal.butter(2, float(smooth.split()[0]), fs=rate_hz)
        current = scipy.signal.filtfilt(b, a, HEALTHY.current, axis=0)
    assert {"noise_smoothed", "torque_smoothed"} & set(codes(identify([replace(HEALTHY, current=current)], UR5, GROUND))[:2])
