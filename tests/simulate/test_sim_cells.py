"""Production cells: their programs fit every arm, and what they record is what such a cell would show on RTDE."""

from functools import cache
from itertools import islice

import numpy as np
import pytest

from monitor.errors import BadInput
from monitor.model.robot import load_robot, robot_names
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.cells.catalogue import CELLS, cell
from monitor.simulate.launch import settings_from
from monitor.simulate.machine.moves import Move
from monitor.simulate.production import ProductionSettings, record


@cache
def worked(name: str, seconds: float, **changes: object):
    """A recording of a cell, and its columns of each joint as (N, 6)."""
    recording = record(ProductionSettings(cell=name, hours=seconds / 3600.0, **changes))
    return recording, {
        name: np.column_stack([recording.columns[f"{name}_{j}"] for j in range(6)]) for name in ("actual_q", "actual_qd", "target_qdd")
    }


SOME = ("ur3", "ur10e", "ur30")


@pytest.mark.parametrize("robot", [*SOME, *(pytest.param(name, marks=pytest.mark.soak) for name in robot_names() if name not in SOME)])
def test_every_cell_fits_every_arm(robot):
    """All joint targets of twelve cycles are within the ranges of the joints, and all lines end where the arm reaches."""
    arm = load_robot(robot)
    for name in CELLS:
        made = cell(name, arm, seed=3)
        for n in range(12):
            for step in islice(made.cycle(n), 200):
                if isinstance(step, Move):
                    q = np.array(step.target) if not step.pose else made.layout.q(step.target)
                    assert (np.abs(q) <= arm.max_position_rad).all(), (name, step)


@pytest.mark.soak
def test_equal_seeds_give_equal_production_and_another_seed_stands_elsewhere():
    """Work is a function of its settings; the places of another seed are centimetres away."""
    first, again = (record(ProductionSettings(cell="pick-and-place", hours=2.0 / 3600.0)) for _ in range(2))
    other = record(ProductionSettings(cell="pick-and-place", hours=2.0 / 3600.0, seed=1))
    for name, column in first.columns.items():
        assert np.array_equal(column, again.columns[name]), name
    assert max(abs(first.columns[f"actual_q_{j}"][0] - other.columns[f"actual_q_{j}"][0]) for j in range(6)) > 5e-3


def test_moves_that_are_blended_flow_into_each_other():
    """Over a whole cycle the arm stands at the two grips alone, and neither position nor speed jumps."""
    recording, joints = worked("pick-and-place", 8.0, rate_hz=125.0)
    moving = np.abs(joints["actual_qd"]).max(axis=1) > 0.02
    stands = np.count_nonzero(np.diff(moving.astype(int)) == -1)
    assert recording.cycles == 2
    assert stands == 2  # at the belt and at the tray; blended, the arm does not stand above them
    assert np.abs(np.diff(joints["actual_qd"], axis=0)).max() < 0.008 * 12.0  # no more than 12 rad/s²


def test_the_slider_slows_the_production_down():
    """At 40 % the arm is at most 0.4 times as fast, and RTDE's fraction says so."""
    full, joints = worked("pick-and-place", 8.0, rate_hz=125.0)
    slow, slow_joints = worked("pick-and-place", 3.0, speed=0.4)
    assert np.abs(slow_joints["actual_qd"]).max() < 0.45 * np.abs(joints["actual_qd"]).max()
    assert set(slow.columns["target_speed_fraction"]) == {0.4}
    assert set(full.columns["target_speed_fraction"]) == {1.0}


def test_a_declared_part_shows_as_payload_and_an_undeclared_one_only_as_a_force():
    """set_payload follows the gripper; a part of 1 kg that is never declared leaves the payload as it was and pulls at a sensor."""
    declared, _ = worked("pick-and-place", 8.0, rate_hz=125.0)
    assert len(set(declared.columns["payload"])) == 2
    secret, _ = worked("undeclared-part", 4.0, robot="ur5e")
    holds, payload = secret.columns["actual_digital_output_bits"] > 0, secret.columns["payload"]
    assert len(set(payload[5:])) == 1
    weight_n = secret.columns["actual_TCP_force_2"][~holds].mean() - secret.columns["actual_TCP_force_2"][holds].mean()
    assert weight_n == pytest.approx(9.81, abs=0.5)  # the mean of noise of 0.4 N over 30 rows and more


@pytest.mark.soak
def test_force_control_presses_and_leads_the_arm_off_its_path():
    """The sensor shows 25 N on an uneven surface, within what its gain leaves; afterwards the program goes on from where the arm is."""
    recording, _ = worked("polishing", 9.0, robot="ur5e")
    force = recording.columns["actual_TCP_force_2"]
    pressed = force[force > 10.0]
    assert len(pressed) > 3 * 25
    assert np.median(pressed) == pytest.approx(25.0, abs=6.0)  # the sensor's zero is off by 1.5 N, the wave by some newtons
    assert not recording.stops


def test_a_hand_leads_the_arm_in_freedrive_while_the_program_plays():
    """In freedrive the tool is led by decimetres, no speed is asked for, and the program plays."""
    recording, joints = worked("hand-guiding", 18.0)
    led = np.abs(joints["actual_qd"]).max(axis=1) > 0.05
    led &= np.abs(np.column_stack([recording.columns[f"target_qd_{j}"] for j in range(6)])).max(axis=1) == 0.0
    assert np.count_nonzero(led) > 3 * 25
    assert set(recording.columns["runtime_state"][led]) == {2.0}
    tool = Kinematics(load_robot("ur5"))
    at = np.array([tool.pose(q)[:3] for q in joints["actual_q"][led]])
    assert np.linalg.norm(np.ptp(at, axis=0)) > 0.1


def test_a_protective_stop_shows_and_the_production_goes_on():
    """After its eight seconds somebody acknowledges it, and the program plays on."""
    recording, joints = worked("protective-stop", 20.0, rate_hz=10.0)
    stopped = recording.columns["safety_mode"] == 3.0
    assert len(recording.stops) == 1
    assert np.ptp(recording.columns["timestamp"][stopped]) == pytest.approx(8.0, abs=0.2)
    assert np.abs(joints["actual_qd"][-30:]).max() > 0.2


def test_nights_pass_between_shifts():
    """The clock goes on, the arm cools down, and the next shift begins a day later."""
    recording, _ = worked("inspection", 3.0, days=2, rate_hz=10.0)
    t = recording.columns["timestamp"]
    gap = int(np.argmax(np.diff(t)))
    assert t[gap + 1] - t[0] == pytest.approx(86_400.0, abs=0.2)
    assert set(recording.columns["runtime_state"]) == {1.0, 2.0}


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"cell": "juggling"}, "juggling"),
        ({"hours": 0.0}, "hours"),
        ({"days": 0}, "days"),
        ({"speed": 1.5}, "speed"),
        ({"rate_hz": 500.0}, "rate"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_settings_name_the_value_and_what_is_right(changes, named):
    """Every refusal names the field."""
    with pytest.raises(BadInput, match=f"{named}.*(expected|known are)"):
        record(ProductionSettings(**{"cell": "welding", "hours": 0.001} | changes))


def test_a_cell_brings_its_own_tool():
    """A payload beside a cell is refused; the settings of an arm in its cell have the cell's tool."""
    assert settings_from(None, cell="welding").payload_kg > 1.0
    with pytest.raises(BadInput, match="its own tool"):
        settings_from(None, cell="welding", payload_kg=2.0)
