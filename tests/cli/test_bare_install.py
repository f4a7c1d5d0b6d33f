"""An installation without extras has what every command needs; who lacks an extra reads which command installs it."""

import ast
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import bare
import pytest

from monitor.cli.main import every_command

ROOT = Path(__file__).parents[2]
OF_EXTRAS = {"duckdb", "dask", "distributed", "asyncua", "rosbags"}
C, P = ("--config", "cell.toml"), ("--config", "plant.toml")
# each command with arguments that take it as far as it gets without an arm, in an order in which each finds what it needs
LINES = {
    "models": (),
    "base": ("--robot", "ur5"),
    "schema": ("health",),
    "init": ("new.toml", "--model", "ur5", "--site", "hall", "--id", "a", "--host", "127.0.0.91", "--no-input"),
    "import": (*C, "--manifest", "days.csv"),
    "identify": ("replay.parquet", "--robot", "ur5", "--plot", "residuals.png"),
    "energy": ("replay.parquet", "--robot", "ur5"),
    "listen": ("replay.parquet", "--robot", "ur5", "--rigid", "replay.parquet"),
    "assess": ("--config", "cell.toml", "--manifest", "days.csv"),
    "design": ("--robot", "ur5", "-o", "new.json", "--evaluations", "20", "--plot", "new.png"),
    "simulate-production": ("pick-place", "-o", "work.parquet", "--hours", "0.02"),
    "status": C,
    "schedule": C,
    "history": C,
    "deploy-files": ("deployed",),
    "export": (*C, "-o", "table.csv"),
    "report": (*C, "-o", "report.html"),
    "predict": (*C, "--local", "--q", "0,-1,1,0,0,0", "--qd", "0,0.5,0,0,0,0"),
    "serviced": (*C, "--joint", "3", "--by", "ada", "--why", "test", "--greased"),
    "inspected": (*C, "bolts", "--by", "ada", "--why", "test"),
    "allow": (*C, "--by", "ada", "--why", "test"),
    "check": C,
    "alerts": C,
    "ack": (*C, "--by", "ada", "j3/wear_rising"),
    "unack": (*C, "--by", "ada", "j3/wear_rising"),
    "shelve": (*C, "--by", "ada", "j3/wear_rising", "--hours", "1"),
    "unshelve": (*C, "--by", "ada", "j3/wear_rising"),
    "replay": (*C, "-o", "new.parquet"),
    "campaign": (*C, "--by", "ada", "--plot", "warm.png"),
    "record": (*C, "-o", "heard.parquet", "--seconds", "1"),
    "script-node": (*C, "-o", "lend.script"),
    "rehearse": (*C, "--arms", "16", "--plot", "rehearsal.png"),
    "prior": ("cell",),
    "query": (*C, "SELECT 1"),
    "reassess": ("cell",),
    "plant enrol": ("arms.csv", "--into", "enrolled", "--router", "hall=tls/router:7447"),
    "plant check": ("arms.csv", "--into", "enrolled"),
    "plant": (*P, "--only-check"),
    "plant user": (*P, "ada", "look"),
    "plant run": P,
    "plant status": P,
    "plant backup": (*P, "plant.backup"),
    "plant restore": (*P, "plant.backup"),
    "plant rebuild": (*P, "--force"),
    "plant forget": (*P, "hall/a", "--force"),
    "gateway": (*P, "--only-check"),
    "gateway check": P,
    "gateway status": P,
    "gateway run": P,
    "run": C,
    "watch": C,
    "try": ("--days", "1"),
    "demo": (),
    "reproduce": ("--robot", "ur5", "--replays", "2", "--evaluations", "100", "-o", "paper.html"),
    "simulate": ("--bind", "127.0.0.92"),
    "simulate-plant": ("--arms", "2", "--days", "2", "--router", "tcp/127.0.0.1:0"),
}
UNTIL_ENDED = ("plant run", "gateway run", "run", "watch", "try", "demo", "reproduce", "rehearse", "simulate", "simulate-plant")
SECONDS = 5.0  # then it has loaded what it serves with


