"""The messages to the service manager and its journal, received by sockets like theirs."""

import logging
import os
import socket
import struct
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from monitor.service.problems import Problems
from monitor.service.systemd import Heartbeats, JournalHandler, Watchdog, notify, reloading, watchdog_s


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A datagram socket in the place of the service manager's."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(str(tmp_path / "notify"))
        channel.settimeout(1.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "300000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        yield channel


def received(channel: socket.socket) -> list[str]:
    channel.setblocking(False)
    messages = []
    while True:
        try:
            messages.append(channel.recv(4096).decode())
        except BlockingIOError:
            return messages


def test_the_watchdog_is_notified_while_every_worker_is_alive_and_not_when_one_is_late(manager, caplog, monkeypatch):
    """One worker that hangs stops the notifications, although the main loop runs. They continue when it runs again."""
    now_s = [100.0]
    monkeypatch.setattr("monitor.service.systemd.time.monotonic", lambda: now_s[0])
    heartbeats = Heartbeats()
    heartbeats.beat("listen", 5.0)
    heartbeats.beat("replays", 0.2)
    watchdog = Watchdog(heartbeats)
    watchdog.check()
    assert received(manager) == ["WATCHDOG=1"]
    watchdog.check()
    assert received(manager) == []  # one notification in a third of the watchdog's time is enough
    now_s[0] += 0.3
    for _ in range(3):
        watchdog.check()
    assert received(manager) == []
    assert len([record for record in caplog.records if "not alive: replays" in record.message]) == 1
    heartbeats.beat("replays", 5.0)
    watchdog.check()
    assert received(manager) == ["WATCHDOG=1"]


def test_without_a_service_manager_nothing_is_sent_and_nothing_fails(monkeypatch: pytest.MonkeyPatch):
    """The same holds if the socket no longer exists."""
    for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC"):
        monkeypatch.delenv(name, raising=False)
    notify("READY=1")
    assert watchdog_s() == 0.0
    Watchdog(Heartbeats()).check()
    monkeypatch.setenv("NOTIFY_SOCKET", "/nowhere/at/all")
    notify("READY=1")
    monkeypatch.setenv("WATCHDOG_USEC", "1000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid() + 1))  # another process's
    assert watchdog_s() == 0.0


def test_a_reload_sends_the_time_of_its_start(manager):
    """The time is in microseconds of the monotonic clock, which systemd compares."""
    before = time.monotonic()
    reloading()
    (messages,) = received(manager)
    assert messages.startswith("RELOADING=1\nMONOTONIC_USEC=")
    assert abs(int(messages.rsplit("=", 1)[1]) / 1e6 - before) < 1.0


def test_the_journal_gets_searchable_fields(tmp_path: Path):
    """The fields are MESSAGE, PRIORITY, the robot and the replay. A message of two lines has the journal's binary form."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(str(tmp_path / "journal"))
        handler = JournalHandler({"JOINT_MONITOR_ROBOT": "cell-1"}, str(tmp_path / "journal"))
        log = logging.Logger("monitor.test")
        log.addHandler(handler)
        log.warning("replay=%d verdict=%s", 17, "aborted", extra={"replay": 17, "verdict": "aborted"})
        log.error("two\nlines")
        first, second = journal.recv(65536), journal.recv(65536)
        handler.close()
    fields = dict(line.split(b"=", 1) for line in first.splitlines())
    assert fields[b"MESSAGE"] == b"replay=17 verdict=aborted"
    assert fields[b"PRIORITY"] == b"4"
    assert fields[b"JOINT_MONITOR_ROBOT"] == b"cell-1"
    assert fields[b"JOINT_MONITOR_REPLAY"] == b"17"
    assert second.startswith(b"MESSAGE\n" + struct.pack("<Q", 9) + b"two\nlines\nPRIORITY=3\n")


def test_a_problem_is_logged_when_it_begins_and_when_it_ends(caplog):
    """Each is logged once, however often it is checked. In between it is listed with the time of its begin."""
    caplog.set_level(logging.INFO)
    clock, elapsed = [100.0], [0.0]
    problems = Problems(lambda: clock[0], lambda: elapsed[0])
    for _ in range(5):
        problems.report("disk", f"full since {clock[0]:.0f}")
        clock[0] += 1.0
        elapsed[0] += 1.0
    clock[0] -= 365 * 86_400.0  # the clock was set back meanwhile; the duration is still right
    problems.clear("clock")
    assert [(each.name, each.since.timestamp(), each.text) for each in problems.listed()] == [("disk", 100.0, "full since 104")]
    problems.update("disk", None)
    assert [record.message for record in caplog.records] == ["trouble=disk: full since 100", "trouble=disk is over, after 5 s"]
    assert problems.listed() == []


def test_where_no_journal_takes_the_log_each_line_begins_with_its_time():
    """Two lines of one second, and of another zone than the host's, can be told apart from yesterday's."""
    code = (
        "import logging; from monitor.service.systemd import log_as_a_service; log_as_a_service('hall', 'a');"
        "logging.getLogger('monitor.x').warning('replay=%d', 7)"
    )
    environment = {key: value for key, value in os.environ.items() if key != "JOURNAL_STREAM"} | {"TZ": "Asia/Tokyo"}
    before = datetime.now(UTC).replace(microsecond=0)
    said = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stderr
    at, _, line = said.partition(" ")
    assert line == "WARNING monitor.x replay=7\n"
    assert before <= datetime.fromisoformat(at) <= datetime.now(UTC)
