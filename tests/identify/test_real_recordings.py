"""Real arms: figures that must not get worse. Skipped where the recordings are absent."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.identify import identify
from monitor.identify.payload import identify_payload
from monitor.identify.signals.arm import joint_torque
from monitor.identify.signals.motion import motion
from monitor.identify.validate import validate
from monitor.judge import prediction_error
from monitor.judge.assess import judge_identification
from monitor.judge.assessment import Assessment
from monitor.judge.torque.evaluation import measure_prediction_error
from monitor.judge.torque.predictor import predict_torque
from monitor.model.regressor import regressor
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context, Recording
from monitor.store.formats.recordings import read_recording

COLUMNS = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
GAINS = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])  # of that arm's authors [N·m/A]
GROUND = Mounting()
LOADED = "ur-20_02_19_14harm50secLoad.csv"  # 2.6 kg
SPEEDS_RAD_S = (0.2, 0.4, 0.8)


@pytest.fixture(scope="module")
def ur10e(real_data):
    """One identification of the 50 s run, and a reader of the others."""

    def read(name):
        return read_recording(real_data / "ur10e" / name, COLUMNS)

    robot = load_robot("ur10e")
    return robot, identify([read("ur-20_02_12-50sec_12harm.csv")], robot, GROUND, gains=GAINS), read


@pytest.mark.parametrize("name", ["ur-20_02_10-30sec_12harm.csv", "ur-20_02_19_14harm50sec.csv"])
def test_ur10e_torque_is_predicted_to_9_5_6_8_8_7_percent(ur10e, name):
    """On runs never fitted: relative RMS over moving samples, and at least 85 % below the manufacturer's masses alone.

    The limits are the project's promise, about a third above what is reached.
    """
    robot, found, read = ur10e
    figures = validate(found, read(name), robot, GAINS)
    reduction = 1.0 - figures.rms_nm / figures.nominal_rms_nm
    print(name, "relative rms %", np.round(100 * figures.relative_rms, 1), "below nominal %", np.round(100 * reduction, 1))
    assert np.all(figures.relative_rms <= [0.09, 0.05, 0.06, 0.08, 0.08, 0.07])
    assert np.all(reduction >= 0.85)


def test_ur10e_friction_repeats_across_trajectories_within_its_uncertainty(ur10e):
    """F(0.4 rad/s) from three different runs, days apart, agrees within 5 % and within 4 std of the difference, misfit included.

    Trajectories that differ scatter more than replays of one do: 5 % is the reference's figure for fv, with F(v*) expected below.
    """

    def at_0_4(found):
        x = np.array([1.0, 0.4])
        return found.coulomb_nm + 0.4 * found.viscous_nm_s_per_rad, np.sqrt((found.friction_cov + found.misfit_cov) @ x @ x)

    robot, first, read = ur10e
    force, std = at_0_4(first)
    for name in ("ur-20_02_10-30sec_12harm.csv", "ur-20_02_19_14harm50sec.csv"):
        other, other_std = at_0_4(identify([read(name)], robot, GROUND, gains=GAINS))
        assert np.all(np.abs(other / force - 1.0) < 0.05)
        assert np.all(np.abs(other - force) < 4.0 * np.hypot(std, other_std))


def held(runs):
    """(pairs · speeds, J) whether the 90 % interval of one run holds the friction that another finds at the speed."""
    every = []
    for speed in SPEEDS_RAD_S:
        lines = [run.line_at(speed) for run in runs]
        every += [np.abs(there - here) < 1.645 * std for here, std in lines for there, _ in lines if there is not here]
    return np.array(every)


def test_an_interval_of_friction_holds_what_another_run_finds(ur10e):
    """90 % intervals of F at three speeds, each of one motion, hold the value of another motion.

    With the twelve unloaded runs of this arm 94.5 % of 132 pairs are held, by joint and speed 78 % or more. Without what differs from run
    to run, 87 % and 55 %: friction of joint 6 at 0.8 rad/s. Here are three of the twelve, which hold each other throughout, so the share
    over all joints and speeds counts a run under 2.6 kg too: 96 %. An interval that held every run would be wider than it says.
    """
    robot, first, read = ur10e
    unloaded = [first, *(identify([read(name)], robot, GROUND, gains=GAINS) for name in HELD_OUT)]
    assert np.all(np.mean(held(unloaded), axis=0) >= 0.8)
    assert 0.85 <= np.mean(held([*unloaded, identify([read(LOADED)], robot, GROUND, gains=GAINS)])) <= 0.97
    force, std = first.line_at(SPEEDS_RAD_S[-1])
    assert np.all(std < 0.1 * force)  # and is narrow enough to say something


def test_masking_standstill_is_what_the_wrists_gain_from(ur10e):
    """WLS halves the error of plain LS on joints 4 and 5, as the reference found."""
    robot, found, read = ur10e
    plain = identify([read("ur-20_02_12-50sec_12harm.csv")], robot, GROUND, gains=GAINS, method="ls")
    held_out = read("ur-20_02_10-30sec_12harm.csv")
    ls, wls = validate(plain, held_out, robot, GAINS), validate(found, held_out, robot, GAINS)
    assert np.all(wls.relative_rms[3:5] < 0.5 * ls.relative_rms[3:5])


HELD_OUT = ("ur-20_02_10-30sec_12harm.csv", "ur-20_02_19_14harm50sec.csv")


def pooled(rms_nm, recording):
    """RMS over all joints and moving samples from the joints' own."""
    moving = np.sum(motion(recording).moving(), axis=0)
    return float(np.sqrt(np.sum(moving * rms_nm**2) / np.sum(moving)))