@pytest.fixture(scope="module")
def place(replayed, tmp_path_factory):
    """A folder with a recording, an arm that does not answer, and a plant."""
    folder = tmp_path_factory.mktemp("bare")
    (folder / "replay.parquet").write_bytes(replayed[0].read_bytes())
    (folder / "days.csv").write_text("file,recorded_at\nreplay.parquet,2026-07-18T01:30:35Z\n")
    (folder / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "hall"\nid = "cell"\nhost = "127.0.0.91"\n'
        '[store]\ndirectory = "cell"\n[page]\nlisten = "127.0.0.1:0"\n'
    )
    (folder / "plant.toml").write_text(
        '[plant]\nconnect = ["tcp/127.0.0.1:1"]\ndatabase = "sqlite:///plant.sqlite"\n'
        '[screen]\nlisten = "127.0.0.1:0"\nusers_file = "users"\n'
        '[mqtt]\nhost = "127.0.0.1"\nport = 1\ntls = false\n[notify]\nsmtp = "127.0.0.1:1"\ntls = "none"\nsender = "a@b.example"\n'
        '[[notify.to]]\nname = "ada"\nmail = ["ada@b.example"]\n'
    )
    (folder / "arms.csv").write_text("site,id,model,host\nhall,a,ur5,10.0.0.1\n")
    return folder


def ended(folder: Path, *arguments: str, asked: str = "", within_s: float = 200.0) -> "subprocess.CompletedProcess[str]":
    """What a command of a bare installation says; one that goes on is asked to end after `within_s`."""
    command = [sys.executable, bare.__file__, *arguments]
    with subprocess.Popen(
        command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            output, errors = process.communicate(asked, timeout=within_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGTERM)
            output, errors = process.communicate(timeout=60.0)
    return subprocess.CompletedProcess(command, process.returncode, output, errors)


def test_the_table_names_every_command():
    """A command that is new is tried here, too."""
    assert sorted(LINES) == sorted(name for name, _ in every_command())


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_no_command_of_a_bare_installation_ends_in_a_traceback(place):
    """It does its work, or says in a sentence what is wrong; a package is named by `query` and `reassess` alone, with what installs it."""
    served = {command: ended(place, *command.split(), *LINES[command], within_s=SECONDS) for command in UNTIL_ENDED}
    lines = {command: [*command.split(), *LINES[command]] for command in LINES if command not in UNTIL_ENDED}
    answers = ended(place, "--lines", asked=json.dumps(list(lines.values())))
    assert answers.returncode == 0, answers.stderr
    results = dict(zip(lines, json.loads(answers.stdout), strict=True))
    results |= {command: (done.returncode, done.stdout + done.stderr) for command, done in served.items()}
    for command, (_, said) in results.items():
        assert "Traceback" not in said, said
        assert "Usage:" not in said, said
        assert ("not installed" in said) == (command in {"query", "reassess"}), said
    for command, module in (("query", "duckdb"), ("reassess", "dask")):
        code, said = results[command]
        assert code == 2
        assert f"joint-monitor: {command} needs the package {module}, which is not installed here. This installs it: " in said
        assert re.search(rf"{re.escape(sys.executable)} -m pip install .*{module}[<>=]", said)


@pytest.mark.slow
def test_a_channel_of_an_extra_is_named_by_gateway_check_and_ends_a_gateway_as_a_wrong_configuration(place):
    """OPC UA and ROS 2 need the extra `gateway`: a finding, and exit 78 of the service."""
    (place / "channels.toml").write_text(
        '[plant]\n[opcua]\nlisten = "127.0.0.1:4849"\nallow_anonymous = true\n[ros2]\nconnect = "tcp/127.0.0.1:1"\n'
    )
    found = ended(place, "gateway", "check", "--config", "channels.toml")
    for module, section in (("asyncua", "opcua"), ("rosbags", "ros2")):
        assert f"FAILED: [{section}] needs the package {module}, which is not installed here" in found.stdout, found
    assert ended(place, "gateway", "run", "--config", "channels.toml").returncode == 78


def test_what_is_imported_is_asked_for_and_what_only_an_extra_brings_is_known():
    """Every import in the package, also those within functions: of a package that a bare installation brings, or of the extras above."""
    modules = set()
    for path in (ROOT / "monitor").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module]
            modules |= {name.partition(".")[0] for name in names}
    assert modules & bare.absent() == OF_EXTRAS


@pytest.mark.slow
def test_a_bag_of_ros_names_the_package_that_it_needs(place):
    """With what installs it; nothing is named that no index has."""
    (place / "drive.db3").write_bytes(b"SQLite format 3\0" + b"\0" * 100)
    by_command = ended(place, "identify", "drive.db3", "--robot", "ur5")
    assert (by_command.returncode, "Traceback" in by_command.stderr) == (2, False)
    assert "needs the package rosbags, which is not installed here. This installs it: " in by_command.stderr
    assert "joint-monitor[" not in by_command.stderr
