"""The parameters of a known arm, found from its motion."""

from dataclasses import replace

import numpy as np
import pytest
from oracle_arm import COULOMB_NM, GROUND, ROTOR_KG_M2, VISCOUS, Truth, exact_motion, excitation, recording, rigid_torque, truth

from monitor.errors import BadInput
from monitor.identify.identify import IdentifyOptions, identify, identify_motions
from monitor.identify.signals.motion import Motion
from monitor.identify.validate import predict_motion, predict_torque, validate
from monitor.model.robot import PER_JOINT, Mounting, load_robot

UR5 = load_robot("ur5")


def true_base(robot, found):
    """The base parameters that pinocchio's arm has."""
    standard = robot.nominal_parameters(with_inertia=True).reshape(6, PER_JOINT)
    standard[:, 10:] = np.stack([COULOMB_NM, VISCOUS, ROTOR_KG_M2], axis=1)
    return found.combination @ standard.ravel()


def codes(found):
    return {warning.code for warning in found.warnings}


@pytest.mark.parametrize("method", ["ls", "wls"])
@pytest.mark.parametrize(("name", "mounting"), [("ur3", "ground"), ("ur5", "wall"), ("ur10e", "10,20,30")])
def test_without_noise_the_parameters_of_the_arm_are_found(name, mounting, method):
    """Base parameters, fc and fv to 1e-8 of the largest: rounding times a condition number of some hundred, with room to spare."""
    robot, attitude = load_robot(name), Mounting.parse(mounting)
    known = truth(robot, attitude)
    found = identify_motions([exact_motion(known)], [known.torque], robot, attitude, IdentifyOptions(method=method))
    expected = true_base(robot, found)
    assert np.max(np.abs(found.values - expected)) <= 1e-8 * np.max(np.abs(expected))
    np.testing.assert_allclose(found.coulomb_nm, COULOMB_NM, rtol=1e-8)
    np.testing.assert_allclose(found.viscous_nm_s_per_rad, VISCOUS, rtol=1e-8)
    assert np.max(found.rms_all_nm) < 1e-8
    assert codes(found) <= {"no_noise", "ill_conditioned"}  # random harmonics are no designed excitation


def test_holding_torque_at_standstill_misleads_ls_and_not_wls():
    """A joint that rests a tenth of the time with 3 N·m of locked-in friction: WLS finds the truth (1e-8), LS is off by more than 1 %."""
    known = truth(UR5)
    rest = np.zeros(known.qd.shape, dtype=bool)
    for j in range(6):
        rest[300 + 400 * j : 700 + 400 * j, j] = True
    q, qd, qdd = known.q.copy(), np.where(rest, 0.0, known.qd), np.where(rest, 0.0, known.qdd)
    rigid = rigid_torque(UR5, GROUND, q, qd, qdd) + ROTOR_KG_M2 * qdd
    moved = Truth(known.t_s, q, qd, qdd, rigid + COULOMB_NM * np.tanh(qd / 0.001) + VISCOUS * qd + 3.0 * rest)
    errors = {}
    for method in ("ls", "wls"):
        found = identify_motions([exact_motion(moved)], [moved.torque], UR5, GROUND, IdentifyOptions(method=method))
        errors[method] = np.max(np.abs(np.append(found.coulomb_nm / COULOMB_NM, found.viscous_nm_s_per_rad / VISCOUS) - 1.0))
    assert errors["wls"] < 1e-8
    assert errors["ls"] > 0.01


def test_friction_of_a_noisy_recording_lies_within_its_uncertainty():
    """From positions, speeds and currents as a controller sends them: F(0.4 rad/s) to 2 %, fc and fv within their standard deviations.

    Of 36 estimates in three recordings 95 % lie within two std; below 83 % is less likely than 1 in 100.
    """
    inside = []
    for seed in range(3):
        inside.append(_within_two_std(identify([recording(truth(UR5, seed=seed), seed=seed)], UR5, GROUND)))
    assert np.mean(inside) >= 0.83


def _within_two_std(found):
    force, force_std = found.friction_at(0.4)
    np.testing.assert_allclose(force, COULOMB_NM + 0.4 * VISCOUS, rtol=0.02)
    assert np.all(force_std < 0.02 * force)
    std = np.sqrt(np.diagonal(found.friction_cov, axis1=1, axis2=2))
    off = np.abs(np.stack([found.coulomb_nm - COULOMB_NM, found.viscous_nm_s_per_rad - VISCOUS], axis=1))
    np.testing.assert_allclose(found.temperature_c, 31.25)
    return off < 2.0 * std


def test_fc_and_fv_of_one_replay_are_anticorrelated():
    """They are anti-correlated on every joint, and the standard deviation of their sum at 0.4 rad/s is smaller than that of either."""
    found = identify([recording(truth(UR5))], UR5, GROUND)
    assert np.all(found.friction_cov[:, 0, 1] < 0.0)
    _, together = found.friction_at(0.4)
    apart = np.sqrt(found.friction_cov[:, 0, 0] + 0.16 * found.friction_cov[:, 1, 1])
    assert np.all(together < 0.8 * apart)


