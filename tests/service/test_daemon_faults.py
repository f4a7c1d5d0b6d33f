"""Exceptions of the daemon itself: during a window and at its start."""

import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack
from pathlib import Path

import pytest
from prepared import Process
from test_scheduler import needs_root, small_disk  # noqa: F401 - a fixture

import monitor.service.run
from monitor.config.load import load
from monitor.errors import StoreError, StoreUnavailable
from monitor.service.daemon import Daemon
from monitor.store.store import Store

CELL = (
    '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\nhost = "127.0.89.55"\n'
    '[store]\ndirectory = "{directory}"\n[bus]\nlisten = ["tcp/127.0.0.1:{port}"]\n'
)


def test_an_exception_during_a_replay_ends_the_window_and_waits_for_a_person(tmp_path: Path, free_port: int):
    """The window is reported as aborted with the cause. Until a person has checked the arm, the next one moves nothing."""
    (tmp_path / "cell.toml").write_text(
        f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
    )
    configuration = load(tmp_path / "cell.toml")

    def play(*_: object) -> None:
        raise OSError(28, os.strerror(28))

    with Store.open(configuration.state_directory) as store, Daemon(configuration, store, now=lambda: 1e9, play=play) as daemon:
        row = daemon.monitor.perform(1e9)
        assert row is not None
        assert row.state == "aborted"
        assert "No space left" in row.reason_text
        assert [stop.cause for stop in store.stops.waiting()] == ["internal"]


def test_a_disk_that_refuses_a_motion_ends_the_window_without_a_person(tmp_path: Path, free_port: int):
    """Its row is refused before the arm moves, so nothing has moved, and the next window may try."""
    (tmp_path / "cell.toml").write_text(
        f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
    )
    configuration = load(tmp_path / "cell.toml")

    def play(*_: object) -> None:
        raise StoreUnavailable("history.sqlite: no space is left")

    with Store.open(configuration.state_directory) as store, Daemon(configuration, store, now=lambda: 1e9, play=play) as daemon:
        row = daemon.monitor.perform(1e9)
        assert (row.state, row.reason_text) == ("aborted", "history.sqlite: no space is left")
        assert store.stops.waiting() == []


@needs_root
def test_the_daemon_waits_at_its_start_for_room_on_the_disk(small_disk: Path, monkeypatch: pytest.MonkeyPatch):  # noqa: F811
    """The service manager would give up after repeated restarts. So the daemon waits, reports it, and continues when there is room."""
    with Store.open(small_disk / "history") as store:
        store.ledger.claim(1e9, "scheduled", 1e9)
    filler = small_disk / "filler"
    subprocess.run(["dd", "if=/dev/zero", f"of={filler}", "bs=4k"], capture_output=True, check=False)  # until the disk is full
    messages: list[str] = []
    (small_disk.parent / "cell.toml").write_text(CELL.format(directory=small_disk / "history", port=7447))
    configuration = load(small_disk.parent / "cell.toml")

    class Hangup(threading.Event):
        def wait(self, _: float | None = None) -> bool:
            with pytest.raises(StoreUnavailable), Store.reader(small_disk / "history"):
                pass
            filler.unlink(missing_ok=True)
            return False

    monkeypatch.setattr(monitor.service.run, "notify", messages.append)
    monkeypatch.setattr(monitor.service.run, "DISK_WAIT_S", 1.0)
    with ExitStack() as stack:
        store, _ = monitor.service.run.open_store(configuration, stack, Hangup())
        assert store.ledger.unfinished()
    assert any("waiting for the history" in each for each in messages)
    with Store.open(small_disk / "history"), ExitStack() as stack, pytest.raises(StoreError, match="in use by another"):
        monitor.service.run.open_store(configuration, stack, threading.Event())


@needs_root
def test_a_reload_while_the_daemon_waits_for_its_disk_is_carried_out(small_disk: Path, tmp_path: Path, free_port: int):  # noqa: F811
    """A wrong file is refused and the waiting goes on; the mended one, with another directory, is taken without a restart."""
    subprocess.run(["dd", "if=/dev/zero", f"of={small_disk / 'filler'}", "bs=4k"], capture_output=True, check=False)
    config = tmp_path / "cell.toml"
    config.write_text(CELL.format(directory=small_disk / "history", port=free_port))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60.0)
        environment = os.environ | {"NOTIFY_SOCKET": str(tmp_path / "notify"), "STATE_DIRECTORY": str(tmp_path / "state")}

        def until(text: str) -> str:
            while text not in (message := manager.recv(65536).decode()):
                pass
            return message

        command = [sys.executable, "-m", "monitor", "run", "--config", str(config)]
        with Process(command, env=environment, stderr=subprocess.PIPE, text=True) as daemon:
            try:
                waiting = until("waiting for the history")
                assert f"may write below {tmp_path / 'state'} alone" in waiting
                config.write_text("[robot")
                daemon.send_signal(signal.SIGHUP)
                until("RELOADING=1")
                until("waiting for the history")
                config.write_text(CELL.format(directory="history", port=free_port))
                daemon.send_signal(signal.SIGHUP)
                until("RELOADING=1")
                until("no replay assessed yet")
                assert (tmp_path / "history" / "history.sqlite").is_file()
            finally:
                daemon.terminate()
                errors = daemon.communicate(timeout=30)[1]
    assert "reload refused, the old configuration stays" in errors
    assert daemon.returncode == 0


def test_what_cannot_be_finished_at_the_start_is_finished_later(tmp_path: Path, free_port: int, monkeypatch: pytest.MonkeyPatch):
    """An unfinished replay and a disk without room: the daemon is on the bus, and the scheduler's thread tries again."""
    (tmp_path / "cell.toml").write_text(
        f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
    )
    configuration = load(tmp_path / "cell.toml")
    with Store.open(configuration.state_directory) as store:
        store.ledger.claim(1e9, "scheduled", 1e9)

        def full(*_: object, **__: object) -> None:
            raise StoreUnavailable("no space is left")

        with monkeypatch.context() as patched:
            patched.setattr(store.ledger, "end", full)
            daemon = Daemon(configuration, store, now=lambda: 1e9, play=lambda *_: None)
            daemon.__enter__()
        try:
            assert store.ledger.unfinished()
            daemon.monitor.recover()
            assert not store.ledger.unfinished()
        finally:
            daemon.__exit__()
