"""`joint-monitor init` writes a configuration that is right, from what the arm says and what a person answers, and says what is next."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_line import ended
from simulated_arm import simulated_arm
from typer.testing import CliRunner

from monitor.cli.init import free_ports
from monitor.cli.main import app
from monitor.config.load import load
from monitor.errors import BadInput
from monitor.identify.gains import gains_from_torque
from monitor.model.reported_gains import REPORTED_GAINS
from monitor.model.robot import load_robot
from monitor.simulate.arm.physics import drive_gain

HOST = "127.0.31.2"
ON_PAPER = ("--model", "ur5e", "--no-input", "--host", "-")


@pytest.fixture(scope="module")
def arm():
    """A simulated UR5e whose software reports torque beside current, with a payload on the ceiling."""
    with simulated_arm(HOST, "--robot", "ur5e", "--polyscope", "5.23.0", "--payload", "1.2", "--mounting", "ceiling") as host:
        yield host


def test_an_arm_tells_what_it_knows_and_the_file_is_right(arm, tmp_path):
    """Model, serial number, payload, mounting, tool centre point and gains are its own; motion stays off; the next command is said."""
    path = tmp_path / "cell-7.toml"
    result = ended("init", path, "--host", arm, "--no-input", "--tool", "gripper")
    assert result.returncode == 0, result.stderr
    made = load(path)
    assert (made.robot.model, made.robot.id, made.robot.serial, made.robot.mounting) == ("ur5e", "cell-7", "20180500001", "ceiling")
    assert made.robot.payload_kg == 1.2
    assert made.robot.payload_cog_m == (0.0, 0.0, 0.05)
    assert made.robot.tcp_offset == (0.0,) * 6
    np.testing.assert_allclose(made.robot.gains_nm_per_a, drive_gain(load_robot("ur5e")), rtol=1e-3)
    assert made.replay.allow_motion is False
    assert "actual_current_as_torque" in path.read_text("utf-8")
    assert "only allow_motion speaks against a motion" in result.stdout
    assert f"joint-monitor run --config {path} --now" in result.stdout


def test_a_command_that_is_next_can_be_typed_where_the_path_has_a_space(tmp_path):
    folder = tmp_path / "my cells"
    folder.mkdir()
    said = ended("init", folder / "cell.toml", "--model", "ur5e", "--host", "-", "--no-input").stdout
    assert f"--config '{folder / 'cell.toml'}'" in said


def test_a_polyscope_x_is_asked_at_the_port_of_its_robot_api(tmp_path):
    """A simulated one may not have port 80, and the file had to be written by hand; the port is kept, and the arm tells what it can."""
    path = tmp_path / "cell-x.toml"
    options = ("--robot", "ur5e", "--polyscope", "10.14.0", "--robot-api-port", "18081")
    with simulated_arm("127.0.31.4", *options) as host:
        result = ended("init", path, "--host", host, "--robot-api-port", "18081", "--no-input", "--simulated")
    assert result.returncode == 0, result.stderr
    made = load(path)
    assert (made.robot.robot_api_port, made.robot.model, made.robot.serial) == (18081, "ur5e", "20180500001")
    assert "software 10.14.0" in result.stdout


def test_a_person_answers_what_no_option_says(tmp_path, monkeypatch):
    """Questions come in order, a wrong answer is asked again, Enter takes the bracket."""
    monkeypatch.chdir(tmp_path)
    said = ["", "ur99", "ur5e", "hall-2", "press-3", "", "", "2.5", "0,0,0.06", "", "", "gripper", "", "", "Europe/Berlin", "at noon", ""]
    result = CliRunner().invoke(app, ["init"], input="\n".join([*said, "n", "y"]) + "\n")
    assert result.exit_code == 0, result.output
    assert "robot 'ur99' is not known; known are" in result.output
    made = load(tmp_path / "press-3.toml")
    assert (made.robot.site, made.robot.payload_kg, made.robot.payload_cog_m) == ("hall-2", 2.5, (0.0, 0.0, 0.06))
    assert made.schedule.timezone == "Europe/Berlin"
    assert made.schedule.cron == "0 3 * * *"
    assert made.replay.allow_motion is False
    assert made.robot.gains_nm_per_a == REPORTED_GAINS["ur5e"].values_nm_per_a


def test_nothing_is_written_over_and_an_answer_that_does_not_come_writes_nothing(tmp_path, monkeypatch):
    """--force replaces; a missing answer names the option."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "cell.toml"
    assert ended("init", path, *ON_PAPER).returncode == 0
    first = path.read_text("utf-8")
    refused = ended("init", path, *ON_PAPER, "--payload", "3")
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert path.read_text("utf-8") == first
    assert ended("init", path, *ON_PAPER, "--payload", "3", "--force").returncode == 0
    assert load(path).robot.payload_kg == 3.0
    unanswered = ended("init", "other.toml", "--no-input", "--host", "-")
    assert unanswered.returncode == 2
    assert "--model is missing" in unanswered.stderr
    silent = CliRunner().invoke(app, ["init", "other.toml", "--host", "-"], input="")
    assert "--no-input" in str(silent.exception)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["cell.toml"]


