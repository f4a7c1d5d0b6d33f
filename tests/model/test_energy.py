"""Kinetic energy against pinocchio, its uncertainty against random draws, and the comparison with a limit by hand."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.errors import BadInput
from monitor.model.base import base_parameters
from monitor.model.energy import BodyRegion, Energy, compare, effective_mass_kg, energy_document, flange_speed, kinetic_energy
from monitor.model.robot import PER_JOINT, Mounting, load_robot

UR5 = load_robot("ur5")
ROTOR_KG_M2 = np.array([1.9, 1.9, 1.9, 0.35, 0.35, 0.35])


def base_values(robot, base):
    standard = robot.nominal_parameters(with_inertia=True).reshape(6, PER_JOINT)
    standard[:, 10:] = np.stack([np.full(6, 8.0), np.full(6, 11.0), ROTOR_KG_M2], axis=1)
    return base.combination @ standard.ravel()


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["ur3", "ur5", "ur10e", "ur20"]), place=st.sampled_from(["ground", "wall"]))
@settings(max_examples=20)
def test_energy_equals_that_of_pinocchio_with_rotors_and_without_friction(seed, name, place):
    """Base parameters of either count give ½ q̇ᵀMq̇ + ½ Im q̇² to 1e-10: rounding; friction has no part in it."""
    robot = load_robot(name)
    base = base_parameters(robot, Mounting.parse(place))
    q, qd = np.random.default_rng(seed).uniform(-3, 3, (2, 5, 6))
    model = robot.pinocchio_model()
    data = model.createData()
    expected = [pin.computeKineticEnergy(model, data, *state) + 0.5 * ROTOR_KG_M2 @ state[1] ** 2 for state in zip(q, qd, strict=True)]
    found = kinetic_energy(robot, q, qd, base.columns, base_values(robot, base), np.zeros((base.count, base.count)))
    np.testing.assert_allclose(found.mean, expected, rtol=1e-10)
    assert np.all(found.std == 0.0)


@pytest.mark.soak
def test_its_uncertainty_is_that_of_the_parameters():
    """The spread of energies from 1000 draws of the parameters: 9 %, four standard errors of a spread from so many."""
    base = base_parameters(UR5, Mounting())
    rng = np.random.default_rng(1)
    half = 0.01 * rng.normal(size=(base.count, base.count))
    covariance, values = half @ half.T, base_values(UR5, base)
    q, qd = rng.uniform(-2, 2, (2, 8, 6))
    found = kinetic_energy(UR5, q, qd, base.columns, values, covariance)
    draws = [
        kinetic_energy(UR5, q, qd, base.columns, value, covariance).mean for value in rng.multivariate_normal(values, covariance, size=1000)
    ]
    np.testing.assert_allclose(np.std(draws, axis=0), found.std, rtol=0.09)


def test_a_parameter_without_excitation_makes_its_energy_unknown():
    """NaN where joint 6 moves, a figure where it stands still."""
    base = base_parameters(UR5, Mounting())
    covariance = 1e-6 * np.eye(base.count)
    covariance[base.names.index("Im6")] = np.nan
    covariance[:, base.names.index("Im6")] = np.nan
    q, qd = np.zeros((2, 6)), np.full((2, 6), 0.5)
    qd[1, 5] = 0.0
    std = kinetic_energy(UR5, q, qd, base.columns, base_values(UR5, base), covariance).std
    assert np.isnan(std[0])
    assert std[1] > 0.0


def test_flange_speed_equals_that_of_pinocchio():
    """Speed of the frame that pinocchio carries for the last DH frame, to rounding."""
    q, qd = np.random.default_rng(2).uniform(-3, 3, (2, 10, 6))
    model = UR5.pinocchio_model()
    data = model.createData()
    frame = model.getFrameId("dh_6")
    for state, found in zip(zip(q, qd, strict=True), flange_speed(UR5, q, qd), strict=True):
        pin.forwardKinematics(model, data, *state)
        assert found == pytest.approx(np.linalg.norm(pin.getFrameVelocity(model, data, frame).linear), rel=1e-12)


def test_transfer_energy_is_that_of_two_bodies():
    """m_R = M/2 + m_L, μ = (1/m_H + 1/m_R)⁻¹, E = ½μv²; a region that cannot move away gives m_R alone."""
    m_R = effective_mass_kg(UR5, 2.0)
    assert m_R == pytest.approx(0.5 * (3.7 + 8.393 + 2.33 + 1.219 + 1.219 + 0.1879) + 2.0)
    speed, still = np.array([0.0, 0.25, 1.0]), Energy(np.zeros(3), np.zeros(3))
    hand = compare(BodyRegion.parse("hand=0.1@0.6"), speed, m_R, still)
    assert hand.transfer_j == pytest.approx(0.5 * 0.6 * m_R / (0.6 + m_R) * speed**2)
    assert (hand.transfer_below, hand.arm_below, hand.worst_sample) == (False, True, 2)
    assert hand.share_above == pytest.approx(1 / 3)
    clamped = compare(BodyRegion.parse("hand=0.1"), speed, m_R, still)
    assert clamped.transfer_j == pytest.approx(0.5 * m_R * speed**2)


def test_the_whole_arm_is_compared_at_its_upper_95_percent():
    """A limit between mean and upper bound does not count as kept; without an uncertainty there is no verdict."""
    speed, region = np.zeros(2), BodyRegion(name="chest", limit_j=1.1)
    assert compare(region, speed, 10.0, Energy(np.array([0.1, 1.0]), np.array([0.0, 0.05]))).arm_below is True
    assert compare(region, speed, 10.0, Energy(np.array([0.1, 1.0]), np.array([0.0, 0.1]))).arm_below is False
    assert compare(region, speed, 10.0, Energy(np.array([0.1, 1.0]), np.array([0.0, np.nan]))).arm_below is None


@pytest.mark.parametrize("text", ["hand", "hand=", "=1", "hand=-1", "hand=1@0", "hand=nan", "hand=1@x", "hand=inf", ""])
def test_an_invalid_limit_is_refused(text):
    """A sentence that shows what would be right."""
    with pytest.raises(BadInput, match="expected REGION=JOULES"):
        BodyRegion.parse(text)


def test_unknown_masses_give_no_effective_mass():
    """A negative payload is refused too."""
    from dataclasses import replace

    with pytest.raises(BadInput, match="not published"):
        effective_mass_kg(replace(UR5, mass_kg=np.full(6, np.nan)), 0.0)
    with pytest.raises(BadInput, match="expected 0 or more"):
        effective_mass_kg(UR5, -1.0)


def test_the_document_states_that_it_is_no_safety_function():
    """Plain numbers, null for unknown, at most 500 points, and the statement that this is no safety function."""
    import json

    t_s = np.linspace(0.0, 10.0, 1251)
    energy = Energy(np.sin(t_s) ** 2, np.full(1251, np.nan))
    document = energy_document(UR5, t_s, energy, np.abs(np.sin(t_s)), [BodyRegion.parse("hand=0.5@0.6")], 0.0)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert len(document["series"]["time_s"]) <= 500
    assert document["kinetic_energy_j"]["std_at_max"] is None
    assert document["regions"][0]["whole_arm_below_limit"] is None
    assert "not a safety function" in document["statement"]
