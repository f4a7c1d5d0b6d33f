"""Physically consistent arms: their residual, and that other programs load them."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from oracle_arm import COULOMB_NM, GROUND, ROTOR_KG_M2, VISCOUS, truth
from scipy.optimize import lsq_linear

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.fit.least_squares import Rows, factors, residual_rms, solve
from monitor.identify.fit.physically_consistent import PhysicallyConsistentArm, physically_consistent
from monitor.identify.signals.arm import joint_torque
from monitor.identify.signals.motion import motion
from monitor.model.base import base_parameters
from monitor.model.fourier import excitation_from_document
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import PER_JOINT, Mounting, load_robot, robot_from_document
from monitor.model.urdf import robot_from_urdf_text
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import read_recording

ROOT = Path(__file__).parents[2]
COLUMNS = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
GAINS = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])  # of that arm's authors [N·m/A]


def fitted(robot, mounting, recordings, gains=None):
    """Factors and weights of a WLS with the paper's friction, as identify makes them."""
    base = base_parameters(robot, mounting)
    rows = []
    for recording in recordings:
        moved = motion(recording)
        Y = regressor(robot, mounting, moved.q, moved.qd, moved.qdd)
        Y[:, np.arange(robot.joints), friction_columns(robot.joints)[0]] = moved.direction
        rows.append(
            Rows(Y[:, :, list(base.columns)], joint_torque(moved, robot, gains), moved.moving(), moved.blocks(0.8 / 6), moved.segments)
        )
    joints, weights = factors(rows), np.ones(robot.joints)
    for _ in range(3):
        free = solve(joints, weights, base.combination @ robot.nominal_parameters())
        weights = 1.0 / residual_rms(joints, free.values)
    return joints, weights, base


def is_physical(found: PhysicallyConsistentArm):
    """Every tensor about its centre of mass is that of a mass distribution, every mass is positive, and friction opposes motion."""
    for J in found.robot.inertia_kg_m2:
        assert np.linalg.eigvalsh(0.5 * np.trace(J) * np.eye(3) - J)[0] > 0.0
    assert np.all(found.robot.mass_kg > 0.0)
    for values in (found.coulomb_nm, found.viscous_nm_s_per_rad, found.rotor_kg_m2):
        assert np.all(values >= -1e-6)  # the solver's feasibility


def loads(found: PhysicallyConsistentArm):
    """URDF and TOML give back the parameters to 1e-9, and pinocchio a positive definite mass matrix wherever the arm stands."""
    rigid = np.ones(len(found.parameters), dtype=bool)
    for kind in range(10, PER_JOINT):
        rigid[kind::PER_JOINT] = False
    np.testing.assert_allclose(found.robot.nominal_parameters(with_inertia=True)[rigid], found.parameters[rigid], rtol=1e-9, atol=1e-12)
    document = tomllib.loads(found.toml())
    again = robot_from_document(document)
    np.testing.assert_array_equal(again.nominal_parameters(with_inertia=True), found.robot.nominal_parameters(with_inertia=True))
    np.testing.assert_array_equal(document["joints"]["rotor_kg_m2"], found.rotor_kg_m2)
    from_urdf = pin.buildModelFromXML(found.urdf())
    np.testing.assert_allclose(from_urdf.friction, found.coulomb_nm, atol=1e-9)
    np.testing.assert_allclose(from_urdf.damping, found.viscous_nm_s_per_rad, atol=1e-9)
    rng = np.random.default_rng(0)
    for armature in (np.zeros(found.robot.joints), found.rotor_kg_m2):
        for model in (from_urdf, again.pinocchio_model()):
            model.armature = np.maximum(armature, 0.0)
            data = model.createData()
            for q in rng.uniform(-np.pi, np.pi, (1000, model.nq)):
                M = np.triu(pin.crba(model, data, q))
                M = M + np.triu(M, 1).T
                assert np.linalg.eigvalsh(M)[0] > 0.0
    J = found.robot.joints
    q, qd, qdd = rng.uniform(-3.0, 3.0, (3, 20, J))
    by_parameters = regressor(found.robot, GROUND, q, qd, qdd) @ np.where(rigid, found.parameters, 0.0)
    from_urdf.armature = np.zeros(J)
    from_urdf.gravity = pin.Motion(np.append(GROUND.gravity_in_base, np.zeros(3)))
    data = from_urdf.createData()
    torque = np.array([pin.rnea(from_urdf, data, *state).copy() for state in zip(q, qd, qdd, strict=True)])
    np.testing.assert_allclose(torque, by_parameters, atol=1e-9 * np.max(np.abs(torque)))
    read = robot_from_urdf_text(found.urdf())
    np.testing.assert_allclose(read.mass_kg, found.robot.mass_kg, rtol=1e-9)
    np.testing.assert_allclose(read.base_rotation, np.eye(3), atol=1e-15)


