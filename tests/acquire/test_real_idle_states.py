"""Idle states as real controllers recorded them pass every condition on the state, with a configuration that fits their arm."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from monitor.acquire.safety.conditions import OF_STATE, named_conditions
from monitor.acquire.safety.inputs import ConditionInputs
from monitor.acquire.safety.way import turned
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.acquire.state import ArmState, arm_state
from monitor.acquire.ur.rtde import COLUMN, WIDTH
from monitor.design.clearance import frames
from monitor.model.fourier import Excitation, excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array, Context

# file, separator, model that fits, payload [kg] and its centre [m] where the recording has them
RECORDINGS: Mapping[str, tuple[str, str, str, float | None, tuple[float, ...]]] = {
    "UR3e between its programs": ("ur3e/rtde_25hz.csv", ",", "ur3e", 1.07, (0.0, 0.0, 0.058)),
    "a real arm standing still": ("ur_standstill/real_10hz.csv", r"\s+", "ur5e", None, ()),
    "the manufacturer's simulator": ("ur_standstill/ursim_125hz.csv", r"\s+", "ur5", None, ()),
}
# a program of somebody's was paused there, which `no_other_program` refuses rightly; everything else is an idle arm's
PAUSED = "a real arm standing still"
SAME = {"safety_status": "safety_mode"}  # the name under which later software reports it


def rows_of(table: pd.DataFrame) -> Array:
    """Rows (N, WIDTH) with every column that the recording has; NaN in the others, as a controller that lacks a variable leaves them."""
    rows = np.full((len(table), WIDTH), np.nan)
    for name, column in COLUMN.items():
        width = column.stop - column.start
        for recorded in (name, *(old for old, new in SAME.items() if new == name)):
            names = [recorded] if width == 1 else [f"{recorded}_{k}" for k in range(width)]
            if set(names) <= set(table):
                rows[:, column] = table[names].to_numpy()
    rows[:, COLUMN["safety_status_bits"]] = 1.0  # no recording has it: normal, as the safety mode says
    return rows


def idle(rows: Array) -> Array:
    """The rows in which the arm stands without a program."""
    stands = np.all(rows[:, COLUMN["target_qd"]] == 0.0, axis=1)
    return rows[stands & (rows[:, COLUMN["runtime_state"].start] != 2.0)]


def around(robot: str, q: Array) -> Excitation:
    """A small trajectory that starts 0.1 rad from a pose (J,), within one turn of zero, as a designed one does."""
    w = 2.0 * np.pi / 4.0
    a = np.outer([0.1 * w, -0.1 * w], np.ones(6))
    offset = np.remainder(q + 0.1 + np.pi, 2.0 * np.pi) - np.pi
    return Excitation(
        robot=robot, mounting=Mounting(), period_s=4.0, repetitions=1, offset_rad=offset, a_rad_s=a, b_rad_s=np.zeros((2, 6)), source="test"
    )


def known(name: str, rows: Array) -> ConditionInputs:
    """A configuration that fits the arm of a recording."""
    _, _, model, payload_kg, cog_m = RECORDINGS[name]
    return ConditionInputs(
        settings=ReplaySettings(host="192.168.0.10", allow_motion=True),
        excitation=around(model, rows[0, COLUMN["target_q"]]),
        robot=load_robot(model),
        context=Context(robot=model, payload_kg=payload_kg, mounting_rad=(0.0, 0.0, 0.0)),
        now_unix_s=0.0,
        identity=None,
        state=None,
        installation=Installation(payload_cog_m=cog_m, tcp_offset=(0.0,) * 6 if name == PAUSED else ()),
    )


def refused(inputs: ConditionInputs, state: ArmState) -> list[str]:
    """The conditions on the state that do not hold, each with what was found."""
    found = named_conditions(replace(inputs, state=state), OF_STATE)
    return [f"{each.name}: {each.text}" for each in found if not each.holds]


@pytest.fixture(params=RECORDINGS)
def recorded(request: pytest.FixtureRequest, real_data: Path) -> tuple[ConditionInputs, Array]:
    """What is configured for a recording, and its idle rows, without the paused program."""
    path, separator, *_ = RECORDINGS[request.param]
    rows = idle(rows_of(pd.read_csv(real_data / path, sep=separator)))
    assert len(rows) > 50
    inputs = known(request.param, rows)
    if request.param == PAUSED:
        (found,) = refused(inputs, arm_state(rows[0]))
        assert found.startswith("no_other_program: a program is paused on the controller")
        rows[:, COLUMN["runtime_state"]] = 1.0
    return inputs, rows


def test_every_recorded_idle_state_passes_every_condition(recorded):
    """All of them record speed_scaling = 0; the condition on it once refused them for ever."""
    inputs, rows = recorded
    assert np.all(rows[:, COLUMN["speed_scaling"]] == 0.0)
    for row in rows:  # the arm parks at several places; its trajectory begins near each
        inputs = replace(inputs, excitation=around(inputs.robot.name, row[COLUMN["target_q"]]))
        assert refused(inputs, arm_state(row)) == []


VARIATIONS = {  # column → value; what another real controller may report of the same idle arm
    "limiter at 0": {"speed_scaling": 0.0, "target_speed_fraction": 1.0},
    "limiter at 1": {"speed_scaling": 1.0, "target_speed_fraction": 1.0},
    "no slider reported": {"target_speed_fraction": math.nan},
    "power on, no program": {"robot_status_bits": 1.0},
    "power on, power button": {"robot_status_bits": 9.0},
    "every joint runs": {"joint_mode": 253.0},
    "every digital input on": {"actual_digital_input_bits": 2.0**18 - 1.0},
    "hot joints": {"joint_temperatures": 68.0},
    "noise of the speed": {"actual_qd": 0.004},
}


@pytest.mark.parametrize("name", VARIATIONS)
def test_what_another_controller_may_report_of_an_idle_arm_passes(recorded, name):
    """Each variation is within what real arms report."""
    inputs, rows = recorded
    row = rows[0].copy()
    for column, value in VARIATIONS[name].items():
        row[COLUMN[column]] = value
    assert refused(inputs, arm_state(row)) == []


@pytest.mark.parametrize("length", [9.10, 9.28, 9.41, 9.81])
def test_an_accelerometer_of_a_real_arms_length_passes(recorded, length):
    """A real arm's reads 9.28 m/s² in the mean and 9.10 to 9.41 in single rows."""
    inputs, rows = recorded
    row = rows[0].copy()
    q, column = row[COLUMN["actual_q"]], COLUMN["actual_tool_accelerometer"]
    attitudes, _ = frames(inputs.robot, Mounting(), q[None])
    row[column] = attitudes[0, -1].T @ np.array([0.0, 0.0, length])
    assert refused(inputs, arm_state(row)) == []


