"""What a person types in the first hour and what is nearly right: the answer says what would be right."""

import os

import pytest
from command_line import ended
from typer.testing import CliRunner

from monitor.cli.main import app

CELL = '[robot]\nmodel = "ur5"\nsite = "hall"\nid = "cell-1"\n[bus]\nlisten = ["tcp/127.0.0.1:{port}"]\n[store]\ndirectory = "history"\n'


@pytest.fixture
def cell(tmp_path, free_port):
    """A configuration whose monitor has never run."""
    path = tmp_path / "cell-1.toml"
    path.write_text(CELL.format(port=free_port))
    return path


@pytest.mark.parametrize(
    ("given", "right"),
    [
        (("check", "{cell}"), "joint-monitor check --config {cell}"),
        (("run", "{cell}", "--now"), "joint-monitor run --now --config {cell}"),
        (("history", "--json", "{cell}"), "joint-monitor history --json --config {cell}"),
        (("init", "--config", "{cell}"), "joint-monitor init {cell}"),
    ],
)
def test_a_file_without_its_option_is_answered_by_the_command_that_was_meant(cell, given, right):
    """`check cell-1.toml` names a file and no option: the whole command that would be right is said."""
    result = ended(*(part.format(cell=cell) for part in given))
    assert result.returncode == 2
    assert right.format(cell=cell) in result.stderr.replace("\n", " ")


@pytest.mark.parametrize(
    "given",
    [
        ("try", "--scenario", "other.toml", "extra"),
        ("check", "--config=cell-1.toml", "other.toml"),
        ("check", "-ccell-1.toml", "other.toml"),
    ],
)
def test_a_file_that_another_option_names_is_no_configuration(given):
    """The value of an option is that; and where a configuration is named already, a second one is not what was meant."""
    result = ended(*given)
    assert (result.returncode, "nexpected extra argument" in result.stderr) == (2, True)
    assert "meant is perhaps" not in result.stderr


def test_a_file_beside_the_variable_is_not_passed_over(cell, monkeypatch):
    """The variable names one configuration, the line another: which one is meant is asked, not guessed."""
    monkeypatch.setenv("JOINT_MONITOR_CONFIG", str(cell))
    result = ended("check", "other.toml")
    assert result.returncode == 2
    assert "joint-monitor check --config other.toml" in result.stderr.replace("\n", " ")


def test_production_on_an_arm_without_a_history_says_so_and_blames_no_daemon(cell):
    """Nothing was learnt, so nothing could change; a wrong date and a wrong joint are named first."""
    production = ("serviced", "--config", cell, "--greased", "--by", "Ada", "--why", "noise")
    never = ended(*production, "--joint", "elbow")
    assert never.returncode == 1
    assert "no history yet" in never.stderr
    assert "nobody answers" not in never.stderr
    late = ended(*production, "--joint", "elbow", "--at", "yesterday")
    assert (late.returncode, "'yesterday': not a date" in late.stderr) == (2, True)
    joint = ended(*production, "--joint", "9")
    assert (joint.returncode, "expected 1 to 6, or one of base" in joint.stderr) == (2, True)


def test_every_command_knows_a_joint_by_its_name(cell):
    """history and status take what serviced takes."""
    for command in (("history", "--joint"), ("status", "--why")):
        named = ended(*command, "elbow", "--config", cell)
        assert (named.returncode, "no history yet" in named.stderr) == (1, True), named.stderr
        wrong = ended(*command, "ellbow", "--config", cell)
        assert (wrong.returncode, "or one of base, shoulder, elbow" in wrong.stderr) == (2, True), wrong.stderr


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("simulate --robot ur", "ur16e"),
        ("simulate --scenario jo", "joint-wearing"),
        ("init --model ur5", "ur5e"),
        ("try --robot ur3", "ur3e"),
        ("identify --robot ur1", "ur10e"),
        ("design --robot ur1", "ur10e"),
    ],
)
def test_the_shell_completes_models_and_scenarios(line, expected, monkeypatch):
    """What `--install-completion` sets up asks the program itself."""
    words = f"joint-monitor {line}"
    monkeypatch.setenv("_JOINT_MONITOR_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    result = CliRunner().invoke(app, prog_name="joint-monitor", env=dict(os.environ))
    assert expected in result.output.split()


def test_an_address_at_which_nobody_answers_is_asked_again_before_it_is_taken(tmp_path, monkeypatch):
    """A mistyped address is noticed at once; Enter keeps it for an arm that is off; what is no address is refused."""
    monkeypatch.chdir(tmp_path)
    said = ["http://192.168.0.10/", "8.8.8.8", "127.0.31.250", "", "ur5", *[""] * 12, "n", "n"]
    result = CliRunner().invoke(app, ["init", "cell-9.toml"], input="\n".join(said) + "\n")
    assert result.exit_code == 0, result.output
    assert result.output.count("Error: host") == 2
    assert "Enter keeps 127.0.31.250" in result.output
    assert 'host = "127.0.31.250"' in (tmp_path / "cell-9.toml").read_text()


def test_an_option_that_is_no_address_is_refused_before_anything_is_written(tmp_path):
    """The same with --host."""
    result = ended("init", tmp_path / "a.toml", "--host", "robot.example", "--model", "ur5", "--no-input")
    assert (result.returncode, "--host" in result.stderr) == (2, True)
    assert "literal IPv4 address, as 192.168.0.10" in result.stderr
    assert not (tmp_path / "a.toml").exists()


def test_the_next_command_for_a_service_is_one_of_its_user(tmp_path, monkeypatch):
    """What root would run there made a history that the service may not write."""
    monkeypatch.setattr("monitor.cli.init.FOR_ALL", tmp_path)
    result = CliRunner().invoke(
        app, ["init", str(tmp_path / "cell-1.toml"), "--host", "-", "--model", "ur5", "--no-input", "--allow-motion"]
    )
    assert result.exit_code == 0, result.output
    assert "sudo -u joint-monitor joint-monitor check --config cell-1" in result.output
    assert "systemctl enable --now joint-monitor@cell-1" in result.output