def test_ur10e_fits_within_2_percent_of_the_unconstrained_fit(real_data):
    """Three runs of a real UR10e: weighted RMS residual at most 2 % above unconstrained; the arm loads everywhere."""
    robot = load_robot("ur10e")
    for name in ("ur-20_02_12-50sec_12harm.csv", "ur-20_02_10-30sec_12harm.csv", "ur-20_02_19_14harm50sec.csv"):
        joints, weights, base = fitted(robot, GROUND, [read_recording(real_data / "ur10e" / name, COLUMNS)], GAINS)
        found = physically_consistent(joints, weights, base.combination, robot)
        print(name, "residual ratio", round(found.residual_ratio, 4), "masses", found.robot.mass_kg.round(2))
        assert 1.0 <= found.residual_ratio <= 1.02
        is_physical(found)
    loads(found)


@pytest.mark.slow
def test_a_simulated_replay_fits_within_2_percent(ur5_replay):
    """The simulator's friction is none of the laws, so there is misfit, but not by the constraints."""
    joints, weights, base = fitted(load_robot("ur5"), GROUND, [ur5_replay])
    found = physically_consistent(joints, weights, base.combination, load_robot("ur5"))
    print("residual ratio", found.residual_ratio)
    assert 1.0 <= found.residual_ratio <= 1.02
    is_physical(found)
    loads(found)


@pytest.fixture(scope="module")
def ur5_replay():
    excitation = excitation_from_document(json.loads((ROOT / "config" / "excitation" / "ur5-ground.json").read_text()))
    return stepped_replay(Controller(SimulateSettings(robot="ur5", seed=3)), replace(excitation, repetitions=1))


def exact(robot, mounting, noise_nm=0.0, **shape):
    """Factors without filter, of an arm that has the manufacturer's inertias and our friction and rotors."""
    known = truth(robot, mounting, **shape)
    torque = known.torque + noise_nm * np.random.default_rng(0).normal(size=known.torque.shape)
    base = base_parameters(robot, mounting)
    Y = regressor(robot, mounting, known.q, known.qd, known.qdd)[:, :, list(base.columns)]
    joints = factors([Rows(Y, torque, np.ones(known.q.shape, dtype=bool), np.arange(len(Y)), np.zeros(len(Y), dtype=int))])
    return joints, base


@pytest.mark.parametrize("name", ["ur3", "ur10e"])
def test_the_parameters_of_a_physical_arm_are_found(name):
    """Without noise: base parameters to 1e-3 of the largest (the solver's gap, 1e-8 of the squares), fc, fv as known."""
    robot = load_robot(name)
    mounting = Mounting.parse("wall")
    joints, base = exact(robot, mounting)
    found = physically_consistent(joints, np.ones(6), base.combination, robot)
    standard = robot.nominal_parameters(with_inertia=True).reshape(6, PER_JOINT)
    standard[:, 10:] = np.stack([COULOMB_NM, VISCOUS, ROTOR_KG_M2], axis=1)
    expected = base.combination @ standard.ravel()
    assert np.max(np.abs(found.values - expected)) < 1e-3 * np.max(np.abs(expected))
    np.testing.assert_allclose(found.coulomb_nm, COULOMB_NM, rtol=1e-2)
    is_physical(found)


