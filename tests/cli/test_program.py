"""The program as a person runs it: answers on standard output, mistakes as one sentence and exit code 2."""

import json
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from command_line import ended, program

from monitor.publish.client import Client

COLUMNS = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
GAINS = "14.87,13.26,11.13,10.62,11.03,11.47"
COMMANDS = ("run", "simulate", "replay", "identify", "base", "energy", "predict", "watch", "status", "demo")


def refused(*arguments: str) -> str:
    """What the program prints on standard error when it refuses the arguments."""
    done = ended(*arguments)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    return done.stderr


def test_help_names_every_command_and_imports_nothing_heavy():
    """`--help` is quick because it imports neither numpy nor pinocchio nor Zenoh."""
    listed = program("--help").stdout
    for command in COMMANDS:
        assert command in listed
    heavy = {"numpy", "scipy", "pandas", "pinocchio", "zenoh", "rtde_control"}
    code = f"import sys, monitor.cli.main; print(sorted({heavy} & set(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("arguments", [("models",), ("schema", "health"), ("--help",)])
def test_a_disk_that_is_full_below_standard_output_is_one_sentence(arguments):
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-m", "monitor", *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.stderr == "joint-monitor: standard output cannot be written: No space left on device\n"
    assert done.returncode == 1


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str):
    """Each command has a help page."""
    done = ended(command, "--help")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) > 5


def test_a_real_recording_is_identified_as_json(real_data: Path):
    """UR10e, fitted to 50 s, validated on 30 s: errors are at most 9, 5, 6, 8, 8 and 7 %, and 85 % below the manufacturer's parameters."""
    trained, held_out = (str(real_data / "ur10e" / f"ur-20_02_{name}.csv") for name in ("12-50sec_12harm", "10-30sec_12harm"))
    done = program("identify", trained, "--robot", "ur10e", "--columns", COLUMNS, "--gains", GAINS, "--validate", held_out, "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    (validation,) = document["validation"]
    for relative, limit in zip(validation["relative_rms"], (0.09, 0.05, 0.06, 0.08, 0.08, 0.07), strict=True):
        assert relative <= limit
    for rms, nominal in zip(validation["rms_nm"], validation["nominal_rms_nm"], strict=True):
        assert rms <= 0.15 * nominal
    assert document["base_parameters"]["count"] == 52


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ur_standstill/real_10hz.csv", "stands still"),
        ("ur_standstill/ursim_125hz.csv", "stands still"),
        ("ur3_warmup/dataset_02052023.csv", "no joint positions"),
    ],
)
def test_an_uninformative_recording_is_refused_with_the_reason(real_data: Path, name: str, message: str):
    """Recordings of a standing arm and files without positions end with exit code 2 and the reason."""
    assert message in refused("identify", str(real_data / name), "--robot", "ur5")


def test_wrong_arguments_are_sentences(tmp_path: Path):
    """The message says what was wrong and what would be right."""
    table = tmp_path / "table.csv"
    table.write_text("timestamp,actual_q_0\n0.0,1.0\n")
    by_a_process = program("identify", table, "--robot", "ur7")
    assert (by_a_process.returncode, by_a_process.stdout) == (2, "")
    assert "known are" in by_a_process.stderr == refused("identify", table, "--robot", "ur7")
    assert "cannot be read" in refused("status", "--config", str(tmp_path / "no.toml"))
    assert "one a joint" in refused("identify", str(table), "--robot", "ur5", "--gains", "1,2")
    assert "ROLL,PITCH,YAW" in refused("identify", str(table), "--robot", "ur5", "--mounting", "sideways")
    assert "no.csv" in refused("identify", str(tmp_path / "no.csv"), "--robot", "ur5")
    assert "loopback" in refused("simulate", "--bind", "192.168.0.4")


def test_before_the_first_run_the_commands_say_what_is_missing(tmp_path: Path, free_port: int, monkeypatch):
    """Without history or daemon, each command says so in a sentence."""
    monkeypatch.setitem(Client.__init__.__kwdefaults__, "timeout_s", 0.5)  # of patience; a user has five seconds
    config = tmp_path / "cell.toml"
    config.write_text(
        f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n'
        f'[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n[replay]\nallow_motion = false\n'
    )
    numbers = ["--q=0,0,0,0,0,0", "--qd=0,0,0,0,0,0"]
    for arguments, message, code in (
        (["status", "--config", str(config)], "no history yet", 1),
        (["predict", "--config", str(config), *numbers], "nobody answers", 1),
        (["watch", "--config", str(config)], "nobody answers", 1),
        (["predict", "--config", str(config), *numbers, "--local"], "no history yet", 1),
        (["history", "--config", str(config)], "no history yet", 1),
        (["export", "--config", str(config), "-o", str(tmp_path / "table.csv")], "no history yet", 1),
        (["report", "--config", str(config), "-o", str(tmp_path / "report.html")], "no history yet", 1),
        (["assess", "--from-store", "--config", str(config)], "no history yet", 1),
        (["allow", "--config", str(config), "--by", "ada", "--why", "a test"], "no history yet", 1),
        (["serviced", "--config", str(config), "--joint", "3", "--by", "ada", "--why", "a test", "--greased"], "no history yet", 1),
        (["inspected", "--config", str(config), "bolts", "--by", "ada", "--why", "a test"], "no history yet", 1),
        (["plant", "status"], "no database yet", 1),
        (["gateway", "status"], "no database yet", 1),
        (["replay", "--config", str(config), "-o", str(tmp_path / "r.parquet")], "allow_motion", 2),
        (["replay", "--config", str(config), "-o", str(tmp_path / "r.csv")], "Parquet", 2),
    ):
        done = ended(*arguments)
        assert (done.returncode, message in done.stderr) == (code, True), done.stderr
        assert "Traceback" not in done.stderr


def test_a_history_of_before_1_0_ends_run_with_78_and_other_commands_with_2(tmp_path: Path):
    """Starting again would change nothing, so the service manager does not; the sentence says what to do."""
    (tmp_path / "cell.toml").write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n')
    (tmp_path / "history").mkdir()
    with closing(sqlite3.connect(tmp_path / "history" / "history.sqlite")) as connection:
        connection.executescript("CREATE TABLE ledger (id INTEGER PRIMARY KEY); PRAGMA user_version = 10")
    for command, code in (("run", 78), ("status", 2), ("history", 2)):
        done = ended(command, "--config", str(tmp_path / "cell.toml"))
        assert done.returncode == code, done.stderr
        assert "written by a joint-monitor before 1.0 (schema 10)" in done.stderr
        assert "Traceback" not in done.stderr
