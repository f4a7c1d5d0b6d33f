"""The temperature-compensated torque model: it equals the laws that it is made of, and marks where they are extrapolated."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_arm import COULOMB_NM, Arm, History

from monitor.errors import BadInput
from monitor.judge.temperature.curves import Curve
from monitor.judge.torque.model import CompensatedModel, ResidualFriction, model_from_document
from monitor.judge.torque.predictor import predict_torque, predictor_for
from monitor.model.robot import load_robot

UR5 = load_robot("ur5")
RNG = np.random.default_rng(0)
Q, QDD = RNG.uniform(-2, 2, (20, 6)), RNG.uniform(-3, 3, (20, 6))
QD = RNG.choice([-1.0, 1.0], (20, 6)) * RNG.uniform(0.1, 1.5, (20, 6))  # at rest the sign of friction is a matter of smoothing


@pytest.fixture(scope="module")
def model() -> CompensatedModel:
    """The model after 60 replays between 20 and 40 °C, with 1 % of noise and no wear."""
    history, rng = History(), np.random.default_rng(1)
    arm = Arm(seed=1, noise=0.01)
    for day in range(60):
        history.add(day, arm.replay(rng.uniform(20, 40)))
    return history.last.model


def true_friction(qd: np.ndarray, temperature_c: float) -> np.ndarray:
    return COULOMB_NM * np.sign(qd) + Arm().viscous * np.exp(-0.015 * (temperature_c - 25.0)) * qd


def test_the_rigid_part_is_newton_euler(model):
    """With the manufacturer's masses it equals pinocchio's inverse dynamics at rest."""
    import pinocchio as pin

    robot = UR5.pinocchio_model()
    for inertia in robot.inertias[1:]:
        inertia.inertia = np.zeros((3, 3))
    data = robot.createData()
    still = np.zeros((20, 6))
    predicted = predict_torque(model, UR5, Q, still, still)
    expected = np.array([pin.computeGeneralizedGravity(robot, data, q) for q in Q])
    assert np.allclose(predicted.rigid, expected, atol=1e-9)  # rounding
    assert np.allclose(predicted.friction, 0.0)
    assert np.allclose(predicted.torque, predicted.rigid + predicted.friction)


@pytest.mark.parametrize("temperature_c", [20.0, 30.0, 40.0])
def test_friction_follows_temperature_within_what_was_learnt(model, temperature_c):
    """Within 4 % of the true friction: a straight line through an exponential over 20 K has an error of 1 %, the rest is noise."""
    predicted = predict_torque(model, UR5, Q, QD, QDD, np.full(6, temperature_c))
    truth = true_friction(QD, temperature_c)
    assert np.all(np.abs(predicted.friction - truth) < 0.04 * np.abs(truth))
    assert not predicted.extrapolated.any()


def test_torque_is_predicted_by_the_selected_temperature_law(model):
    """Where fv(T) is a curve, torque and standard deviation are those of the curve and not of the straight line beside it."""
    assert set(model.viscous.law) != {"linear"}
    for T in (np.full(6, 20.0), np.full(6, 30.0), np.linspace(38, 43, 6)):
        predicted = predict_torque(model, UR5, Q, QD, QDD, T)
        fc, fv = model.coulomb_at(T), model.viscous_at(T)
        assert np.allclose(predicted.friction, fc.value * np.sign(QD) + fv.value * QD)  # |q̇| > 0.1: the sign is ± 1
        between = 2.0 * model.friction_correlation * fc.std * fv.std * np.abs(QD)
        var = fc.std**2 + (fv.std * QD) ** 2 + between + (predicted.friction * model.wear_std) ** 2
        assert np.allclose(predicted.std**2, var + (model.residual_rms_nm if model.error_rms_nm is None else model.error_rms_nm) ** 2)


def test_temperature_correction_reduces_the_error_of_friction_to_a_third(model):
    """Over 20–40 °C the error is below a third of the error of friction at the reference temperature."""
    errors = {True: [], False: []}
    for T in (20.0, 24.0, 36.0, 40.0):
        for corrected, found in errors.items():
            predicted = predict_torque(model, UR5, Q, QD, QDD, np.full(6, T) if corrected else None)
            found.append(predicted.friction - true_friction(QD, T))
    rms = {corrected: np.sqrt(np.mean(np.square(found), axis=(0, 1))) for corrected, found in errors.items()}
    assert np.all(rms[True] < rms[False] / 3)


def test_beyond_the_learnt_temperatures_the_prediction_is_marked_and_less_certain(model):
    """At 60 °C the standard deviation is larger than at 30 °C. Each joint has its own temperature."""
    outside = predict_torque(model, UR5, Q, QD, QDD, np.array([60.0, 30, 30, 30, 30, 30]))
    assert outside.extrapolated[:, 0].all()
    assert not outside.extrapolated[:, 1:].any()
    warm, hot = model.viscous_at(np.full(6, 30.0)), model.viscous_at(np.full(6, 60.0))
    assert np.all(hot.std > 2 * warm.std)
    assert hot.extrapolated.all()
    assert not warm.extrapolated.any()


def test_present_wear_is_in_the_prediction(model):
    """10 % of wear is 10 % more friction, and its standard deviation widens that of the prediction."""
    worn = replace(model, wear=model.wear + np.log(1.1), wear_std=np.full(6, 0.05))
    before, after = (predict_torque(m, UR5, Q, QD, QDD) for m in (model, worn))
    assert np.allclose(after.friction, 1.1 * before.friction)
    assert np.allclose(after.rigid, before.rigid)
    assert np.all(after.std > before.std)


def test_one_sample_and_a_temperature_for_each_sample_are_accepted(model):
    """(6,) for one state; with (N, 6) temperatures every row equals the prediction of that row alone."""
    T = np.linspace(20, 40, 20)[:, None] * np.ones(6)
    every = predict_torque(model, UR5, Q, QD, QDD, T)
    one = predict_torque(model, UR5, Q[7], QD[7], QDD[7], T[7])
    assert one.torque.shape == (1, 6)
    assert np.allclose(one.torque[0], every.torque[7])


def test_a_joint_that_was_never_identified_has_no_standard_deviation():
    """Its torque is predicted without friction, marked as extrapolated, with an unknown std; the other joints are unaffected."""
    seen = Arm().replay(30.0)
    fc = np.where(np.arange(6) == 5, np.nan, seen.coulomb_nm)
    last = History().add(0, replace(seen, coulomb_nm=fc, viscous_nm_s_per_rad=np.where(np.isnan(fc), np.nan, seen.viscous_nm_s_per_rad)))
    predicted = predict_torque(last.model, UR5, Q, QD, QDD)
    assert np.all(predicted.friction[:, 5] == 0)
    assert np.all(np.isnan(predicted.std[:, 5]))
    assert predicted.extrapolated[:, 5].all()
    assert np.all(np.isfinite(predicted.torque))
    assert np.all(np.isfinite(predicted.std[:, :5]))
    assert last.friction[5].coulomb_nm is None


def test_the_model_survives_as_json(model):
    """The model of the published document predicts the same torque to the last bit."""
    back = model_from_document(json.loads(json.dumps(model.as_document(), allow_nan=False)))
    here, there = (predict_torque(m, UR5, Q, QD, QDD, np.full(6, 33.0)) for m in (model, back))
    assert all(np.array_equal(a, b) for a, b in zip(here, there, strict=True))
    with pytest.raises(BadInput, match="'values' is missing"):
        model_from_document({key: value for key, value in model.as_document().items() if key != "values"})


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [("kind", 3.0, "kind is .*expected 0, 1 or 2"), ("kind", None, "kind is .*expected 0, 1 or 2"), ("a", None, "a is unknown of a joint")],
)
def test_a_document_of_an_unknown_law_is_refused(curved, key, value, says):
    """It is refused when it is read."""
    document = json.loads(json.dumps(curved.as_document(), allow_nan=False))
    document["viscous"]["curve"][key][1] = value
    with pytest.raises(BadInput, match=f"model: viscous: curve: {says}"):
        model_from_document(document)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"robot": load_robot("ur3")}, "of ur5, the robot is ur3"),
        ({"qd": QD[:3]}, "qd has shape"),
        ({"q": Q[:, :5]}, "q has shape"),
        ({"temperature_c": np.full(5, 30.0)}, "temperature_c has shape"),
        ({"qdd": np.full((20, 6), np.nan)}, "qdd holds values that are not finite"),
    ],
)
def test_arguments_that_do_not_fit_are_refused_by_name(model, change, says):
    """The message names the argument whose shape or value is wrong, or the robot."""
    asked = {"robot": UR5, "q": Q, "qd": QD, "qdd": QDD, "temperature_c": None, **change}
    with pytest.raises(BadInput, match=says):
        predict_torque(model, **asked)


@pytest.fixture(scope="module")
def with_residual_friction(model) -> CompensatedModel:
    """The same model with residual friction; that of one joint is so negative that friction alone would drive it."""
    terms = np.tile([-2.0, -3.0, 0.05, 5.5], (6, 1))
    terms[3] = [-50.0, -50.0, 0.0, 0.0]
    beyond = ResidualFriction(
        law_name="concave", terms=terms, temperature_c=np.full(6, 25.0), speed_rad_s=np.full(6, 1.0), load_nm=np.full(6, 40.0)
    )
    return replace(model, residual_friction=beyond)


@pytest.fixture(scope="module")
def curved(with_residual_friction) -> CompensatedModel:
    """The same model with a straight line, an exponential and Vogel's law, for both fc and fv."""
    kind = np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0])

    def by(line, fall):
        vogel, none = kind == 2, np.zeros(6)
        a, b = np.where(kind > 0, np.log(line.intercept), none), np.where(vogel, 800.0, -fall) * (kind > 0)
        cov = np.tile([[1e-4, -2e-6], [-2e-6, 1e-6]], (6, 1, 1))
        return replace(line, curve=Curve(kind, a, b, np.where(vogel, -100.0, none), line.reference_c, cov, np.zeros((6, 3))))

    return replace(
        with_residual_friction, coulomb=by(with_residual_friction.coulomb, 0.003), viscous=by(with_residual_friction.viscous, 0.016)
    )


