"""Exceptions of the daemon itself: during a window and at its start."""

import os
import subprocess
from contextlib import ExitStack
from pathlib import Path

import pytest
from test_scheduler import needs_root, small_disk  # noqa: F401 - a fixture

import monitor.service.run
from monitor.config.load import load
from monitor.errors import StoreError, StoreUnavailable
from monitor.service.daemon import Daemon
from monitor.store.store import Store


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
        assert "No space left" in row.reason
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
        assert (row.state, row.reason) == ("aborted", "history.sqlite: no space is left")
        assert store.stops.waiting() == []


@needs_root
def test_the_daemon_waits_at_its_start_for_room_on_the_disk(small_disk: Path, monkeypatch: pytest.MonkeyPatch):  # noqa: F811
    """The service manager would give up after repeated restarts. So the daemon waits, reports it, and continues when there is room."""
    with Store.open(small_disk / "history") as store:
        store.ledger.claim(1e9, "scheduled", 1e9)
    filler = small_disk / "filler"
    subprocess.run(["dd", "if=/dev/zero", f"of={filler}", "bs=4k"], capture_output=True, check=False)  # until the disk is full
    messages: list[str] = []

    def pause(_: float) -> None:
        with pytest.raises(StoreUnavailable), Store.reader(small_disk / "history"):
            pass
        filler.unlink(missing_ok=True)

    monkeypatch.setattr(monitor.service.run, "notify", messages.append)
    monkeypatch.setattr(monitor.service.run.time, "sleep", pause)
    monkeypatch.setattr(monitor.service.run, "DISK_WAIT_S", 1.0)
    with ExitStack() as stack:
        store = monitor.service.run.open_store(small_disk / "history", stack)
        assert store.ledger.unfinished()
    assert any("waiting for the history" in each for each in messages)
    with Store.open(small_disk / "history"), ExitStack() as stack, pytest.raises(StoreError, match="in use by another"):
        monitor.service.run.open_store(small_disk / "history", stack)


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
