"""Base parameters against the paper's counts and its appendix."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.model.base import base_parameters
from monitor.model.regressor import regressor
from monitor.model.robot import Mounting, load_robot, robot_names


@pytest.mark.parametrize("robot", robot_names())
@pytest.mark.parametrize(("mounting", "count"), [("ground", 52), ("ceiling", 52), ("wall", 54)])
def test_52_parameters_show_where_joint_1_is_upright_and_54_on_a_wall(robot, mounting, count):
    """Raviola et al. (2021), §2.3; the same for every UR, as their geometry is of one kind."""
    base = base_parameters(load_robot(robot), Mounting.parse(mounting))
    assert base.count == count
    # a rank is only one where the singular values fall off a cliff: 1e-2 against rounding's 1e-15
    relative = base.singular_values / base.singular_values[0]
    assert relative[count - 1] > 1e-3
    assert relative[count] < 1e-12


@pytest.mark.parametrize(("robot", "coefficient"), [("ur3", -4.104), ("ur5", -2.353)])
def test_the_second_row_of_the_appendix_is_reproduced(robot, coefficient):
    """A1 and A2 print m1z1 − 2.353·J2xz; for the UR3 it must be 4.104, the inverse of its own upper arm's length."""
    terms = base_parameters(load_robot(robot), Mounting.parse("wall")).terms[1]
    assert list(terms) == ["m1z1", "J2xz"]
    assert terms["J2xz"] == pytest.approx(coefficient, abs=5e-4)  # the paper's three decimals


@pytest.mark.parametrize(("mounting", "single", "combined", "none"), [("ground", 36, 33, 9), ("wall", 37, 34, 7)])
def test_single_combined_and_invisible_parameters_count_to_78(mounting, single, combined, none):
    """The count by columns that follows from the appendix."""
    base = base_parameters(load_robot("ur5"), Mounting.parse(mounting))
    alone = {name for terms in base.terms if len(terms) == 1 for name in terms}
    together = {name for terms in base.terms if len(terms) > 1 for name in terms}
    assert (len(alone), len(together), len(base.without_effect)) == (single, combined, none)
    assert not alone & together


@given(
    seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["ur3", "ur5", "ur10e"]), mounting=st.sampled_from(["ground", "wall", "30,40,50"])
)
@settings(max_examples=25)
def test_base_parameters_explain_every_torque_that_standard_ones_do(seed, name, mounting):
    """Y·p = Y_kept·(combination·p) for any p at any state, to 1e-10 of the largest torque: combinations are rounded at 1e-12."""
    rng = np.random.default_rng(seed)
    robot, attitude = load_robot(name), Mounting.parse(mounting)
    base = base_parameters(robot, attitude)
    Y = regressor(robot, attitude, *rng.uniform(-3, 3, (3, 5, 6)))
    p = rng.normal(size=78)
    expected = Y @ p
    assert np.max(np.abs(Y[:, :, list(base.columns)] @ (base.combination @ p) - expected)) <= 1e-10 * np.max(np.abs(expected))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_basis_does_not_depend_on_the_random_states(seed):
    """Other random states give the same columns, and the same combinations to rounding (1e-9 with coefficients up to 30)."""
    robot, wall = load_robot("ur5"), Mounting.parse("wall")
    usual, other = base_parameters(robot, wall), base_parameters(robot, wall, seed=seed)
    assert usual.columns == other.columns
    np.testing.assert_allclose(usual.combination, other.combination, atol=1e-9)


def test_fc_and_fv_are_always_base_parameters_of_their_own():
    """fc and fv of every joint are base parameters alone, in no combination with anything."""
    terms = base_parameters(load_robot("ur5"), Mounting()).terms
    for j in range(1, 7):
        for name in (f"fc{j}", f"fv{j}"):
            assert [set(row) for row in terms if name in row] == [{name}]


def test_a_tilt_counts_from_where_a_recording_can_show_it():
    """Level is 52; so is a ceiling whose π was rounded, and a floor that is off by a hundredth of a degree. A degree makes 54."""
    robot = load_robot("ur5")
    assert base_parameters(robot, Mounting(roll_rad=np.radians(0.01))).count == 52
    assert base_parameters(robot, Mounting(roll_rad=3.1416)).count == 52
    assert base_parameters(robot, Mounting(roll_rad=np.pi)).count == 52
    assert base_parameters(robot, Mounting(roll_rad=np.radians(1.0))).count == 54


@pytest.mark.parametrize("digits", [2, 3, 4, 7, 9])
@pytest.mark.parametrize("name", ["ur3", "ur5", "ur10e"])
def test_angles_that_were_rounded_make_no_base_parameters(name, digits):
    """As in a URDF that says 1.57 or 1.5708: the base of the exact arm, with friction alone in its own parameters."""
    exact = load_robot(name)
    rounded = replace(exact, alpha_rad=np.round(exact.alpha_rad, digits))
    found = base_parameters(rounded, Mounting())
    assert found.columns == base_parameters(exact, Mounting()).columns
    assert {f"fc{j}" for j in range(1, 7)} <= set(found.by_column.fully)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_arm_that_was_measured_has_the_base_of_its_drawing(seed):
    """A calibration moves each axis by a fraction of a millimetre and a milliradian, which no torque shows."""
    rng, arm = np.random.default_rng(seed), load_robot("ur5e")
    measured = replace(arm, alpha_rad=arm.alpha_rad + rng.normal(scale=5e-4, size=6), a_m=arm.a_m + rng.normal(scale=5e-4, size=6))
    assert base_parameters(measured, Mounting()).columns == base_parameters(arm, Mounting()).columns


def test_names_give_the_combination():
    """Short and readable; long sums end in an ellipsis."""
    names = base_parameters(load_robot("ur3"), Mounting.parse("wall")).names
    assert names[1] == "m1z1 − 4.104·J2xz"
    assert names[2] == "J1yy + Im1 + J2yy − J2zz + …"
    assert "fv6" in names