@settings(max_examples=50, deadline=None)
@given(
    qd=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
    qdd=st.lists(st.floats(-9.0, 9.0), min_size=6, max_size=6),
    temperature_c=st.floats(-20.0, 90.0),
)
def test_friction_never_drives_and_one_sample_is_predicted_as_many_are(with_residual_friction, curved, qd, qdd, temperature_c):
    """The power of friction is ≥ 0 at any speed, load and temperature; `torque` and `sample` agree to rounding in every field."""
    v, a, T = np.array(qd), np.array(qdd), np.full(6, temperature_c)
    for model in (with_residual_friction, curved):
        many = predict_torque(model, UR5, Q[0], v, a, T)
        one = predictor_for(model, UR5).sample(Q[0].tolist(), qd, qdd, T.tolist())
        assert np.all(many.friction * v >= 0.0)
        for name in one._fields:
            assert np.allclose(getattr(many, name)[0], getattr(one, name), rtol=1e-9, atol=1e-9), name


def test_a_reader_of_the_document_alone_finds_the_same_friction(curved):
    """By the formula of the documentation: line, exponential and Vogel's law, wear included."""
    model = replace(curved, residual_friction=None, wear=np.linspace(0.0, 0.1, 6))
    document, T = json.loads(json.dumps(model.as_document(), allow_nan=False)), 31.0

    def value(law, j):
        curve, t = law["curve"], T - law["reference_c"][j]
        if curve["kind"][j] == 0:
            return law["intercept"][j] + law["slope"][j] * t
        pole, reference = curve["pole_c"][j], curve["reference_c"][j]
        x = t if curve["kind"][j] == 1 else 1.0 / (T - pole) - 1.0 / (reference - pole)
        return np.exp(curve["a"][j] + curve["b"][j] * x)

    predicted = predict_torque(model, UR5, Q, QD, QDD, np.full(6, T)).friction
    for j in range(6):
        fresh = value(document["coulomb"], j) * np.sign(QD[:, j]) + value(document["viscous"], j) * QD[:, j]
        assert np.allclose(predicted[:, j], fresh * np.exp(document["wear"][j]))