def test_constraints_bind_where_least_squares_is_not_physical():
    """Torque of negative rotor inertia and driving friction: the fit refuses both, and its residual shows the price."""
    robot = load_robot("ur5")
    known = truth(robot)
    base = base_parameters(robot, GROUND)
    Y = regressor(robot, GROUND, known.q, known.qd, known.qdd)[:, :, list(base.columns)]
    torque = known.torque - 20.0 * known.qd  # fv − 20: negative on every joint
    torque += 0.1 * np.random.default_rng(0).normal(size=torque.shape)
    joints = factors([Rows(Y, torque, np.ones(known.q.shape, dtype=bool), np.arange(len(Y)), np.zeros(len(Y), dtype=int))])
    free = solve(joints, np.ones(6), np.zeros(base.count))
    assert np.all(free.values[np.searchsorted(base.columns, friction_columns(6)[1])] < 0.0)
    found = physically_consistent(joints, np.ones(6), base.combination, robot)
    is_physical(found)
    np.testing.assert_allclose(found.viscous_nm_s_per_rad, 0.0, atol=1e-3)
    assert found.residual_ratio > 1.5


def test_further_friction_parameters_are_kept_and_not_negative():
    """Two columns beyond the paper's, one of which the data want negative: it stays at zero, the other as bounded least squares has it.

    To 1e-2: scipy has the bounds, but not the constraints of rigid bodies.
    """
    robot = load_robot("ur5")
    known = truth(robot)
    base = base_parameters(robot, GROUND)
    Y = regressor(robot, GROUND, known.q, known.qd, known.qdd)[:, :, list(base.columns)]
    extra = np.zeros((*known.q.shape, 2))
    extra[:, 0, 0], extra[:, 1, 1] = np.sin(3 * known.q[:, 0]), np.cos(5 * known.q[:, 1])
    torque = known.torque + extra @ np.array([0.7, -0.4])
    every = np.ones(known.q.shape, dtype=bool)
    joints = factors([Rows(np.concatenate([Y, extra], axis=2), torque, every, np.arange(len(Y)), np.zeros(len(Y), dtype=int))])
    combination = np.zeros((base.count + 2, 80))
    combination[: base.count, :78], combination[base.count :, 78:] = base.combination, np.eye(2)
    found = physically_consistent(joints, np.ones(6), combination, robot)
    A = np.concatenate([factor.R for factor in joints])
    least = np.append(np.full(base.count, -np.inf), [0.0, 0.0])
    bounded = lsq_linear(A[:, :-1], A[:, -1], bounds=(least, np.inf)).x
    np.testing.assert_allclose(found.extra, bounded[-2:], atol=1e-2)
    assert bounded[-2] > 0.6
    assert abs(found.extra[1]) < 1e-6


def test_impossible_bounds_and_shapes_are_refused(monkeypatch):
    """Bounds that cross, and shapes that do not fit."""
    monkeypatch.setattr("monitor.identify.fit.physically_consistent.MASS_FACTOR", (2.0, 1.0))
    robot = load_robot("ur5")
    joints, base = exact(robot, GROUND, rate_hz=25.0)
    with pytest.raises(Unidentifiable, match="no physical arm was found"):
        physically_consistent(joints, np.ones(6), base.combination, robot)
    with pytest.raises(BadInput, match="do not fit"):
        physically_consistent(joints, np.ones(5), base.combination, robot)


def test_an_arm_without_published_masses_is_identified_too():
    """Unpublished masses and limits: the bounds depend on size alone, and the residual stays within 2 %."""
    robot = load_robot("ur5")
    joints, base = exact(robot, GROUND, noise_nm=0.5)
    bare = replace(
        robot, mass_kg=np.zeros(6), com_m=np.zeros((6, 3)), inertia_kg_m2=np.zeros((6, 3, 3)), max_torque_nm=np.full(6, np.inf),
        payload_max_kg=np.nan,
    )  # fmt: skip
    found = physically_consistent(joints, np.ones(6), base.combination, bare)
    is_physical(found)
    assert found.residual_ratio < 1.02
    loads(found)
