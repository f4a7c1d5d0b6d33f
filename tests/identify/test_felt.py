"""The regressor as joints feel it, whole and in pieces, and columns added to factors that are known."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from monitor.identify.fit import least_squares as felt
from monitor.identify.fit.jackknife import jackknife_covariance
from monitor.identify.fit.least_squares import Felt, Rows, factors, solve
from monitor.model.base import base_parameters
from monitor.model.regressor import felt_columns, felt_regressor, felt_weight, friction_columns, regressor
from monitor.model.robot import PER_JOINT, Mounting, load_robot


@pytest.mark.parametrize("model", ["ur5", "ur10e"])
@pytest.mark.parametrize("mounting", [Mounting(), Mounting(roll_rad=0.4, pitch_rad=0.2)])
def test_what_joints_feel_is_the_regressor_to_the_last_bit(model, mounting):
    robot = load_robot(model)
    columns = base_parameters(robot, mounting).columns
    q, qd, qdd, direction = np.random.default_rng(0).uniform(-2.0, 2.0, (4, 50, 6))
    whole = regressor(robot, mounting, q, qd, qdd)
    whole[:, np.arange(6), friction_columns(6)[0]] = direction
    where = felt_columns(columns, 6)
    blocks = felt_regressor(robot, mounting, where, q, qd, qdd, direction)
    rebuilt = np.zeros((50, 6, len(columns)))
    for j, block in enumerate(blocks):
        rebuilt[:, j, where.places[j]] = block
    np.testing.assert_array_equal(rebuilt, whole[:, :, list(columns)])


@pytest.mark.parametrize("coupling", [None, np.array([[1.0, 0, 0], [0.3, 1.0, 0], [0, -0.2, 1.0]])])
def test_the_weight_that_joints_feel_is_the_regressor_at_rest(coupling):
    """Each gravity by itself, also where the motors of the wrist are coupled."""
    robot = load_robot("ur10e")
    if coupling is not None:
        robot = replace(robot, coupling=np.block([[np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), coupling]]))
    columns = [k for k in base_parameters(robot, Mounting(roll_rad=0.7)).columns if k % PER_JOINT < 4]
    mountings = [Mounting(), Mounting(roll_rad=0.4, pitch_rad=0.2)]
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 6))
    where = felt_columns(columns, 6, robot.innermost)
    gravity = np.stack([robot.gravity(mounting) for mounting in mountings], axis=1)
    for j, block in enumerate(felt_weight(robot, gravity, where, q)):
        for each, mounting in zip(block, mountings, strict=True):
            whole = regressor(robot, mounting, q, np.zeros_like(q), np.zeros_like(q))[:, j, columns]
            np.testing.assert_allclose(each.T, whole[:, where.places[j]], rtol=1e-12, atol=1e-12)
            assert not np.delete(whole, where.places[j], axis=1).any()


def test_the_memory_of_a_regressor_is_free_when_nobody_needs_it():
    """It does not wait for the collector of circles: the next identification finds its memory where this one had it."""
    block = np.random.default_rng(0).normal(size=(100, 4))
    gc.disable()
    try:
        whole = Felt(100, 4, [np.arange(4)], lambda at: [block[at]])
        part = whole.thinned(3, 4)
        np.testing.assert_array_equal(part.at(slice(None))[0], block[::3])
        held = weakref.ref(whole)
        del whole, part
        assert held() is None
    finally:
        gc.enable()


def equations(seed, samples=900):
    """Rows with noise, of which a joint does not feel all columns."""
    rng = np.random.default_rng(seed)
    Y = rng.normal(size=(samples, 3, 7))
    Y[:, 1, :2], Y[:, 2, :4] = 0.0, 0.0
    torque = Y @ np.arange(7.0) + rng.normal(size=(samples, 3))
    return Rows(Y, torque, rng.random((samples, 3)) < 0.8, np.arange(samples) // 10, np.zeros(samples, dtype=int))


def test_pieces_give_what_the_whole_gives(monkeypatch):
    """Factors, residuals and the jackknife of rows in pieces that cut steps agree with the whole to rounding."""
    rows, weights = equations(1), np.array([1.0, 3.0, 0.3])
    whole = solve(factors([rows]), weights, np.zeros(7))
    covariance = jackknife_covariance([rows], weights, whole)
    monkeypatch.setattr(felt, "PIECE", 123)
    pieces = rows._replace(Y=Felt.of(rows.Y))
    assert len(list(pieces.Y.pieces())) == 8
    found = solve(factors([pieces]), weights, np.zeros(7))
    np.testing.assert_allclose(found.values, whole.values, rtol=1e-12)
    np.testing.assert_allclose(pieces.Y @ found.values, rows.Y @ whole.values, rtol=1e-11)
    np.testing.assert_allclose(jackknife_covariance([pieces], weights, found), covariance, rtol=1e-10, atol=1e-14)
    np.testing.assert_array_equal(pieces.Y[::7], rows.Y[::7])
    np.testing.assert_array_equal(pieces.Y[np.array([3, 500]), 1], rows.Y[[3, 500], 1])


@pytest.mark.parametrize("step", [1, 4])
def test_one_of_so_many_rows_of_a_long_recording_is_formed_in_pieces_too(step, monkeypatch):
    """A recording of hours would fill the memory: a part of its rows is read as all are, and is what the same part of an array is."""
    monkeypatch.setattr(felt, "PIECE", 123)
    Y, asked = equations(1).Y, []

    def make(at):
        block = Y[at].reshape(-1, 21)
        asked.append(len(block))
        return list(np.split(block, 3, axis=1))

    fewer = Felt(len(Y), 7, [np.arange(7)] * 3, make).thinned(step, 5)
    part = Y[::step, :, :5]
    np.testing.assert_array_equal(np.concatenate([np.stack(blocks, axis=1) for _, blocks in fewer.pieces()]), part)
    np.testing.assert_array_equal(fewer[np.array([3, 200])], part[[3, 200]])
    np.testing.assert_array_equal(fewer[1:200:7], part[1:200:7])
    assert max(asked) <= 123
