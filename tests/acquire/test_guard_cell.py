"""A trajectory is played only in the cell against which it was proved, and only where the way to its start is clear."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitations import short
from test_guard import may_be_played

from monitor.acquire.driver import ReplayTask
from monitor.acquire.safety import of_configuration as limits
from monitor.acquire.safety.way import Left
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.config.files import find_excitation
from monitor.design.cell import Box, Cell, plain_cell
from monitor.errors import BadConfiguration, MotionRefused
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context

UR5 = load_robot("ur5")
PLAIN = plain_cell(Mounting())
SETTINGS = ReplaySettings(host="127.0.0.1", allow_motion=True, cell=PLAIN)
GROUND = find_excitation("ur5-ground", Path())
CRATE = Box(name="crate", centre_m=(0.9, 0.0, 0.1), size_m=(0.2, 0.2, 0.2))


def test_the_shipped_trajectory_may_be_played_in_the_plain_cell():
    """Without this, a guard that refuses everything would pass the tests below."""
    may_be_played(SETTINGS, GROUND, UR5)
    may_be_played(SETTINGS, replace(GROUND, time_scale=0.25, repetitions=1), UR5)


def test_a_different_cell_is_refused_with_what_differs():
    """A box was added after the design; the message has both digests and the table that differs."""
    with pytest.raises(MotionRefused, match=rf"{PLAIN.digest}.*they differ in box; design one for this cell"):
        may_be_played(replace(SETTINGS, cell=Cell(name="new", boxes=(CRATE,))), GROUND, UR5)
    with pytest.raises(MotionRefused, match=r"they differ in cell\.margin_m"):
        may_be_played(replace(SETTINGS, cell=Cell(margin_m=0.05)), GROUND, UR5)


def test_a_trajectory_without_a_proof_is_refused_where_a_cell_is_known():
    """A file without a proof can be read, but it is not played in a described cell."""
    with pytest.raises(MotionRefused, match="never proved against a cell"):
        may_be_played(SETTINGS, short(), UR5)
    may_be_played(replace(SETTINGS, cell=None), short(), UR5)


def test_a_trajectory_that_was_changed_by_hand_is_detected():
    """The proof is repeated: with twice the swing of the elbow the arm collides with itself, although the file says it is clear."""
    a, b = GROUND.a_rad_s.copy(), GROUND.b_rad_s.copy()
    offset = GROUND.offset_rad + np.array([0.0, 0.9, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(MotionRefused, match=r"does not keep clear in the cell 'plain', whatever its file says: .* short of"):
        may_be_played(SETTINGS, replace(GROUND, a_rad_s=a, b_rad_s=b, offset_rad=offset), UR5)


def test_an_approach_through_the_table_is_refused_and_one_from_home_is_not():
    """The straight way in joint space from the present position is checked."""
    start = GROUND.at(np.zeros(1)).q[0]
    limits.clear_line(PLAIN, GROUND, UR5, np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0]), start)
    below = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(MotionRefused, match=r"on the straight way .* mounting surface come to be .* inside each other"):
        limits.clear_line(PLAIN, GROUND, UR5, below, start)


def configured(folder: Path, **replay: object):
    from monitor.config.load import from_document

    return from_document({"robot": {"model": "ur5", "site": "lab", "id": "a"}, "replay": replay}, folder / "monitor.toml")


def test_the_configuration_names_the_cell_and_the_speed_of_first_passes(tmp_path: Path):
    """The cell is the plain one by default, or a file's; it is unchecked only by that word. First passes are as slow as configured."""
    assert configured(tmp_path).replay.cell == PLAIN
    assert configured(tmp_path, cell="unchecked").replay.cell is None
    (tmp_path / "press.toml").write_text('[[box]]\nname = "crate"\ncentre_m = [0.9, 0, 0.1]\nsize_m = [0.2, 0.2, 0.2]\n')
    cell = configured(tmp_path, cell="press.toml").replay.cell
    assert cell is not None
    assert cell.boxes == (CRATE,)
    assert configured(tmp_path, time_scale=0.25).excitation.duration_s == 4.0 * configured(tmp_path).excitation.duration_s
    for wrong, words in (
        ({"cell": "absent.toml"}, "replay.cell.*plain, unchecked"),
        ({"cell": 3}, "replay.cell"),
        ({"time_scale": 0}, "time_scale"),
    ):
        with pytest.raises(BadConfiguration, match=words):
            configured(tmp_path, **wrong)
    (tmp_path / "bad.toml").write_text("[cell]\nmargn_m = 1\n")
    with pytest.raises(BadConfiguration, match=r"bad\.toml.*margn_m"):
        configured(tmp_path, cell="bad.toml")


@pytest.mark.parametrize("cell", [None, PLAIN])
def test_a_job_reaches_the_process_that_moves_the_arm_unchanged(cell):
    """It travels pickled, by standard input: with its cell or without, with the limits of the arm and all of the installation."""
    task = ReplayTask(
        settings=replace(SETTINGS, cell=cell),
        excitation=GROUND,
        robot=replace(UR5, max_speed_rad_s=np.ones(6)),
        context=Context(payload_kg=1.5),
        installation=Installation(gains_nm_per_a=(1.0,) * 6, safety_planes=((1.0, 0.0, 0.0, 0.6),)),
        left=Left(path_digest="1", on_path=True, q=(0.1,) * 6),
    )
    read = pickle.loads(pickle.dumps(task))
    assert (read.settings, read.context, read.installation, read.left) == (task.settings, task.context, task.installation, task.left)
    assert read.excitation.digest == GROUND.digest
    assert np.array_equal(read.robot.max_speed_rad_s, np.ones(6))
    assert np.array_equal(read.robot.max_torque_nm, UR5.max_torque_nm)