def test_residual_friction_keeps_its_value_beyond_the_largest_speed_of_the_fit(model, with_residual_friction):
    """Beyond 1 rad/s and beyond 40 N·m the difference to the model without it is constant, also after a way through JSON."""
    still, T = np.zeros(6), np.full(6, 25.0)
    at = [
        predict_torque(m, UR5, Q[0], np.full(6, v), still, T).friction - predict_torque(model, UR5, Q[0], np.full(6, v), still, T).friction
        for m in (
            with_residual_friction,
            model_from_document(json.loads(json.dumps(with_residual_friction.as_document(), allow_nan=False))),
        )
        for v in (1.0, 2.5)
    ]
    kept = np.arange(6) != 3  # the clamped one
    assert np.allclose(at[0][0, :3], at[2][0, :3])
    assert np.array_equal(at[1], at[3])
    assert np.all(np.abs(at[0][0, kept]) > 0.0)
    flat = [
        predict_torque(m, UR5, np.tile(Q[0], (2, 1)), np.array([[1.0] * 6, [2.5] * 6]), np.zeros((2, 6)), T).rigid
        for m in (with_residual_friction, model)
    ]
    assert np.array_equal(*flat)
    # at one state the rigid torque also depends on speed, so the load term alone is bounded by its largest load
    assert np.all(np.abs(at[1] - at[0])[0, kept] <= 0.05 * 40.0 + 1e-9)
