"""The band of a first pass, without a robot: what leaves it, for how long, and what it is made of."""

from dataclasses import replace

import numpy as np
import pytest
from excitations import short

from monitor.acquire.first_pass import band_for, circumstances, slowed
from monitor.acquire.rows import PLACE, WIDTH
from monitor.acquire.settings import ReplaySettings
from monitor.design.cell import plain_cell
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context
from monitor.simulate.physics import Arm

UR5 = load_robot("ur5")
SETTINGS = ReplaySettings(host="127.0.0.1")
CONTEXT = Context(robot="ur5", payload_kg=0.0, mounting_rad=(0.0, 0.0, 0.0), tool="none")


def rows(arm: Arm, q, qd, qdd):
    """(N, WIDTH) what the controller of a simulated arm would report along a motion: its own physics, its own friction law."""
    rigid, load = arm.rigid_torque(q, qd, qdd)
    torque = rigid + arm.friction_torque(qd, load)
    told = np.full((len(q), WIDTH), np.nan)
    for name, value in (
        ("actual_q", q),
        ("actual_qd", qd),
        ("target_qdd", qdd),
        ("actual_current", torque / arm.gain_nm_per_a),
        ("target_current", rigid / arm.gain_nm_per_a),
        ("target_moment", rigid),
    ):
        told[:, PLACE[name]] = value
    told[:, PLACE["joint_temperatures"]] = 25.0
    return told


def first_doubt(band, told):
    return next((doubt for row in told if (doubt := band.outside(row))), None)


@pytest.mark.parametrize("mounting", ["ground", "wall"])
@pytest.mark.parametrize("robot", ["ur3", "ur5", "ur10"])
def test_a_sound_arm_stays_in_the_band_of_its_makers_parameters(robot, mounting):
    """Friction that the makers do not publish included, at a quarter of the pace."""
    arm_model, hung = load_robot(robot), Mounting.parse(mounting)
    excitation = replace(slowed(short(robot=robot, period_s=6.0), SETTINGS), mounting=hung)
    band = band_for(arm_model, excitation, SETTINGS, CONTEXT, gains=None, model=None)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    arm = Arm(arm_model, q=q[0], mounting=hung)
    assert first_doubt(band, rows(arm, q, qd, qdd)) is None
    assert 0.1 < band.largest_share < 0.9  # friction is seen, and there is room


@pytest.mark.parametrize(
    ("arm", "word"),
    [
        (Arm(UR5, q=np.zeros(6), payload_kg=8.0), "joint"),  # more than the 5 kg that it may carry
        (Arm(UR5, q=np.zeros(6), mounting=Mounting.parse("0,90,0")), "joint 2"),
    ],
)
def test_a_load_or_a_mounting_that_nobody_told_of_leaves_the_band(arm, word):
    """Named by joint, with what was measured and expected."""
    excitation = slowed(short(period_s=6.0), SETTINGS)
    band = band_for(UR5, excitation, SETTINGS, CONTEXT, gains=None, model=None)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    doubt = first_doubt(band, rows(arm, q, qd, qdd))
    assert doubt is not None
    cause, text = doubt
    assert cause == "torque_band"
    assert word in text
    assert "N·m" in text


def test_a_spike_is_no_collision_and_an_obstacle_is():
    """Four rows outside are forgotten, five in a row are not."""
    excitation = slowed(short(), SETTINGS)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    told = rows(Arm(UR5, q=q[0]), q, qd, qdd)[:40]
    blocked = told.copy()
    blocked[10:, PLACE["actual_current"].start + 1] += 100.0 / 12.5  # N·m over about A: far outside joint 2's 37 N·m
    band = band_for(UR5, excitation, SETTINGS, CONTEXT, gains=None, model=None)
    assert [bool(band.outside(row)) for row in blocked].index(True) == 14
    spiky = told.copy()
    for begin in (5, 15, 25):
        spiky[begin : begin + 4] = blocked[begin + 10 : begin + 14] if begin < 10 else blocked[begin : begin + 4]
    assert first_doubt(band_for(UR5, excitation, SETTINGS, CONTEXT, gains=None, model=None), spiky) is None


def test_a_gain_that_is_not_published_is_taken_from_the_controllers_own_model():
    """Its predicted moment over its predicted current; where it predicts neither, the joint is not watched."""
    excitation = slowed(short(), SETTINGS)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    told = rows(Arm(UR5, q=q[0]), q, qd, qdd)[:60]
    told[30:, PLACE["actual_current"].start + 1] += 8.0
    unknown = np.full(6, np.nan)
    doubt = first_doubt(band_for(UR5, excitation, SETTINGS, CONTEXT, gains=unknown, model=None), told)
    assert doubt is not None
    assert "joint 2" in doubt[1]
    told[:, PLACE["target_current"]] = 0.0
    assert first_doubt(band_for(UR5, excitation, SETTINGS, CONTEXT, gains=unknown, model=None), told) is None


def test_a_first_pass_is_the_same_way_slower_and_once():
    """Its proof of clearance stays valid: it belongs to the path."""
    excitation = replace(short(), repetitions=3)
    slow = slowed(excitation, SETTINGS)
    assert slow.path_digest == excitation.path_digest
    assert slow.duration_s == pytest.approx(excitation.period_s / 0.25)


@pytest.mark.parametrize(
    "changes",
    [
        {"excitation": short(period_s=4.0)},
        {"context": replace(CONTEXT, payload_kg=1.0)},
        {"context": replace(CONTEXT, tool="gripper")},
        {"context": replace(CONTEXT, mounting_rad=(0.1, 0.0, 0.0))},
        {"context": replace(CONTEXT, serial="2")},
        {"settings": replace(SETTINGS, cell=plain_cell(Mounting()))},
    ],
)
def test_every_change_asks_for_a_new_first_pass(changes):
    """And repetitions or a note do not."""
    known = {"excitation": short(), "settings": SETTINGS, "context": CONTEXT}
    assert circumstances(**known) != circumstances(**{**known, **changes})
    same = {**known, "excitation": replace(short(), repetitions=2), "context": replace(CONTEXT, note="x", firmware="5.12")}
    assert circumstances(**known) == circumstances(**same)