@pytest.fixture(scope="module")
def ur10e_auto(ur10e):
    """The law that the training data choose for themselves, and the paper's plain LS beside it."""
    robot, _, read = ur10e
    training = [read("ur-20_02_12-50sec_12harm.csv")]
    return (
        identify(training, robot, GROUND, gains=GAINS, method="robust", friction="auto"),
        identify(training, robot, GROUND, gains=GAINS, method="ls"),
    )


@pytest.mark.parametrize("name", HELD_OUT)
@pytest.mark.slow
def test_ur10e_richer_friction_halves_the_papers_error(ur10e, ur10e_auto, name):
    """Pooled RMS at most half of plain LS in the same run, at least 93 % below the manufacturer's; wrists at most 7.5 %.

    Reached are 0.486 and 0.459, 95.4 and 95.2 %, and 6.8 %.
    """
    robot, _, read = ur10e
    found, plain = ur10e_auto
    recording = read(name)
    rich, ls = validate(found, recording, robot, GAINS), validate(plain, recording, robot, GAINS)
    ratio = pooled(rich.rms_nm, recording) / pooled(ls.rms_nm, recording)
    below = 1.0 - pooled(rich.rms_nm, recording) / pooled(rich.nominal_rms_nm, recording)
    print(name, f"of plain LS {ratio:.3f}, below nominal {below:.2%}, relative %", np.round(100 * rich.relative_rms, 1))
    assert ratio <= 0.5
    assert below >= 0.93
    assert np.all(rich.relative_rms[3:] <= 0.075)


def test_ur10e_chooses_load_concave_and_braking_friction(ur10e, ur10e_auto):
    """Held-out error within the training run falls with each richer law, and its fc, fv stay within 5 % of the paper's at 0.4 rad/s."""
    _, paper, _ = ur10e
    found, _ = ur10e_auto
    assert found.law.name == "braking"
    assert found.held_out["braking"] < found.held_out["concave"] < found.held_out["load"] < found.held_out["paper"]
    force = paper.coulomb_nm + 0.4 * paper.viscous_nm_s_per_rad
    np.testing.assert_allclose(found.coulomb_nm + 0.4 * found.viscous_nm_s_per_rad, force, rtol=0.05)
    assert np.all(found.friction.values[1:3, 2] > 0.03)  # J2 and J3 carry the arm: their gears feel it