@pytest.mark.parametrize("turns", [-2, -1, 1, 2])
def test_an_endless_wrist_some_turns_on_passes_and_is_not_wound_back(recorded, turns):
    """In a real recording wrist 3 of a UR3e stands at +12.6 rad. Where the range ends, as on a UR5e, the arm is refused by its distance."""
    inputs, rows = recorded
    row = rows[0].copy()
    for name in ("actual_q", "target_q"):
        row[COLUMN[name].stop - 1] += 2.0 * np.pi * turns
    q = row[COLUMN["target_q"]]
    found = refused(inputs, arm_state(row))
    if inputs.robot.endless[-1]:
        assert found == []
        start = turned(inputs.excitation, inputs.robot, q).at(np.zeros(1)).q[0]
        assert np.max(np.abs(start - q)) < 0.2
    else:
        assert all(each.startswith("approach_near: Wrist 3 (joint 6)") for each in found)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"robot_status_bits": 0b101}, "teach_button"),
        ({"joint_mode": 255.0}, "joints_running"),
        ({"joint_mode": 239.0}, "joints_running"),
        ({"robot_mode": 5.0}, "robot_mode"),
        ({"target_speed_fraction": 0.8}, "speed_scaling"),
        ({"safety_status_bits": 0x404, "safety_mode": 3.0}, "safety_mode"),
        ({"runtime_state": 2.0}, "no_other_program"),
        ({"joint_temperatures": 80.0}, "temperatures"),
        ({"actual_qd": 0.05}, "stationary"),
    ],
)
def test_what_no_idle_arm_reports_is_refused_by_its_condition(recorded, changes, name):
    """Conditions that let everything pass would pass the tests above."""
    inputs, rows = recorded
    row = rows[0].copy()
    for column, value in changes.items():
        row[COLUMN[column]] = value
    assert [each.partition(":")[0] for each in refused(inputs, arm_state(row))] == [name]


