"""Recordings that are not what they say: friction comes out right all the same, or the true cause is named first or second."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faults import DRIVES, faults, permuted
from oracle_arm import GROUND, excitation, rigid_torque
from own_physics import UR5, late, productioned_arm, with_current

from monitor.config.files import find_excitation
from monitor.errors import BadInput, Unidentifiable
from monitor.identify.identify import identify
from monitor.identify.quality import not_of_the_arm, silent_drive
from monitor.judge.assess import Rejected, assess
from monitor.model.robot import Mounting, load_robot
from monitor.reason import Reason
from monitor.recording import Context, Recording
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import read_recording
from monitor.store.from_files.production_files import ListenRequest, listen_to_files
from monitor.store.identify_files import robot_from_urdf

HEALTHY = productioned_arm(4)
FAULTS = dict(faults(UR5))
RIGHT = 0.02  # of friction at 0.4 rad/s
FEW = (
    "exchanged_currents 5 6", "exchanged_joints 1 3", "exchanged_positions 2 4", "sign of current 3", "axis 2", "zero drive 3",
    "drive 2 times 30", "zero of joint 3 by 90°", "all signs", "N·m for A", "A for N·m", "two signs",
)  # fmt: skip


def of_arm(recording, robot=UR5, gains=None):
    found = identify([recording], robot, GROUND, gains=gains)
    return found, found.friction_at(0.4)[0]


def parts(reason):
    """The codes of a reason and of all reasons in it, each with its joints."""
    joints = {value for name, value in reason.parameters.items() if name in ("joint", "other") and isinstance(value, int)}
    yield reason.code, joints
    for value in reason.parameters.values():
        for each in value if isinstance(value, tuple) else (value,):
            if isinstance(each, Reason):
                yield from parts(each)


def named(fault, warnings):
    """Whether one of these warnings names the fault and its joints."""
    return any(code in fault.causes and fault.joints <= joints for warning in warnings for code, joints in parts(warning))


def right_or_named(fault, recording, robot=UR5, gains=None):
    """Whether friction is that of the sound recording, or the fault is told first or second. Sizes of friction, beside both."""
    _, sound = of_arm(recording, robot, gains)
    try:
        found, friction = of_arm(fault.of(recording), robot, gains)
    except (BadInput, Unidentifiable) as why:
        return True, str(why)
    known = np.isfinite(friction)
    right = known.any() and bool(np.all(np.abs(friction / sound - 1.0)[known] < RIGHT))
    return right or named(fault, found.warnings[:2]), [warning.text for warning in found.warnings]


@pytest.mark.parametrize("name", FEW)
def test_a_fault_is_named_first_or_second_unless_friction_is_right(name):
    """One of each kind."""
    good, told = right_or_named(FAULTS[name], HEALTHY)
    assert good, told


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in FAULTS if name not in FEW])
def test_every_fault_is_named_first_or_second_unless_friction_is_right(name):
    """For every joint and every pair of joints."""
    good, told = right_or_named(FAULTS[name], HEALTHY)
    assert good, told


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in FAULTS if "times" not in name and name != "A for N·m"])
def test_every_fault_is_named_on_a_real_arm(name, real_data):
    """On the 50 s of the UR10e whose gains its authors give."""
    columns = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
    gains = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])
    robot = load_robot("ur10e")
    recording = read_recording(real_data / "ur10e" / "ur-20_02_10-30sec_12harm.csv", columns)
    robot = replace(robot, torque_constant_nm_per_a=gains / robot.gear_ratio)
    good, told = right_or_named(dict(faults(robot))[name], replace(recording, target_current=None), robot)
    assert good, told


def test_real_joints_in_alphabetical_order_are_named(real_data):
    """A logger without names writes elbow, shoulder_lift, shoulder_pan, …: joints 1 and 3 exchanged."""
    path = real_data / "arms" / "ur10_unisa" / "unisa_ur10_alphabetical_joint_order.csv"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    found = identify([read_recording(path)], load_robot("ur10"), GROUND)
    (cause,) = [warning for warning in found.warnings[:2] if warning.code == "likely_cause"]
    assert ("exchanged_joints", {1, 3}) in list(parts(cause)), cause.text
    assert "mounting_contradiction" not in {warning.code for warning in found.warnings}


@pytest.mark.parametrize("seed", [1, 2, 3, 5, 6])
def test_a_sound_recording_is_what_it_says(seed):
    """No cause is made up."""
    found, _ = of_arm(productioned_arm(seed))
    assert found.warnings == ()
    assert not_of_the_arm(found) is None


@pytest.mark.parametrize(("folder", "robot"), [("ur3_brasilia", "ur3"), ("ur5_kufieta", "ur5"), ("nist_ur5", "ur5")])
@pytest.mark.slow
def test_no_cause_is_made_up_of_a_real_arm(folder, robot, real_data):
    """Sound recordings of real arms, some of them slow, rough or poor."""
    files = sorted((real_data / "arms" / folder).glob("*.csv")) if (real_data / "arms" / folder).exists() else []
    if not files:
        pytest.skip(f"{real_data / 'arms' / folder} is not here")
    for path in files:
        try:
            found, _ = of_arm(read_recording(path), load_robot(robot))
        except (BadInput, Unidentifiable):
            continue
        assert "likely_cause" not in {warning.code for warning in found.warnings}, (path.name, found.warnings)


def test_another_mounting_is_a_mounting_and_nothing_else():
    """Where gravity has another direction and all columns are right."""
    found = identify([HEALTHY], UR5, Mounting.parse("wall"))
    assert found.warnings[0].code == "mounting_contradiction"
    assert "likely_cause" not in {warning.code for warning in found.warnings}


def test_a_cause_leaves_no_other_cause_beside_it():
    """Neither mounting nor coupled axes, late or offset torque are told of exchanged columns."""
    found, _ = of_arm(permuted(HEALTHY, [0, 1, 2, 3, 5, 4], DRIVES))
    assert {warning.code for warning in found.warnings} == {"likely_cause", "poor_fit"}
    assert all("coupled" not in warning.text for warning in found.warnings)


def test_a_drive_that_says_nothing_leaves_the_other_joints_their_friction():
    """Its rows are no equations: friction of that joint is unknown, and no weight is missing elsewhere."""
    _, sound = of_arm(HEALTHY)
    found, friction = of_arm(with_current(HEALTHY, 2, lambda x: 0.0 * x))
    assert np.isnan(friction[2])
    np.testing.assert_allclose(np.delete(friction, 2), np.delete(sound, 2), rtol=RIGHT)
    assert "mounting_contradiction" not in {warning.code for warning in found.warnings}
    assert not_of_the_arm(found) is None
    assert silent_drive(found).parameters["joint"] == 3


def test_late_currents_are_late_and_nothing_else():
    """A delay is no exchange."""
    found, _ = of_arm(late(HEALTHY, 0.1))
    assert "likely_cause" not in {warning.code for warning in found.warnings}


@pytest.mark.parametrize("name", ["exchanged_joints 1 3", "N·m for A", "sign of current 2"])
def test_a_replay_that_is_not_of_the_arm_is_rejected_with_its_cause(name):
    """No verdict is made of it: neither a payload nor wear."""
    dated = replace(HEALTHY, context=Context(robot="ur5", recorded_at_unix_s=1e9))
    outcome = assess(FAULTS[name].of(dated), robot=UR5, mounting=GROUND, belief=None, health=None)
    assert isinstance(outcome, Rejected)
    assert named(FAULTS[name], [outcome.reason]), outcome.reason.text
    assert not isinstance(assess(dated, robot=UR5, mounting=GROUND, belief=None, health=None), Rejected)


def test_a_replay_with_a_silent_drive_teaches_what_the_other_joints_say():
    """The joint of that drive is unseen, with its cause, and keeps what is known of it; the model's error is not that of a silence."""
    controller, excitation = (
        Controller(SimulateSettings(robot="ur5", seed=5)),
        replace(find_excitation("ur5-ground", Path()), repetitions=1),
    )
    before, after = (
        replace(recorded, context=replace(recorded.context, recorded_at_unix_s=at))
        for recorded, at in ((stepped_replay(controller, excitation), 1e9), (stepped_replay(controller, excitation), 1e9 + 86400.0))
    )
    first = assess(before, robot=UR5, mounting=GROUND, belief=None, health=None)
    known = {"belief": first.belief, "health": first.health, "model": first.model}
    silent = FAULTS["zero drive 3"].of(after)
    outcome, sound = (assess(recording, robot=UR5, mounting=GROUND, **known) for recording in (silent, after))
    assert {"current_stuck", "joint_unseen"} <= {warning.code for warning in outcome.warnings}
    assert [joint.state for joint in outcome.health.joints] == [*2 * ["NORMAL"], "CHECK_FUNCTION", *3 * ["NORMAL"]]
    for j, (ours, theirs) in enumerate(zip(outcome.friction, sound.friction, strict=True)):
        assert ours.wear == pytest.approx(theirs.wear, abs=1e-3)
        assert ours.coulomb_nm == (None if j == 2 else pytest.approx(theirs.coulomb_nm, rel=0.01))
    error, of_sound = (each.belief.prediction_error for each in (outcome, sound))
    assert error.replays.tolist() == [1, 1, 0, 1, 1, 1]
    np.testing.assert_allclose(error.error_nm2[[0, 1, 3, 4, 5]], of_sound.error_nm2[[0, 1, 3, 4, 5]], rtol=1e-6)


