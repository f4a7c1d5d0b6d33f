"""Rows and the table of what ur-rtde is asked for. Values only, no connection."""

import math

import numpy as np
import pytest

from monitor.acquire.rows import WIDTHS, columns, layout, layout_of
from monitor.acquire.state import arm_state
from monitor.acquire.ur.rtde import COLUMN, SIGNALS, WIDTH

NOT_RECEIVED = {"commanded_q", "host_monotonic_s"}  # this side of the connection enters them


def test_every_column_of_a_row_is_received_or_is_our_own():
    """A column without a signal would be NaN for ever, and a condition on it would never be checked."""
    assert {signal.variable for signal in SIGNALS} == set(WIDTHS) - NOT_RECEIVED


def test_status_bits_joint_modes_and_tcp_pose_reach_the_state():
    """The freedrive button, each joint's mode and the TCP pose, by the names of RTDE."""
    row = np.zeros(WIDTH)
    row[COLUMN["robot_status_bits"]] = 0b111
    row[COLUMN["joint_mode"]] = [253, 253, 253, 255, 253, 253]
    row[COLUMN["actual_TCP_pose"]] = np.arange(6) / 10
    state = arm_state(row)
    assert state.status_bits == 7.0
    assert state.joint_modes == (253.0, 253.0, 253.0, 255.0, 253.0, 253.0)
    assert state.tcp_pose == (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)


def test_what_a_controller_does_not_report_is_nan_in_the_state():
    """Controllers of some generations lack a variable; their rows are read all the same."""
    row = np.zeros(WIDTH)
    for name in ("robot_status_bits", "joint_mode", "actual_TCP_pose"):
        row[COLUMN[name]] = math.nan
    state = arm_state(row)
    assert math.isnan(state.status_bits)
    assert all(math.isnan(value) for value in (*state.joint_modes, *state.tcp_pose))


def test_an_arm_of_another_number_of_joints_has_rows_of_its_own_width():
    """Nothing outside of a driver counts six joints: a row says by its width how many there are."""
    column, width = layout(7)
    rows = np.arange(2.0 * width).reshape(2, width)
    table = columns(rows)
    assert table["actual_q"].shape == (2, 7)
    assert table["timestamp"].shape == (2,)
    assert np.array_equal(arm_state(rows[1]).target_q, rows[1][column["target_q"]])
    with pytest.raises(ValueError, match="none of an arm"):
        layout_of(width + 1)
