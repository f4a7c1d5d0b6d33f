"""The shipped unit under a real systemd: start, reload, hang, stop, crashes, credentials, and nothing written where it should not be."""

import json
import subprocess
import time
from collections.abc import Iterator

import pytest
from machine import ROOT, Machine, why_not

WHY_NOT = why_not()
pytestmark = [
    pytest.mark.skipif(WHY_NOT is not None, reason=f"NO REAL SYSTEMD IN THIS RUN, the unit is not tested: {WHY_NOT}"),
    pytest.mark.xdist_group("systemd"),
]
PLACES = ("/etc", "/home", "/opt", "/run", "/srv", "/tmp", "/usr/local", "/var", "/dev/shm")  # where programs leave things
UNIT = "joint-monitor@cell-1.service"
CELL = """
[robot]
model = "ur5"
site = "lab"
id = "cell-1"
host = "127.0.89.7"
tool = "credential:tool"
[store]
directory = "/var/lib/joint-monitor/cell-1"
[bus]
listen = ["tcp/127.0.0.1:7447"]
"""
DROP_IN = "[Service]\nWatchdogSec=4\nRestartSec=0.2\nTimeoutAbortSec=1\nLoadCredential=tool:/etc/joint-monitor/tool.secret.toml\n"


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """One that is booted; its service has been started once."""
    configurations = {
        "cell-1": CELL,
        "wrong": CELL.replace("[store]", "[stor]"),
        "crash": CELL.replace("cell-1", "crash").replace("127.0.0.1:7447", "192.0.2.1:7447"),
        "tool.secret": "gripper-7",
    }
    with Machine(tmp_path_factory.mktemp("machine"), configurations, DROP_IN) as booted:
        # inside, root alone may read the secret: the service gets it from systemd
        booted.run("chmod", "600", "/etc/joint-monitor/tool.secret.toml")
        booted.run("systemctl", "start", UNIT, timeout=120)
        yield booted


def pid(machine: Machine) -> int:
    return int(machine.unit(UNIT, "MainPID")["MainPID"])


def test_it_starts_reports_its_state_and_runs_as_an_unprivileged_user(machine: Machine):
    """READY is systemd's word for it; STATUS is worth reading; no capability, no new privileges; the secret was read."""
    told = machine.eventually(UNIT, "SubState", "running", 10.0)
    deadline = time.monotonic() + 20.0
    while "next 2" not in told["StatusText"] and time.monotonic() < deadline:
        time.sleep(0.2)
        told = machine.unit(UNIT, "StatusText", "NRestarts")
    assert "no replay assessed yet" in told["StatusText"], machine.journal("-u", UNIT)
    assert told["NRestarts"] == "0"
    status = dict(line.split(":\t", 1) for line in machine.run("cat", f"/proc/{pid(machine)}/status").stdout.splitlines() if ":\t" in line)
    assert status["CapEff"].strip("0") == ""
    assert status["NoNewPrivs"] == "1"
    assert status["Uid"].split()[0] != "0"
    assert machine.unit(UNIT, "OOMPolicy")["OOMPolicy"] == "continue"
    children: list[str] = []
    while not children and time.monotonic() < deadline + 20.0:  # where there is no arm, the one that listens ends and comes back
        children = machine.run("pgrep", "--parent", str(pid(machine)), check=False).stdout.split()
    assert children  # a process that ran out of memory ends so
    machine.run("kill", "-KILL", *children, check=False)
    said = json.loads(machine.run("cat", "/var/lib/joint-monitor/cell-1/monitor.json").stdout)
    assert said["arm"]["heard"] is False  # there is none: the service runs, and says so
    entries = [json.loads(line) for line in machine.journal("-u", UNIT, "-o", "json").splitlines()]
    watching = next(entry for entry in entries if "watching robot=cell-1" in str(entry.get("MESSAGE")))
    assert watching["JOINT_MONITOR_ROBOT"] == "cell-1"
    assert watching["PRIORITY"] == "6"
    assert "gripper-7" not in str(entries)


def test_the_shipped_units_pass_systemd_analyze(machine: Machine):
    """`systemd-analyze verify` says nothing; exposure is at most 2.0, of which the network makes most."""
    path = "/etc/systemd/system/joint-monitor@.service"
    said = machine.run("systemd-analyze", "verify", path)
    assert said.stdout + said.stderr == ""
    machine.run("systemd-analyze", "security", "--offline=yes", "--threshold=20", path)