@pytest.mark.parametrize("name", ["exchanged_currents 5 6", "zero drive 3"])
def test_production_that_is_not_of_the_arm_is_refused_with_its_cause(name, tmp_path):
    """`listen` never says that something else is in the hand where a column is wrong."""

    def written(recording, file):
        header = ["timestamp", *(f"actual_{s}_{j}" for s in ("q", "qd", "current") for j in range(6))]
        rows = np.column_stack([recording.t_s, recording.q, recording.qd, recording.current])
        np.savetxt(tmp_path / file, rows, delimiter=",", header=",".join(header), comments="")
        return tmp_path / file

    replay, wrong = written(HEALTHY, "replay.csv"), written(FAULTS[name].of(HEALTHY), "work.csv")
    request = ListenRequest(files=[wrong], rigid=replay, history=None, robot=UR5, mounting=GROUND)
    with pytest.raises(BadInput, match=r"work.csv: .*(exchanged|stays at 0).*expected the columns and units of the replay"):
        listen_to_files(request, load_robot, lambda *_: None)


def test_a_torque_sensor_behind_the_gear_with_the_opposite_sign_is_told_as_gravity_or_sign():
    """Nothing rubs there, so that no friction drives a joint, and no exchange is made up; slow motion tells no inertia."""
    t_s, (q, qd, qdd) = excitation(UR5, speed_rad_s=0.3).sampled(125.0)
    torque = 0.2 * np.random.default_rng(2).normal(size=q.shape) - rigid_torque(UR5, GROUND, q, qd, qdd)
    found = identify([Recording(t_s=t_s, q=q, qd=qd, torque=torque)], UR5, GROUND)
    assert found.warnings[0].code == "mounting_contradiction"
    assert found.warnings[0].parameters["sign"].code in {"signs_as_well", "up_open"}
    assert "likely_cause" not in {warning.code for warning in found.warnings}