def test_ur10e_payload_is_found_with_the_arm_and_its_friction_frozen(ur10e, ur10e_auto):
    """RMS at most 1.3 of the unloaded held-out RMS, and above it without the load term. No payload is found where there is none.

    The mass with these gains is 3.07 kg, from joint 2 alone 3.01, joint 3 alone 3.16, the wrists alone 3.02; the recording's authors
    give about 2.6 kg. Gains that are 5 % too high would explain a third of the difference, so the limits are wide.
    """
    robot, paper, read = ur10e
    found, _ = ur10e_auto
    loaded, other = read(LOADED), read(HELD_OUT[1])
    payload = identify_payload([loaded], found, robot, gains=GAINS)
    unloaded = pooled(validate(found, other, robot, GAINS).rms_nm, other)
    print(f"payload {payload.mass_kg:.3f} ± {payload.mass_std_kg:.3f} kg, rms {pooled(payload.rms_nm, loaded) / unloaded:.3f} of unloaded")
    assert pooled(payload.rms_nm, loaded) <= 1.3 * unloaded
    blind = identify_payload([loaded], paper, robot, gains=GAINS)
    assert pooled(blind.rms_nm, loaded) > 1.3 * pooled(validate(paper, other, robot, GAINS).rms_nm, other)
    assert 2.3 < payload.mass_kg < 3.4
    assert abs(identify_payload([other], found, robot, gains=GAINS).mass_kg) < 0.05  # 0.7 % of what the arm itself can carry


def test_ur3e_is_read_by_its_column_names(real_data):
    """25 Hz, temperatures, payload register; identified with assumed gains, and with its warnings."""
    recording = read_recording(real_data / "ur3e" / "rtde_25hz.csv")
    assert (recording.samples, recording.joints, recording.context.payload_kg) == (888, 6, 1.07)
    found = identify([recording], load_robot("ur3e"), GROUND, gains=np.array([11.0, 11.0, 9.0, 5.0, 5.0, 5.0]))
    assert found.sources[0].rate_hz == pytest.approx(25.0, abs=1e-6)
    np.testing.assert_allclose(found.temperature_c, [34.4, 35.7, 37.9, 40.9, 43.0, 43.0], atol=0.1)
    assert np.all(found.coulomb_nm > 0.0)
    assert np.all(found.viscous_nm_s_per_rad > 0.0)
    assert {"low_rate", "payload", "joint_hardly_moves"} <= {warning.code for warning in found.warnings}


@pytest.mark.parametrize("name", ["real_10hz.csv", "ursim_125hz.csv"])
def test_an_arm_that_stands_still_is_refused(real_data, name):
    """Real or simulated: no motion, no friction."""
    recording = read_recording(real_data / "ur_standstill" / name)
    with pytest.raises(Unidentifiable, match=rf"{name}: the arm stands still"):
        identify([recording], load_robot("ur5"), GROUND)


def test_a_staircase_of_one_joint_is_refused(ur10e):
    """One joint of six moves."""
    robot, _, read = ur10e
    with pytest.raises(Unidentifiable, match="the joints that move are 1 of 6"):
        identify([read("ur-20_01_22-joint_2.csv")], robot, GROUND, gains=GAINS)


def test_a_log_without_positions_is_refused(real_data):
    """The 1 Hz warm-up log: decimal commas, a misnamed column, and nothing to identify."""
    with pytest.raises(BadInput, match="holds no joint positions"):
        read_recording(real_data / "ur3_warmup" / "dataset_02052023.csv")