def test_a_name_that_is_no_key_and_a_model_that_nobody_gave_are_refused_by_their_own_names(tmp_path):
    """The name of the arm is not called a site, and where nobody is asked no sentence says so."""
    refused = ended("init", tmp_path / "a.toml", *ON_PAPER, "--id", "Cell 1")
    assert (refused.returncode, "--id: robot id 'Cell 1': expected only" in refused.stderr) == (2, True)
    silent = ended("init", tmp_path / "a.toml", "--no-input", "--host", "127.0.31.99")
    assert silent.returncode == 2
    assert "is asked" not in silent.stderr
    assert "--model is missing (Model, e.g. ur5e)" in silent.stderr


def test_a_cell_is_described_and_its_trajectory_is_the_next_command(tmp_path):
    """Walls, boxes and tool go into a file of the cells' format; the file still loads, and `design` is named with every option."""
    path = tmp_path / "cell-1.toml"
    described = ("--table-top", "-0.4", "--wall", "fence=0,0.9,0/0,-1,0", "--box", "press=-0.9,0,0.3/0.5,0.8,1.2", "--tool-length", "0.14")
    result = ended("init", path, *ON_PAPER, *described)
    assert result.returncode == 0, result.stderr
    cell = load(path).replay.cell
    assert [wall.name for wall in cell.walls] == ["fence"]
    assert [box.name for box in cell.boxes] == ["press"]
    assert cell.tool.end_m == (0.0, 0.0, 0.14)
    assert f"joint-monitor design --robot ur5e --mounting ground --cell {tmp_path / 'cell-1-cell.toml'}" in result.stdout
    wrong = ended("init", tmp_path / "b.toml", *ON_PAPER, "--wall", "fence")
    assert wrong.returncode == 2
    assert "NAME=X,Y,Z/NX,NY,NZ" in wrong.stderr


def test_gains_come_from_a_payload_pair_of_recordings(pair, tmp_path):
    """Of a model that publishes none; without the mass it is refused."""
    empty, loaded = pair
    path = tmp_path / "cell.toml"
    mass = ("--payload-pair", empty, loaded, "--pair-payload", "3.0", "--pair-cog", "0,0,0.05")
    result = ended("init", path, "--model", "ur5", "--no-input", "--host", "-", *mass)
    assert result.returncode == 0, result.stderr
    np.testing.assert_allclose(load(path).robot.gains_nm_per_a[:5], load_robot("ur5").drive_gain_nm_per_a[:5], rtol=0.1)
    assert f"from {empty.name} and {loaded.name}" in path.read_text("utf-8").replace("\n# ", " ")
    assert "--pair-payload" in ended("init", path, *ON_PAPER, "--force", "--payload-pair", empty, loaded).stderr


