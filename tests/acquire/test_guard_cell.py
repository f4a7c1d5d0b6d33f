"""A trajectory moves only in the cell it was proved against, and only if the way to its start is clear."""

import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitations import short

from monitor.acquire.safety import guard, limits
from monitor.acquire.settings import ReplaySettings
from monitor.config.files import find_excitation
from monitor.design.cell import Box, Cell, plain_cell
from monitor.errors import BadConfiguration, MotionRefused
from monitor.model.robot import Mounting, load_robot

UR5 = load_robot("ur5")
PLAIN = plain_cell(Mounting())
SETTINGS = ReplaySettings(host="127.0.0.1", allow_motion=True, cell=PLAIN)
GROUND = find_excitation("ur5-ground", Path())
CRATE = Box(name="crate", centre_m=(0.9, 0.0, 0.1), size_m=(0.2, 0.2, 0.2))


def test_the_shipped_trajectory_may_be_played_in_the_plain_cell():
    """The other tests would prove nothing if everything were refused."""
    guard.check_all(SETTINGS, GROUND, UR5)
    guard.check_all(SETTINGS, replace(GROUND, time_scale=0.25, repetitions=1), UR5)


def test_a_different_cell_is_refused_with_what_differs():
    """Both digests and the table: a box that was put there after the design."""
    with pytest.raises(MotionRefused, match=rf"{PLAIN.digest}.*they differ in box; design one for this cell"):
        guard.check_all(replace(SETTINGS, cell=Cell(name="new", boxes=(CRATE,))), GROUND, UR5)
    with pytest.raises(MotionRefused, match=r"they differ in cell\.margin_m"):
        guard.check_all(replace(SETTINGS, cell=Cell(margin_m=0.05)), GROUND, UR5)


def test_a_trajectory_without_a_proof_is_refused_where_a_cell_is_known():
    """An old file can be read, but not be played by accident."""
    with pytest.raises(MotionRefused, match="never proved against a cell"):
        guard.check_all(SETTINGS, short(), UR5)
    guard.check_all(replace(SETTINGS, cell=None), short(), UR5)


def test_a_trajectory_that_was_changed_by_hand_is_found_out():
    """The proof is done again: the elbow's swing doubled folds the arm into itself, whatever the file says."""
    a, b = GROUND.a_rad_s.copy(), GROUND.b_rad_s.copy()
    offset = GROUND.offset_rad + np.array([0.0, 0.9, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(MotionRefused, match=r"does not keep clear in the cell 'plain', whatever its file says: .* short of"):
        guard.check_all(SETTINGS, replace(GROUND, a_rad_s=a, b_rad_s=b, offset_rad=offset), UR5)


def test_an_approach_through_the_table_is_refused_and_one_from_home_is_not():
    """The straight way in joint space from where the arm stands."""
    limits.clear_approach(PLAIN, GROUND, UR5, np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0]))
    below = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(MotionRefused, match=r"on the straight way .* mounting surface come to be .* inside each other"):
        limits.clear_approach(PLAIN, GROUND, UR5, below)


def configured(folder: Path, **replay: object):
    from monitor.config.load import from_document

    return from_document({"robot": {"model": "ur5", "site": "lab", "id": "a"}, "replay": replay}, folder / "monitor.toml")


def test_the_configuration_names_the_cell_and_the_pace(tmp_path: Path):
    """Plain unless said otherwise; a file; unchecked only by that word; a slow first pass is a figure."""
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


def test_a_job_for_the_child_is_plain_json():
    """What the parent writes to its child: the cell goes as its document, the settings without it."""
    from monitor.design.cell import cell_from_document

    settings = dataclasses.asdict(replace(SETTINGS, cell=None))
    assert ReplaySettings(**json.loads(json.dumps({**settings, "joint_temperature_range_c": [0.0, 75.0]}))).cell is None
    assert cell_from_document(json.loads(json.dumps(PLAIN.as_document()))) == PLAIN