def test_two_recordings_give_smaller_standard_deviations_than_one():
    """Identified together, all samples count, and the standard deviation of F(0.4) falls by √2 in the mean, here to below 0.9."""
    first, second = recording(truth(UR5)), recording(truth(UR5, seed=1), seed=1)
    one, both = identify([first], UR5, GROUND), identify([first, second], UR5, GROUND)
    assert both.samples > 1.9 * one.samples
    assert np.mean(both.friction_at(0.4)[1] / one.friction_at(0.4)[1]) < 0.9
    assert [source.file for source in both.sources] == ["synthetic", "synthetic"]


def test_torn_rows_do_not_move_the_result():
    """Thirty rows torn as by a lost sync are left out with a warning, and friction changes by less than half of its standard deviation.

    Their noise was a part of it: √(2·30/3750) ≈ 0.13 of the standard deviation is to be expected."""
    sound = recording(truth(UR5))
    rows = np.random.default_rng(5).choice(sound.samples, 30, replace=False)
    current, q = sound.current.copy(), sound.q.copy()
    current[rows[:15]] = 1e305
    q[rows[15:]] = np.nan
    usual, found = identify([sound], UR5, GROUND), identify([replace(sound, current=current, q=q)], UR5, GROUND)
    assert "rejected_rows" in codes(found)
    assert dict(found.sources[0].rejected_why) == {"not_finite": 15, "absurd_value": 15}
    assert np.all(np.abs(found.friction_at(0.4)[0] - usual.friction_at(0.4)[0]) < 0.5 * usual.friction_at(0.4)[1])


def test_prediction_splits_into_rigid_and_friction():
    """On states never fitted: torque = rigid + friction, and each is pinocchio's and ours to 1e-7 of the largest torque."""
    known, other = truth(UR5), truth(UR5, seed=9)
    found = identify_motions([exact_motion(known)], [known.torque], UR5, GROUND)
    parts = predict_torque(found, UR5, other.q, other.qd, other.qdd)
    scale = 1e-7 * np.max(np.abs(other.torque))
    np.testing.assert_allclose(parts.torque, other.torque, atol=scale)
    np.testing.assert_allclose(parts.friction, COULOMB_NM * np.tanh(other.qd / 0.001) + VISCOUS * other.qd, atol=scale)
    np.testing.assert_allclose(parts.rigid + parts.friction, parts.torque, atol=1e-12)  # rounding of one subtraction


def test_ground_parameters_predict_the_ceiling():
    """Identified upright, evaluated hanging, with the ceiling's regressor: the paper's transfer (§4.3), exact without noise."""
    known, ceiling = truth(UR5), Mounting.parse("ceiling")
    found = identify_motions([exact_motion(known)], [known.torque], UR5, GROUND)
    hanging = truth(UR5, ceiling, seed=4)
    right = predict_torque(replace(found, mounting=ceiling), UR5, hanging.q, hanging.qd, hanging.qdd).torque
    wrong = predict_torque(found, UR5, hanging.q, hanging.qd, hanging.qdd).torque
    np.testing.assert_allclose(right, hanging.torque, atol=1e-7 * np.max(np.abs(hanging.torque)))
    assert np.max(np.abs(wrong - hanging.torque)) > 10.0  # gravity turned round


def test_validation_figures_follow_their_definitions():
    """rms, relative rms, r², e_N and the manufacturer's, recomputed from the residual on the filtered motion."""
    from monitor.identify.signals.motion import motion
    from monitor.model.regressor import regressor

    found, held_out = identify([recording(truth(UR5))], UR5, GROUND), recording(truth(UR5, seed=2), seed=2)
    figures = validate(found, held_out, UR5)
    moved = motion(held_out)
    measured = moved.current * UR5.drive_gain_nm_per_a
    residual = measured - predict_motion(found, UR5, moved).torque
    nominal = measured - regressor(UR5, GROUND, moved.q, moved.qd, moved.qdd) @ UR5.nominal_parameters()
    for j in range(6):
        on = np.abs(moved.qd[:, j]) > 0.02
        rms = np.sqrt(np.mean(residual[on, j] ** 2))
        assert figures.rms_nm[j] == pytest.approx(rms)
        assert figures.relative_rms[j] == pytest.approx(rms / np.sqrt(np.mean(measured[on, j] ** 2)))
        assert figures.r2[j] == pytest.approx(1.0 - rms**2 / np.var(measured[on, j]))
        assert figures.nominal_rms_nm[j] == pytest.approx(np.sqrt(np.mean(nominal[on, j] ** 2)))
        assert figures.rms_all_nm[j] == pytest.approx(np.sqrt(np.mean(residual[:, j] ** 2)))
    assert figures.normalised_error_nm == pytest.approx(np.sqrt(np.sum(residual**2)) / len(residual))
    assert np.all(figures.rms_nm < 0.2 * figures.nominal_rms_nm)  # friction alone is most of a wrist's torque