def test_a_model_without_any_gains_gets_none_and_is_told_how_they_are_found(tmp_path):
    """Motion cannot be allowed then; the file that only listens is written."""
    path = tmp_path / "cell.toml"
    options = ("--model", "ur3e", "--no-input", "--host", "-")
    result = ended("init", path, *options)
    assert result.returncode == 0, result.stderr
    assert "gains_nm_per_a" not in tomllib.loads(path.read_text("utf-8"))["robot"]
    assert "joint-monitor record" in result.stdout
    refused = ended("init", tmp_path / "b.toml", *options, "--allow-motion")
    assert refused.returncode == 2
    assert "robot.gains_nm_per_a" in refused.stderr
    assert not (tmp_path / "b.toml").exists()


def test_a_second_arm_of_a_folder_gets_its_own_ports(tmp_path):
    """Two daemons on one machine cannot share the port of bus or page."""
    for name in ("a", "b"):
        assert ended("init", tmp_path / f"{name}.toml", *ON_PAPER).returncode == 0
    first, second = (load(tmp_path / f"{name}.toml") for name in ("a", "b"))
    assert first.bus.listen != second.bus.listen
    assert first.page.listen != second.page.listen


def test_a_neighbour_that_may_not_be_read_is_named_and_a_folder_that_may_not_be_written_is_refused_first(tmp_path, monkeypatch):
    """Both ended late: one with a traceback, the other after the last question."""
    (tmp_path / "other.toml").write_text("")

    def refused(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "read_text", refused)
        assert free_ports(tmp_path / "a.toml") == (7447, 8420)
    monkeypatch.setattr("monitor.cli.init.os.access", lambda path, mode: False)
    told = CliRunner().invoke(app, ["init", str(tmp_path / "a.toml"), *ON_PAPER])
    assert isinstance(told.exception, BadInput)
    assert "may not be written by this user" in str(told.exception)


def test_a_torque_that_is_no_multiple_of_the_current_gives_no_gain():
    """As a controller reports it that takes gravity away; noise alone of a real multiple is enough."""
    rng = np.random.default_rng(0)
    current, gains = rng.normal(0.0, 0.05, (100, 6)), np.array([10.0, 9.0, 8.0, 7.0, 6.0, 5.0])
    np.testing.assert_allclose(gains_from_torque(current, current * gains), gains)
    assert np.all(np.isnan(gains_from_torque(current, (current + 0.1 * rng.normal(size=(100, 6))) * gains)))
    assert np.all(np.isnan(gains_from_torque(np.zeros((100, 6)), np.zeros((100, 6)))))


def test_reported_gains_are_plausible_for_their_model():
    """Each needs between 0.5 and 100 A for the joint's largest torque, and says where it is from."""
    for name, reported in REPORTED_GAINS.items():
        current = load_robot(name).max_torque_nm / np.array(reported.values_nm_per_a)
        assert np.all((current > 0.5) & (current < 100.0))
        assert len(reported.source) > 40


def test_an_arm_that_nobody_named_is_not_told_as_one_that_is_there(tmp_path):
    """The file asks for its address, and `check` says what it takes an address of this machine for."""
    assert ended("init", tmp_path / "cell.toml", *ON_PAPER).returncode == 0
    assert (
        'host = "127.0.0.1" # the controller: a simulated one on this machine; else put its address here'
        in (tmp_path / "cell.toml").read_text()
    )
    checked = ended("check", "--config", tmp_path / "cell.toml", "--json")
    (address,) = [each for each in json.loads(checked.stdout)["conditions"] if each["name"] == "address"]
    assert address["text"] == "127.0.0.1 is this machine: an arm here is taken for a simulated one"


def test_the_file_is_whole_or_absent(tmp_path, monkeypatch):
    """A disk that fails while it is written leaves the earlier file and no other."""
    path = tmp_path / "cell.toml"
    assert ended("init", path, *ON_PAPER).returncode == 0
    first = path.read_text("utf-8")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("monitor.config.first_file.os.fsync", full)
    failed = ended("init", path, *ON_PAPER, "--force")
    assert failed.returncode == 2
    assert "No space left" in failed.stderr
    assert list(Path(tmp_path).iterdir()) == [path]
    assert path.read_text("utf-8") == first
