"""The regressor against pinocchio, which is independent of it."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.errors import BadInput
from monitor.model.friction import PAPER
from monitor.model.regressor import friction_columns, parameter_names, regressor
from monitor.model.robot import PER_JOINT, Mounting, Robot, load_robot, robot_names


def any_robot(rng: np.random.Generator, name: str) -> Robot:
    """A serial arm with six joints and nothing else in common with those we know."""
    root = rng.normal(size=(6, 3, 3)) * 0.2
    return replace(
        load_robot(name),
        a_m=rng.uniform(-1, 1, 6),
        d_m=rng.uniform(-1, 1, 6),
        alpha_rad=rng.uniform(-np.pi, np.pi, 6),
        mass_kg=rng.uniform(0.1, 10, 6),
        com_m=rng.uniform(-0.5, 0.5, (6, 3)),
        inertia_kg_m2=root @ root.transpose(0, 2, 1),
    )


def newton_euler(robot: Robot, mounting: Mounting, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    model = robot.pinocchio_model(mounting)
    data = model.createData()
    return np.array([pin.rnea(model, data, *state).copy() for state in zip(q, qd, qdd, strict=True)])


angles = st.floats(-np.pi, np.pi)


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(robot_names()), mounting=st.tuples(angles, angles, angles), known=st.booleans())
@settings(max_examples=60)
def test_regressor_times_parameters_is_newton_euler_plus_friction_plus_rotors(seed, name, mounting, known):
    """For every arm, mounting and motion, to 1e-10 of the largest torque (rounding of some hundred operations is 1e-13)."""
    rng = np.random.default_rng(seed)
    robot = load_robot(name) if known else any_robot(rng, name)
    attitude = Mounting(roll_rad=mounting[0], pitch_rad=mounting[1], yaw_rad=mounting[2])
    q, qd, qdd = rng.uniform(-4, 4, (3, 7, 6))
    fc, fv, rotor = rng.uniform(0, 10, (3, 6))
    parameters = robot.nominal_parameters(with_inertia=True).reshape(6, PER_JOINT)
    parameters[:, 10:] = np.stack([fc, fv, rotor], axis=1)
    expected = newton_euler(robot, attitude, q, qd, qdd) + fc * np.tanh(qd / 0.001) + fv * qd + rotor * qdd
    torque = regressor(robot, attitude, q, qd, qdd) @ parameters.ravel()
    assert np.max(np.abs(torque - expected)) <= 1e-10 * np.max(np.abs(expected))


def test_masses_and_centres_alone_give_the_torque_at_rest():
    """At rest the tensors have no effect: the nominal parameters give pinocchio's gravity torque on every mounting."""
    robot = load_robot("ur5e")
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (20, 6))
    still = np.zeros_like(q)
    for name in ("ground", "ceiling", "wall", "20,-35,80"):
        mounting = Mounting.parse(name)
        torque = regressor(robot, mounting, q, still, still) @ robot.nominal_parameters()
        # published centres of mass, tensors left out; 1e-10 N·m is rounding of torques of 60 N·m
        np.testing.assert_allclose(torque, newton_euler(robot, mounting, q, still, still), atol=1e-10)


def test_links_inward_of_a_joint_have_no_torque_on_it():
    """Y is upper block-triangular, so per-joint factors may leave the lower half out."""
    rng = np.random.default_rng(1)
    Y = regressor(load_robot("ur3"), Mounting(roll_rad=0.3), *rng.normal(size=(3, 5, 6)))
    for j in range(1, 6):
        assert not np.any(Y[:, j, : PER_JOINT * j])
        assert np.all(np.any(Y[:, j, PER_JOINT * j :] != 0.0, axis=1))


def test_prediction_and_regressor_share_one_friction():
    """The torque of the paper's law is the fc and fv columns of Y times fc and fv, bit for bit but for the order of summation (1e-12)."""
    rng = np.random.default_rng(2)
    robot = load_robot("ur5")
    q, qd, qdd = rng.normal(size=(3, 9, 6)) * 0.01  # some within the smooth sign's width
    fc, fv = rng.uniform(1, 9, (2, 6))
    parameters = np.zeros(78)
    coulomb, viscous = friction_columns(6)
    parameters[coulomb], parameters[viscous] = fc, fv
    np.testing.assert_allclose(
        regressor(robot, Mounting(), q, qd, qdd) @ parameters, PAPER.torque(np.stack([fc, fv], axis=1), qd), atol=1e-12
    )


def test_columns_are_named_as_in_the_paper():
    """Thirteen names a joint, friction and rotor last."""
    names = parameter_names(2)
    assert names[:13] == ("m1", "m1x1", "m1y1", "m1z1", "J1xx", "J1xy", "J1xz", "J1yy", "J1yz", "J1zz", "fc1", "fv1", "Im1")
    assert names[13 + friction_columns(1)[0][0]] == "fc2"


@pytest.mark.parametrize("shapes", [((5, 5),) * 3, ((5, 6), (4, 6), (5, 6)), ((6,),) * 3])
def test_motion_of_another_shape_is_refused(shapes):
    """The message says what came and what was expected."""
    with pytest.raises(BadInput, match=r"expected \(samples, 6\)"):
        regressor(load_robot("ur5"), Mounting(), *(np.zeros(shape) for shape in shapes))
