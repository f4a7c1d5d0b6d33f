"""Rows that were torn though every number in them is plausible, rows written twice, and angles wrapped into one turn."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_arm import GROUND, recording, truth

from monitor.identify.detectors import warnings_of
from monitor.identify.identify import identify
from monitor.identify.signals.motion import motion
from monitor.identify.signals.rows import EDGE_ROWS, sound_rows
from monitor.model.robot import load_robot

UR5 = load_robot("ur5")
HEALTHY = recording(truth(UR5, repetitions=1))


def rewritten(rows, source, *, columns=slice(None)):
    """The healthy recording with rows whose columns q₁…q₆, q̇₁…q̇₆, i₁…i₆ were written from other rows of it."""
    table = np.concatenate([HEALTHY.q, HEALTHY.qd, HEALTHY.current], axis=1)
    torn = table.copy()
    torn[rows, columns] = table[source, columns]
    return replace(HEALTHY, q=torn[:, :6], qd=torn[:, 6:12], current=torn[:, 12:])


@given(
    starts=st.lists(st.integers(2, 1180), min_size=1, max_size=8),
    length=st.integers(1, 15),
    first=st.integers(0, 11),
    seed=st.integers(0, 1000),
)
@settings(max_examples=25)
def test_torn_rows_beside_other_torn_rows_are_left_out(starts, length, first, seed):
    """Clusters of rows that are joined from two rows anywhere in the recording: what moved by more than 20 mrad is found, little else."""
    rows = np.unique(np.concatenate([np.arange(start, start + length) for start in starts]))
    torn = rewritten(rows, np.random.default_rng(seed).integers(0, HEALTHY.samples, len(rows)), columns=slice(first, None))
    kept = sound_rows(torn).keep
    lost = np.setdiff1d(np.arange(HEALTHY.samples), np.concatenate([rows, kept]))
    assert len(lost) <= len(starts)  # where the arm begins to move, a row beside a cluster may go with it
    assert np.all(np.min(np.abs(lost[:, None] - rows), axis=1, initial=HEALTHY.samples) <= EDGE_ROWS)
    left = np.intersect1d(kept, rows)
    assert np.all(np.abs(torn.q[left] - HEALTHY.q[left]) < 0.02)


def test_torn_clusters_move_no_friction():
    """Every fiftieth row begins five rows of another place: friction at 0.4 rad/s is that of the whole recording, to 1 %."""
    rows = np.concatenate([np.arange(start, start + 5) for start in range(50, 1200, 50)])
    found = identify([rewritten(rows, rows[::-1])], UR5, GROUND, method="robust")
    whole = identify([HEALTHY], UR5, GROUND, method="robust")
    new = {warning.code for warning in found.warnings} - {warning.code for warning in whole.warnings}
    assert {"rejected_rows"} <= new <= {"rejected_rows", "outliers"}  # and no mounting_contradiction
    np.testing.assert_allclose(found.friction_at(0.4)[0], whole.friction_at(0.4)[0], rtol=0.01)


def test_speeds_alone_may_be_torn():
    """Positions and currents are right, and fifty speeds are of other rows: exactly those are left out."""
    rows = np.arange(100, 1100, 20)
    torn = HEALTHY.qd.copy()
    torn[rows] = HEALTHY.qd[(rows + 400) % HEALTHY.samples]
    found = motion(replace(HEALTHY, qd=torn))
    assert found.rejected_why == {"position_jump": len(rows)}


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_rows_written_twice_are_read_once(share):
    """Byte for byte doubled, all or some: the motion is the same, and nothing is called torn."""
    again = np.random.default_rng(0).random(HEALTHY.samples) < share
    rows = np.repeat(np.arange(HEALTHY.samples), 1 + again)
    doubled = replace(HEALTHY, **{name: getattr(HEALTHY, name)[rows] for name in ("t_s", "q", "qd", "current", "temperature_c")})
    found = motion(doubled)
    assert found.rejected_why == {"doubled": int(again.sum())}
    np.testing.assert_array_equal(found.qd, motion(HEALTHY).qd)


def test_a_missed_tick_that_holds_the_last_row_is_left_out():
    """A third of the rows repeat the row before at a later time: they are counted as held, and the rest is one motion."""
    held = np.arange(2, HEALTHY.samples, 3)
    rows = np.arange(HEALTHY.samples)
    rows[held] -= 1
    repeated = replace(HEALTHY, **{name: getattr(HEALTHY, name)[rows] for name in ("q", "qd", "current", "temperature_c")})
    found = motion(repeated)
    assert found.rejected_why["held"] > 0.95 * len(held)  # where no joint moves, the same row again is no contradiction
    assert np.max(np.abs(found.qd - motion(HEALTHY).qd[: found.samples])) < 0.05


@pytest.mark.parametrize("joints", [[3], [0, 5], list(range(6))])
def test_angles_wrapped_into_one_turn_are_unwound(joints):
    """Positions modulo a turn, shifted so that they cross its border: friction is unchanged to 1e-9, and the report says so."""
    q = HEALTHY.q.copy()
    middle = np.median(q[:, joints], axis=0)
    q[:, joints] = (q[:, joints] - middle) % (2.0 * np.pi) + middle
    found, whole = identify([replace(HEALTHY, q=q)], UR5, GROUND), identify([HEALTHY], UR5, GROUND)
    np.testing.assert_allclose(found.friction_at(0.4)[0], whole.friction_at(0.4)[0], rtol=1e-9)
    text = next(warning.text for warning in found.warnings if warning.code == "turns_unwound")
    assert all(str(j + 1) in text for j in joints)


def test_recordings_put_together_are_not_joined_by_the_filter():
    """A stretch from elsewhere, each row of it sound, begins and ends with a jump: it stays, as a stretch of its own, and is told."""
    rows = np.arange(HEALTHY.samples)
    rows[400:600] = np.arange(900, 1100)
    found = motion(replace(HEALTHY, **{name: getattr(HEALTHY, name)[rows] for name in ("q", "qd", "current", "temperature_c")}))
    assert found.rejected_samples == 0
    assert found.segments[-1] == 2
    assert [warning.code for warning in warnings_of(found)] == ["motion_jumps"]


def test_an_arm_that_is_larger_than_any_ur_keeps_its_torques():
    """Torques of 8 kN·m throughout are the arm's; a single one of 10 MN·m is a torn row."""
    torque = HEALTHY.current * 5000.0
    torque[500, 1] = 1e7
    found = motion(replace(HEALTHY, current=None, torque=torque))
    assert found.rejected_why == {"absurd_value": 1}
    assert np.max(np.abs(found.torque)) > 5000.0
