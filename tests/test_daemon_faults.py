"""What the daemon does about a fault of its own in the middle of a window."""

import os
from pathlib import Path

from monitor.config import load
from monitor.daemon import Daemon
from monitor.store import Store


def test_a_fault_of_ours_during_a_replay_ends_the_window_and_waits_for_a_person(tmp_path: Path, free_port: int):
    """The window is told as aborted with the cause, the next perform is another one, and no arm moves before somebody looked."""
    (tmp_path / "cell.toml").write_text(
        f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
    )
    configuration = load(tmp_path / "cell.toml")

    def play(*_: object) -> None:
        raise OSError(28, os.strerror(28))

    with Store.open(configuration.state_directory) as store, Daemon(configuration, store, now=lambda: 1e9, play=play) as daemon:
        row = daemon.perform(1e9)
        assert row is not None
        assert row.state == "aborted"
        assert "No space left" in row.reason
        assert [stop.cause for stop in store.waiting_stops()] == ["internal"]
