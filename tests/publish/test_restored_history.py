"""A history that was replaced by a backup is an alert until a person acknowledges it."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from prepared import Process
from test_daemon_on_the_bus import DAY_S, START_UNIX_S, Arm, history, recording, settled  # noqa: F401

from monitor.errors import BusError
from monitor.judge.alerts.conditions import STORE_RESTORED
from monitor.publish.client import Client
from monitor.publish.documents import Alert
from monitor.service.daemon import Daemon
from monitor.store.backup import back_up
from monitor.store.store import Store


def reached(endpoint: str, process: "subprocess.Popen[str]") -> Client:
    """A client, as soon as the daemon answers: a busy machine needs time to start it."""
    for _ in range(600):
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        try:
            return Client(endpoint, "lab", "cell-1", timeout_s=1.0)
        except BusError:
            time.sleep(0.1)
    raise AssertionError("the daemon never opened its endpoint")


def restored_alert(client: Client) -> Alert:
    """The alert of the restored history; it comes a moment after the endpoint opens."""
    for _ in range(200):
        for alert in client.alerts():
            if alert.condition == STORE_RESTORED:
                return alert
        time.sleep(0.05)
    raise AssertionError("the alert was never raised")


def test_a_restored_history_without_a_verdict_is_a_problem_and_an_alert_with_the_first_verdict(tmp_path: Path, free_port: int, recording):  # noqa: F811
    """Without an assessment and a backup there is no health for an alert. The problem waits for one, also through a restart."""
    (tmp_path / "history").mkdir()
    (tmp_path / "history" / "history.sqlite").write_bytes(b"this is no database" * 1000)
    endpoint, arm = f"tcp/127.0.0.1:{free_port}", Arm(recording)
    for _ in range(2):
        with Store.open(tmp_path / "history") as store, Daemon(settled(tmp_path, endpoint), store, now=arm.now, play=arm.play) as daemon:
            assert "the history was damaged" in daemon.alerts.restored
            daemon.look()
            assert daemon.alerts.restored  # reported as a problem
    with (
        Store.open(tmp_path / "history") as store,
        Daemon(settled(tmp_path, endpoint), store, now=arm.now, play=arm.play) as daemon,
        Client(endpoint, "lab", "cell-1") as client,
    ):
        assert daemon.monitor.perform(arm.clock_unix_s).state == "assessed"
        daemon.look()
        assert daemon.alerts.restored is None
        assert "the history was damaged" in restored_alert(client).text
    with Store.open(tmp_path / "history") as store, Daemon(settled(tmp_path, endpoint), store, now=arm.now, play=arm.play) as daemon:
        assert daemon.alerts.restored is None


def test_a_restored_history_is_an_alert_until_it_is_acknowledged(tmp_path: Path, free_port: int, recording, history):  # noqa: F811
    """A real process publishes it. It stays after SIGKILL and after another verdict, and clears after its acknowledgement."""
    shutil.copytree(history, tmp_path / "history")
    back_up(tmp_path / "history", 14)
    (tmp_path / "history" / "history.sqlite").write_bytes(b"this is no database" * 1000)
    endpoint = f"tcp/127.0.0.1:{free_port}"
    (tmp_path / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\nhost = "127.0.89.77"\n'
        f'[store]\ndirectory = "history"\n[bus]\nlisten = ["{endpoint}"]\n'
    )
    command = [sys.executable, "-m", "monitor", "run", "--config", str(tmp_path / "cell.toml")]
    with Process(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            with reached(endpoint, process) as client:
                alert = restored_alert(client)
                assert "the history was damaged" in alert.text
                assert [event.kind for event in client.events().events][-1] == "raised"
        finally:
            process.send_signal(signal.SIGKILL)
            process.communicate()

    arm = Arm(recording)
    arm.clock_unix_s = time.time() + DAY_S
    configuration = settled(tmp_path, endpoint)
    with (
        Store.open(tmp_path / "history") as store,
        Daemon(configuration, store, now=arm.now, play=arm.play) as daemon,
        Client(endpoint, "lab", "cell-1") as client,
    ):
        assert store.restored is None
        daemon.look()
        assert daemon.monitor.perform(arm.clock_unix_s).state == "assessed"
        daemon.look()
        assert [alert.condition for alert in client.alerts()].count(STORE_RESTORED) == 1
        client.acknowledge(None, STORE_RESTORED, by="Ada", why="the disk was replaced")
        daemon.look()
        assert STORE_RESTORED not in [alert.condition for alert in client.alerts()]
        assert [event.kind for event in client.events().events if event.condition == STORE_RESTORED] == [
            "raised",
            "acknowledged",
            "cleared",
        ]