def test_a_reload_takes_a_valid_configuration_and_refuses_an_invalid_one(machine: Machine):
    """The same process; the next window is another; a mistake is told and changes nothing."""
    before, path = pid(machine), "/etc/joint-monitor/cell-1.toml"
    inside = ["sh", "-c"]
    machine.run(*inside, f"printf '[schedule]\\ncron = \"0 0 29 2 *\"\\n' >> {path}")
    machine.run("systemctl", "reload", UNIT)
    wait_for(machine, "reloaded: changed schedule.cron")
    machine.run(*inside, f"printf 'grace = 5\\n' >> {path}")
    machine.run("systemctl", "reload", UNIT)
    wait_for(machine, "did you mean grace_s")
    assert pid(machine) == before
    assert machine.unit(UNIT, "SubState")["SubState"] == "running"
    machine.run("sed", "-i", "/^grace = 5/d", path)


def wait_for(machine: Machine, text: str, within_s: float = 10.0) -> None:
    deadline = time.monotonic() + within_s
    while text not in machine.journal("-u", UNIT):
        assert time.monotonic() < deadline, machine.journal("-u", UNIT)[-3000:]
        time.sleep(0.2)


def test_it_writes_nothing_outside_its_own_directories(machine: Machine):
    """What the running service has changed on this machine's disk lies below /var/lib/joint-monitor; and more it could not."""
    changed = machine.run("find", *PLACES, "-xdev", "-user", "joint-monitor", check=False).stdout.split()
    assert changed
    assert [path for path in changed if not path.startswith(("/var/lib/joint-monitor", "/run/credentials/"))] == []  # systemd's hand-over
    inside = ["nsenter", "--target", str(pid(machine)), "--mount", "--", "sh", "-c"]
    for folder in ("/etc", "/usr", "/opt/joint-monitor", "/etc/joint-monitor", "/var/lib"):
        assert machine.run(*inside, f"touch {folder}/mark", check=False).returncode != 0, folder
    assert machine.run(*inside, "ls /home /root", check=False).stdout.split() in ([], ["/home:", "/root:"])


def test_a_daemon_that_hangs_is_ended_and_started_again(machine: Machine):
    """Stopped in its tracks it kicks no watchdog: another process takes its place."""
    before = pid(machine)
    machine.run("kill", "-STOP", str(before))
    deadline = time.monotonic() + 40.0
    while machine.unit(UNIT, "NRestarts")["NRestarts"] == "0":
        assert time.monotonic() < deadline, machine.journal("-u", UNIT)[-3000:]
        time.sleep(0.2)
    machine.eventually(UNIT, "SubState", "running", 60.0)
    assert pid(machine) not in (0, before)
    assert "atchdog" in machine.journal("-u", UNIT)


def test_it_stops_within_five_seconds_and_leaves_no_process(machine: Machine):
    """Children too; the stop is a success. Stopped as `make uninstall` does it: the next boot starts nothing either."""
    recipe = subprocess.run(["make", "--dry-run", "uninstall"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    (line,) = [line for line in recipe.splitlines() if "systemctl stop" in line]
    machine.run("systemctl", "enable", UNIT)
    began = time.monotonic()
    machine.run("sh", "-c", line)
    assert time.monotonic() - began < 5.0
    assert machine.unit(UNIT, "UnitFileState")["UnitFileState"] == "disabled"
    told = machine.unit(UNIT, "Result", "SubState", "TasksCurrent")
    assert (told["Result"], told["SubState"]) == ("success", "dead")
    machine.run("systemctl", "reset-failed", UNIT, check=False)


def test_a_wrong_configuration_is_not_tried_again(machine: Machine):
    """Exit 78, once, with the line and the nearest valid word in the journal."""
    machine.run("systemctl", "start", "joint-monitor@wrong.service", check=False)
    told = machine.eventually("joint-monitor@wrong.service", "SubState", "failed", 20.0)
    assert told["NRestarts"] == "0"
    assert machine.unit("joint-monitor@wrong.service", "ExecMainStatus")["ExecMainStatus"] == "78"
    assert "wrong.toml:8: [stor]: unknown section (did you mean store?)" in machine.journal("-u", "joint-monitor@wrong.service")


@pytest.mark.soak
@pytest.mark.timeout(300)
def test_a_service_that_fails_repeatedly_is_not_restarted_after_five_starts(machine: Machine):
    """An address that is not this machine's: five starts, then a person."""
    machine.run("systemctl", "start", "joint-monitor@crash.service", check=False, timeout=120)
    told = machine.eventually("joint-monitor@crash.service", "SubState", "failed", 120.0)
    assert told["NRestarts"] == "5"
    assert "Start request repeated too quickly" in machine.journal("-u", "joint-monitor@crash.service")