@pytest.mark.parametrize("friction", ["paper", "load"])
@pytest.mark.parametrize("method", ["ls", "wls"])
def test_a_joint_that_stands_still_has_no_friction_to_report(method, friction):
    """Its fc, fv and their standard deviations are NaN, there are warnings, and the other joints are as without it."""
    still = excitation(UR5)
    still = replace(still, a_rad_s=still.a_rad_s * [1, 1, 1, 1, 1, 0], b_rad_s=still.b_rad_s * [1, 1, 1, 1, 1, 0])
    t_s, (q, qd, qdd) = still.sampled(125.0)
    rigid = rigid_torque(UR5, GROUND, q, qd, qdd) + ROTOR_KG_M2 * qdd
    known = Truth(t_s, q, qd, qdd, rigid + COULOMB_NM * np.tanh(qd / 0.001) + VISCOUS * qd)
    options = IdentifyOptions(method=method, friction=friction)
    found = identify_motions([exact_motion(known)], [known.torque], UR5, GROUND, options)
    assert np.isnan(found.coulomb_nm[5])
    assert np.all(np.isnan(found.friction_cov[5]))
    np.testing.assert_allclose(found.coulomb_nm[:5], COULOMB_NM[:5], rtol=1e-7)
    np.testing.assert_allclose(found.viscous_nm_s_per_rad[:5], VISCOUS[:5], rtol=1e-7)
    assert {"not_excited", "joint_hardly_moves"} <= codes(found)
    assert np.all(np.isfinite(found.values))


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda rec: replace(rec, temperature_c=rec.temperature_c + np.linspace(0, 3, rec.samples)[:, None]), "temperature_drift"),
        (lambda rec: replace(rec, target_current=rec.current), "current_is_target"),
        (lambda rec: replace(rec, context=replace(rec.context, payload_kg=2.0)), "payload"),
        (lambda rec: replace(rec, current=-rec.current), "likely_cause"),
        (lambda rec: replace(rec, **{name: value[::4] for name, value in rec.signals.items()}), "low_rate"),
    ],
    ids=["warming", "simulator", "payload", "sign", "rate"],
)
@pytest.mark.slow
def test_every_circumstance_has_its_warning(change, code):
    """Each circumstance has its warning, and the undisturbed recording has none of them."""
    sound = recording(truth(UR5))
    assert code not in codes(identify([sound], UR5, GROUND))
    assert code in codes(identify([change(sound)], UR5, GROUND))


def test_what_does_not_fit_is_refused():
    """No gains and no torque constant, impossible gains, another robot, another method, no recording."""
    sound = recording(truth(UR5))
    with pytest.raises(BadInput, match=r"for this model nobody has published the torque constants.*--gains with 6 numbers"):
        identify([sound], load_robot("ur10e"), GROUND)
    with pytest.raises(BadInput, match=r"expected 6 numbers between"):
        identify([sound], UR5, GROUND, gains=np.array([1.0, 2.0]))
    with pytest.raises(BadInput, match=r"method 'magic' is not known; known are ls, wls"):
        identify([sound], UR5, GROUND, method="magic")
    with pytest.raises(BadInput, match=r"no recording was given"):
        identify([], UR5, GROUND)
    found = identify([sound], UR5, GROUND)
    with pytest.raises(BadInput, match=r"parameters are of ur5, the robot is ur3"):
        predict_torque(found, load_robot("ur3"), sound.q, sound.qd, sound.qd)


def test_measured_torque_needs_no_gains():
    """A recording of joint torque identifies as one of current does, to 1e-9: only the unit's origin differs."""
    sound = recording(truth(UR5))
    as_torque = replace(sound, current=None, torque=sound.current * UR5.drive_gain_nm_per_a)
    np.testing.assert_allclose(identify([as_torque], UR5, GROUND).values, identify([sound], UR5, GROUND).values, atol=1e-9)


def test_a_recording_of_another_model_is_refused():
    """A UR3's file given as a UR5's would give a plausible but wrong result: the message gives both names."""
    measured = recording(truth(UR5, GROUND))
    other = replace(measured, context=replace(measured.context, robot="ur3"))
    with pytest.raises(BadInput, match="recorded on a ur3; the robot given is ur5"):
        identify([other], UR5, GROUND)


def test_one_of_the_samples_that_the_filter_leaves_says_as_much_as_all(monkeypatch):
    """At 125 Hz behind a filter of 8 Hz every third sample gives the standard deviations of all, to less than their own doubt."""
    known = recording(truth(UR5))
    thinned = identify([known], UR5, GROUND)
    monkeypatch.setattr(Motion, "redundancy", 1)
    whole = identify([known], UR5, GROUND)
    np.testing.assert_array_equal(thinned.values, whole.values)
    ratio = np.sqrt(np.diag(thinned.covariance) / np.diag(whole.covariance))
    assert np.max(np.abs(ratio - 1.0)) < 0.1
    assert abs(np.mean(ratio) - 1.0) < 0.02
    assert not np.array_equal(thinned.covariance, whole.covariance)