def test_no_exchange_is_made_up_of_a_slow_arm_whose_sensors_are_behind_the_gears(real_data):
    """A KUKA LBR, whose efforts have the opposite sign: what looked like friction that drives was the end of a line, beyond all speeds."""
    folder = real_data / "arms" / "lbr_med7"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")
    recording, arm = read_recording(folder / "lbr_med7_joint_states_joined_in_order.csv"), robot_from_urdf(folder / "lbr_med7dock.urdf")
    told = {warning.code: warning for warning in identify([recording], arm, GROUND).warnings}
    assert "likely_cause" not in told
    assert told["mounting_contradiction"].parameters["sign"].code == "signs_as_well"


def test_a_larger_arm_than_the_model_says_is_told_as_its_weight():
    """The wrong model of robot is neither an exchange nor a unit: its links seem too heavy."""
    found, _ = of_arm(HEALTHY, load_robot("ur3"), UR5.drive_gain_nm_per_a)
    assert found.warnings[0].code == "gain_doubtful"
    assert "weigh" in found.warnings[0].text
    assert not_of_the_arm(found) is None


def test_torques_in_the_place_of_currents_are_named_on_a_real_ur3(real_data):
    """Its wrists have gains a third of the others', so that their friction alone would still be possible."""
    path = real_data / "arms" / "ur3_brasilia" / "ur3_brasilia_traj1_runD_full.csv"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    robot = load_robot("ur3")
    good, told = right_or_named(dict(faults(robot))["N·m for A"], read_recording(path), robot)
    assert good, told