@pytest.mark.parametrize("name", HELD_OUT)
def test_the_measured_torque_of_a_real_arm_stays_in_its_interval(ur10e, name):
    """90 % intervals of a measurement, from the residual of one run, on other motions never fitted: 84.7 and 85.1 % are reached.

    That is at the lower edge of what is wanted, 85–95 %, as another motion finds more misfit than the one fitted; the limit keeps it
    from getting worse.
    """
    robot, found, read = ur10e
    moved = motion(read(name))
    torque = joint_torque(moved, robot, GAINS)
    predicted = regressor(robot, GROUND, moved.q, moved.qd, moved.qdd)[:, :, list(found.columns)] @ found.values
    held = np.abs(torque - predicted)[moved.moving()] < 1.645 * np.broadcast_to(found.rms_nm, torque.shape)[moved.moving()]
    print(name, "held %", np.round(100 * held.mean(), 1))
    assert 0.84 <= held.mean() <= 0.95


@pytest.fixture(scope="module")
def compensated(ur10e):
    """The model of the 50 s run, without the terms of residual friction and with them."""
    robot, _, read = ur10e
    models = []
    for residual_friction in (False, True):
        found = identify([read("ur-20_02_12-50sec_12harm.csv")], robot, GROUND, gains=GAINS, residual_friction=residual_friction)
        found = replace(found, temperature_c=np.full(6, 30.0))  # not recorded; the model needs one
        outcome = judge_identification(found, Context(robot="ur10e", recorded_at_unix_s=1.0), belief=None, health=None)
        assert isinstance(outcome, Assessment), outcome
        models.append(outcome.model)
    return models


@pytest.mark.parametrize("name", HELD_OUT)
def test_residual_friction_predicts_a_real_arm_better(ur10e, compensated, name):
    """Filtered torque on motions that were not fitted: 0.60 and 0.55 of the error without it, no joint more than 1 % worse."""
    robot, _, read = ur10e
    moved = motion(read(name))
    torque = joint_torque(moved, robot, GAINS)
    left = [
        np.where(moved.moving(), torque - predict_torque(model, robot, moved.q, moved.qd, moved.qdd).torque, 0.0) for model in compensated
    ]
    rms = [np.sqrt(np.mean(e**2, axis=0)) for e in left]
    print(name, "with over without", np.round(rms[1] / rms[0], 2), "all", np.linalg.norm(rms[1]) / np.linalg.norm(rms[0]))
    assert np.all(rms[1] <= 1.02 * rms[0])
    assert np.linalg.norm(rms[1]) <= 0.75 * np.linalg.norm(rms[0])


@pytest.mark.parametrize(("known", "asked"), [HELD_OUT, HELD_OUT[::-1]])
def test_a_real_arms_samples_stay_in_the_interval_by_the_error_on_another_replay(ur10e, compensated, known, asked):
    """90 % intervals of unfiltered currents, on one motion that was not fitted, by the error on another: they hold 93.9 and 90.7 %."""
    robot, _, read = ur10e

    def raw(name):
        recording, moved = read(name), motion(read(name))
        current = np.stack([np.interp(moved.t_s, recording.t_s, column) for column in recording.current.T], axis=1)
        T = np.full_like(moved.q, 30.0)
        return Recording(t_s=moved.t_s, q=moved.q, qd=moved.qd, target_qdd=moved.qdd, current=current, temperature_c=T)

    model = compensated[1]
    shown = prediction_error.update(None, measure_prediction_error(raw(known), model, robot, GAINS), model.residual_rms_nm)
    error_nm, measured_nm = prediction_error.rms(shown, model.residual_rms_nm)
    sure, seen = replace(model, error_rms_nm=error_nm, measured_rms_nm=measured_nm), raw(asked)
    predicted = predict_torque(sure, robot, seen.q, seen.qd, seen.target_qdd, seen.temperature_c)
    moving = np.abs(seen.qd) > 0.02
    held = (np.abs(seen.current * GAINS - predicted.torque) < 1.645 * predicted.measured_std)[moving].mean()
    print(asked, "held %", round(100 * held, 1), "error", np.round(error_nm, 2), "measured", np.round(measured_nm, 2))
    assert 0.85 <= held <= 0.95
