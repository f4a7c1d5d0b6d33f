"""The service in real processes, with the real wire and real Zenoh, and SIGKILL during a replay."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command_line import ended
from prepared import Process, run

from monitor.errors import BusError
from monitor.publish.client import Client
from monitor.simulate.remote import Remote
from monitor.store.store import Store

pytestmark = pytest.mark.real_time

FOURIER = {"a": [0.30, -0.20, 0.10, -0.25, 0.05], "b": [0.20, -0.10, 0.05, 0.10, -0.07]}  # Σa = 0, Σk·b = 0


def excitation(folder: Path) -> Path:
    """A short excitation keeps the test short: 4 s, with at least a few tenths of a rad/s at every joint."""
    a, b = list(FOURIER["a"]), list(FOURIER["b"])
    b[4] = -sum((k + 1) * value for k, value in enumerate(b[:4])) / 5
    phases = (1.0, -0.7, 0.9, -1.2, 1.1, 1.3)
    document = {
        "kind": "joint-monitor.excitation.v1",
        "robot": "ur5",
        "mounting_deg": [0, 0, 0],
        "period_s": 6.0,
        "repetitions": 1,
        "offset_rad": [0.0, -1.5707963, 0.0, -1.5707963, 0.0, 0.0],
        "a_rad_s": [[2.0 * a[(k + j) % 5] * phases[j] for j in range(6)] for k in range(5)],
        "b_rad_s": [[b[k] * phases[j] for j in range(6)] for k in range(5)],
    }
    path = folder / "short.json"
    path.write_text(json.dumps(document))
    return path


class Cell:
    """A simulated arm and the configuration of its monitor."""

    def __init__(self, folder: Path, host: str, port: int) -> None:
        self.folder, self.host = folder, host
        self.started: list[subprocess.Popen[str]] = []
        self.endpoint = f"tcp/127.0.0.1:{port}"
        excitation(folder)
        self.config = folder / "cell.toml"
        self.config.write_text(
            f"""
            [robot]
            model = "ur5"
            site = "lab"
            id = "cell-1"
            host = "{host}"
            [replay]
            allow_motion = true
            excitation = "short.json"
            cell = "unchecked"
            first_pass = false
            approach_speed_rad_s = 0.8
            [schedule]
            cron = "0 0 29 2 *"
            [quality]  # a busy machine: here the flow is tested, not the figures
            max_missed_share = 1.0
            max_late_share = 1.0
            max_slipped_s = 10.0
            [store]
            directory = "history"
            [bus]
            listen = ["{self.endpoint}"]
            """
        )

    def daemon(self, *arguments: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "monitor", "run", "--config", str(self.config), *arguments]
        self.started.append(Process(command, stderr=subprocess.PIPE, text=True))
        return self.started[-1]

    def end(self) -> None:
        """Processes that a failed test left would hold the port and the arm of the next attempt."""
        for process in self.started:
            if process.poll() is None:
                process.kill()
                process.communicate()

    def client(self, within_s: float = 20.0) -> Client:
        """Waits for the daemon to open its endpoint."""
        deadline = time.monotonic() + within_s
        while True:
            try:
                return Client(self.endpoint, "lab", "cell-1", timeout_s=1.0)
            except BusError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)

    def ledger(self) -> list:
        with Store.reader(self.folder / "history") as store:
            return store.ledger.rows()


def eventually(condition: Callable[[], bool], within_s: float) -> bool:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return False


def children(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task")
    return [int(child) for task in path.iterdir() for child in (task / "children").read_text().split()]


def loaded(pid: int) -> set[str]:
    """Which of the large packages a process has loaded: their compiled parts are in its memory."""
    maps, packages = (
        Path(f"/proc/{pid}/maps").read_text(),
        ("numpy", "scipy/linalg", "scipy/special", "pinocchio", "pyarrow", "pandas", "matplotlib", "clarabel", "rtde"),
    )
    return {package for package in packages if re.search(rf"site-packages/{package}[/_.].*\.so", maps)}


def gone(pids: list[int]) -> bool:
    return not any(Path(f"/proc/{pid}").exists() and "Z" not in Path(f"/proc/{pid}/stat").read_text().split()[2] for pid in pids)


@pytest.fixture
def cell(tmp_path: Path, free_port: int, worker_id: str) -> Iterator[tuple[Cell, Remote]]:
    host = f"127.0.5.{10 + (0 if worker_id == 'master' else int(worker_id[2:]))}"
    simulator = Process([sys.executable, "-m", "monitor.simulate", "--bind", host], stdout=subprocess.PIPE, text=True)
    try:
        assert simulator.stdout.readline().startswith("listening")
        cell = Cell(tmp_path, host, free_port)
        with Remote(host) as remote:
            try:
                yield cell, remote
            finally:
                cell.end()
    finally:
        simulator.terminate()
        simulator.wait(timeout=10)


def moving(remote: Remote) -> bool:
    return max(abs(speed) for speed in remote.truth()["qd"]) > 0.3


def standing(remote: Remote) -> bool:
    return max(abs(speed) for speed in remote.truth()["qd"]) < 1e-3


def stop(process: "subprocess.Popen[str]") -> str:
    process.send_signal(signal.SIGTERM)
    _, output = process.communicate(timeout=15)
    assert process.returncode == 0, output
    return output


def test_a_replay_is_assessed_published_and_still_known_after_a_restart(cell):
    """The whole flow once: recording, assessment, bus and torque query. A restart continues from the stored state.

    With --verbose every condition is in the log, and nothing that libraries say at that level.
    """
    cell, _ = cell
    daemon = cell.daemon("--now", "--verbose")
    with cell.client() as client:
        assert eventually(lambda: len(client.get("joint/*/friction")) == 6, 40.0), daemon.kill() or daemon.communicate()[1]
        health = client.get("health")[0].document
        assert health["state"] == "NORMAL"
        assert eventually(lambda: client.get("replay")[0].document["state"] == "ended", 5.0)  # it is told after what it led to
        document = client.get("replay")[0].document
        assert document["verdict"] == "assessed"
        friction = client.get("joint/3/friction")[0].document
        assert friction["coulomb_nm"] > 0
        answer = client.torque(q=[0, -1.5, 0.5, 0, 0, 0], qd=[0.5] * 6, temperature_c=[25.0] * 6)
        assert len(answer.torque_nm) == 6
        assert answer.model_revision == 1
        assert eventually(lambda: len(client.get("torque/live")) == 1, 10.0)
        live = client.get("torque/live")[0].document
        assert len(live["residual_nm"]) == 6
        assert loaded(daemon.pid) == {"numpy", "pinocchio"}  # what a replay and a verdict need was loaded by children, which have ended
        assert children(daemon.pid) == []
    output = stop(daemon)
    assert "verdict=assessed" in output
    assert " DEBUG monitor.acquire.safety.gate condition=payload ok: " in output
    assert {line.split()[2].partition(".")[0] for line in output.splitlines() if " DEBUG " in line} == {"monitor"}

    result = ended("status", "--config", str(cell.config), "--json")
    assert result.returncode == 0, result.stderr
    assert [row["state"] for row in json.loads(result.stdout)["ledger"]] == ["assessed"]
    assert json.loads(result.stdout)["health"]["stale"] is False
    missing = [row["extrapolated"] for row in json.loads(result.stdout)["compensation"]["joints"][0]["by_temperature"]]
    assert missing.count(False) in {1, 2}  # one replay: its temperature, and 3 K about it
    arguments = ["--q=0,-1.5,0.5,0,0,0", "--qd=0.5,0.5,0.5,0.5,0.5,0.5", "--temperature=25,25,25,25,25,25"]
    local = ended("predict", "--config", str(cell.config), *arguments, "--local", "--json")
    assert json.loads(local.stdout)["torque_nm"] == pytest.approx(answer.torque_nm)
    terms = ended("predict", "--config", str(cell.config), "--compensation", "--local", "--json")

    daemon = cell.daemon()
    with cell.client() as client:
        assert eventually(lambda: len(client.get("joint/*/friction")) == 6, 10.0)
        assert client.get("joint/3/friction")[0].document == friction
        assert loaded(daemon.pid) == {"numpy", "pinocchio"}
        asked = ended("predict", "--config", str(cell.config), *arguments, "--json")
        assert json.loads(asked.stdout)["torque_nm"] == pytest.approx(answer.torque_nm)
        (published,) = client.documents("compensation")
        asked = ended("predict", "--config", str(cell.config), "--compensation", "--json")
        assert json.loads(asked.stdout) == json.loads(terms.stdout)
        assert [sum(row.replays for row in joint.by_temperature) for joint in published.joints] == [1] * 6
    stop(daemon)
    assert [row.state for row in cell.ledger()] == ["assessed"]


def test_sigkill_during_a_replay_stops_the_arm_and_the_ledger_has_it_as_aborted(cell):
    """The daemon dies in motion: its children end, the watchdog stops the arm, and the next start reports it without a repetition."""
    cell, remote = cell
    daemon = cell.daemon("--now")
    assert eventually(lambda: moving(remote), 40.0), daemon.kill() or daemon.communicate()[1]
    family = children(daemon.pid)
    assert family
    os.kill(daemon.pid, signal.SIGKILL)
    daemon.communicate()
    assert eventually(lambda: remote.truth()["program"] is None, 2.0)  # the watchdog, 0.1 s of the arm's own clock
    assert eventually(lambda: standing(remote), 2.0)  # and then |q̇|/deceleration
    assert eventually(lambda: gone(family), 2.0)
    assert [row.state for row in cell.ledger()] == ["started"]

    daemon = cell.daemon()
    with cell.client() as client:
        assert client.get("health")[0].document["state"] is None
        assert client.get("joint/*/friction") == []
    time.sleep(1.0)
    assert standing(remote)
    output = stop(daemon)
    assert "verdict=aborted" in output
    (row,) = cell.ledger()
    assert row.state == "aborted"
    assert list((cell.folder / "history" / "recordings").iterdir()) == []
    with Store.reader(cell.folder / "history") as store:  # whether a safety stop came just before nobody knows
        assert [stop.cause for stop in store.stops.waiting()] == ["unknown_end"]


def test_sigterm_during_a_replay_stops_the_arm_first(cell):
    """A stop of the service is no crash: the arm comes to rest, the ledger has the reason, and the exit code is 0."""
    cell, remote = cell
    daemon = cell.daemon("--now")
    assert eventually(lambda: moving(remote), 40.0), daemon.kill() or daemon.communicate()[1]
    stop(daemon)
    speeds = remote.truth()["qd"]
    assert max(abs(speed) for speed in speeds) < 0.01, remote.truth()["stops"]  # at rest, except for the last microradians of the servo
    (row,) = cell.ledger()
    assert row.state == "aborted"
    assert "stop" in (row.reason_text or "")


def test_a_reload_that_forbids_motion_stops_a_moving_arm(cell):
    """The file says `allow_motion = false` and SIGHUP comes: the arm comes to rest along its path, and nobody has to acknowledge it."""
    cell, remote = cell
    daemon = cell.daemon("--now")
    assert eventually(lambda: moving(remote), 40.0), daemon.kill() or daemon.communicate()[1]
    cell.config.write_text(cell.config.read_text().replace("allow_motion = true", "allow_motion = false"))
    daemon.send_signal(signal.SIGHUP)
    began = time.monotonic()
    assert eventually(lambda: standing(remote), 5.0)
    stood_s = time.monotonic() - began
    assert eventually(lambda: cell.ledger()[-1].state == "aborted", 10.0)
    assert cell.ledger()[-1].reason_text.startswith(f"{cell.host}: motion_forbidden")
    with Store.reader(cell.folder / "history") as store:
        assert store.stops.waiting() == []
        assert [motion.ending for motion in store.motions.rows()] == ["motion_forbidden"]
    stop(daemon)
    assert stood_s < 1.5  # 1 s is promised; this machine has other work


def test_a_stop_is_told_within_seconds_and_a_replay_is_two_lines_of_the_log(cell):
    """Plant and gateway hear of a stop by its alert. What the replay met on its way stands in the log of whoever asks for it."""
    cell, remote = cell
    daemon = cell.daemon("--now")
    with cell.client() as client:
        assert eventually(lambda: moving(remote), 40.0), daemon.kill() or daemon.communicate()[1]
        remote.fault("protective_stop")
        assert eventually(lambda: cell.ledger()[-1].state == "aborted", 10.0)
        assert eventually(lambda: any("stopped" in each.key for each in client.get("alert/arm/*")), 3.0)
    lines = [line.split(" ", 2)[2] for line in stop(daemon).splitlines() if "replay=1 " in line.partition("monitor.service.replay")[2]]
    assert [line.partition(": ")[0] for line in lines] == [
        "monitor.service.replay replay=1 begins",
        f'monitor.service.replay replay=1 verdict=aborted reason="{cell.host}',
    ]


def test_motion_that_is_not_allowed_is_skipped_with_the_reason(cell):
    """The default configuration moves nothing, and the ledger has the reason."""
    cell, remote = cell
    cell.config.write_text(cell.config.read_text().replace("allow_motion = true", ""))
    before = remote.truth()["q"]
    daemon = cell.daemon("--now")
    with cell.client():
        assert eventually(lambda: bool(cell.ledger()) and cell.ledger()[0].state == "skipped", 20.0)
    stop(daemon)
    assert "allow_motion" in (cell.ledger()[0].reason_text or "")
    assert remote.truth()["q"] == pytest.approx(before, abs=1e-6)


def test_a_wrong_configuration_ends_with_78_and_every_mistake(tmp_path: Path):
    """The service manager must not restart it, and the operator sees all mistakes at once."""
    config = tmp_path / "wrong.toml"
    config.write_text('[robot]\nmodel = "ur7"\nsite = "A"\nid = "b"\n[replay]\nalow_motion = true\n')
    ended = run([sys.executable, "-m", "monitor", "run", "--config", str(config)], 60.0)
    assert ended.returncode == 78
    for part in ("ur7", "known are", "'A'", "did you mean allow_motion"):
        assert part in ended.stderr
    assert "Traceback" not in ended.stderr