def test_the_recorded_tool_is_at_the_flange_and_another_one_is_noticed(real_data):
    """The recorded TCP pose of a real UR5e gives no offset: its calibrated kinematics differ from the published ones by 1–2 mm."""
    path, separator, *_ = RECORDINGS[PAUSED]
    rows = idle(rows_of(pd.read_csv(real_data / path, sep=separator)))
    inputs = known(PAUSED, rows)
    other = replace(inputs, installation=Installation(tcp_offset=(0.0, 0.0, 0.05, 0.0, 0.0, 0.0)))
    (found,) = (each for each in refused(other, arm_state(rows[0])) if each.startswith("tcp_offset"))
    assert "50 mm" in found.replace("49 mm", "50 mm").replace("51 mm", "50 mm")  # the calibration moves it by a millimetre


def test_a_shipped_trajectory_is_played_around_the_wrist_of_the_real_recording(real_data):
    """The trajectory that comes with the program for a UR3e, from the pose of the real recording: no joint has to unwind."""
    document = Path(__file__).parents[2] / "config" / "excitation" / "ur3e-ground.json"
    excitation = excitation_from_document(json.loads(document.read_text("utf-8")))
    rows = idle(rows_of(pd.read_csv(real_data / "ur3e" / "rtde_25hz.csv")))
    q = rows[0, COLUMN["target_q"]]
    assert q[5] > 12.0
    played = turned(excitation, load_robot("ur3e"), q)
    assert abs(played.at(np.zeros(1)).q[0, 5] - q[5]) <= np.pi
    still = np.delete(played.at(np.zeros(1)).q[0] - excitation.at(np.zeros(1)).q[0], 5)
    assert np.max(np.abs(still - 2.0 * np.pi * np.round(still / (2.0 * np.pi)))) < 1e-9


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.parametrize("name", [name for name in COLUMN if name not in {"commanded_q", "host_monotonic_s", "timestamp"}])
def test_no_value_of_any_column_raises_and_none_that_is_reported_and_impossible_passes(name, wrong):
    """Whatever a controller reports, each condition finds something. The modes are whole numbers on the wire, never these."""
    row = np.zeros(WIDTH)
    row[COLUMN["target_q"]] = row[COLUMN["actual_q"]] = START
    for column, value in IN_ORDER.items():
        row[COLUMN[column]] = value
    inputs = ConditionInputs(
        settings=ReplaySettings(host="127.0.0.1", allow_motion=True),
        excitation=around("ur5", START),
        robot=load_robot("ur5"),
        context=Context(robot="ur5", payload_kg=1.0),
        now_unix_s=0.0,
        identity=None,
        state=None,
        installation=Installation(payload_cog_m=(0.0, 0.0, 0.0)),
    )
    assert refused(inputs, arm_state(row)) == []
    if name in WHOLE_NUMBERS:
        return
    row[COLUMN[name].start] = wrong
    with np.errstate(all="ignore"):
        found = refused(inputs, arm_state(row))
    if not math.isnan(wrong) and name not in NOT_ASKED:
        assert found, name


START = np.array([0.1, -1.5, 0.2, -1.4, 0.1, 2.5])
WHOLE_NUMBERS = {"robot_mode", "safety_mode", "runtime_state", "safety_status_bits"}
NOT_ASKED = {  # by conditions before a motion: the band and the stream look at some of them
    *("actual_current", "target_qdd", "target_current", "target_moment", "actual_digital_input_bits"),
    "robot_status_bits",  # 1e300 is a whole number whose third bit is not set
    "actual_TCP_pose",  # compared only where a TCP is configured
    "actual_TCP_force",  # tells contact of ordinary work
}
IN_ORDER = {
    **{"robot_mode": 7, "safety_mode": 1, "runtime_state": 1, "safety_status_bits": 1, "robot_status_bits": 1, "joint_mode": 253},
    **{"target_speed_fraction": 1.0, "payload": 1.0, "joint_temperatures": 30.0},
}
