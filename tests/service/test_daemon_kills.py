"""SIGKILL of the daemon, its replay child, or both at random times: the arm stops, and the history stays correct."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_daemon import Cell, children, eventually, gone, standing

from monitor.simulate.remote import Remote
from monitor.store.formats.recordings import read_recording
from monitor.store.store import Store

KILLS = 100


def replay_children(pid: int) -> list[int]:
    """The child processes that may move the arm."""
    return [child for child in children(pid) if b"acquire.ur.stream" in Path(f"/proc/{child}/cmdline").read_bytes()]


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.xdist_group("daemon")
def test_a_hundred_kills_leave_a_standing_arm_and_a_correct_history(tmp_path: Path, free_port: int, soak_row):
    """The kill comes between the start of the service and the end of its replay. The next service repairs, and is killed too."""
    rng = random.Random(100)
    host, wrong = "127.0.7.99", []
    moving = 0
    simulator = subprocess.Popen([sys.executable, "-m", "monitor.simulate", "--bind", host], stdout=subprocess.PIPE, text=True)
    try:
        assert "listening" in simulator.stdout.readline()
        with Remote(host) as remote:
            cell = Cell(tmp_path, host, free_port)
            for number in range(KILLS):
                whom, after_s = rng.choice(("child", "parent", "both")), rng.uniform(0.5, 14.0)
                moved, found = kill_once(cell, remote, whom, after_s)
                moving += moved
                wrong += [f"kill {number} of {whom} after {after_s:.1f} s: {what}" for what in (*found, *contradictions(cell))]
    finally:
        simulator.terminate()
        simulator.wait(timeout=10)
    soak_row(f"kill −9 of child, daemon or both, {KILLS} times, {moving} of a moving arm", f"{len(wrong)} wrong", "0 wrong")
    assert not wrong, wrong


def kill_once(cell: Cell, remote: Remote, whom: str, after_s: float) -> tuple[bool, list[str]]:
    """Kill one service at the given time after its start. Return whether the arm moved, and the errors afterwards."""
    wrong = []
    daemon = cell.daemon("--now")
    try:
        time.sleep(after_s)
        family = children(daemon.pid)
        moved = not standing(remote)
        for pid in {"child": replay_children(daemon.pid), "parent": [daemon.pid], "both": [*family, daemon.pid]}[whom]:
            os.kill(pid, signal.SIGKILL)
        if whom == "child":
            # no replay ran, or the daemon lives: SIGTERM stops the motion, and the daemon records the outcome and ends
            daemon.send_signal(signal.SIGTERM)
        daemon.communicate(timeout=20)
        if not eventually(lambda: standing(remote) and remote.truth()["program"] is None, 2.0):
            wrong.append("the arm did not stop")
        if not eventually(lambda: gone(family), 3.0):
            wrong.append("processes are left")
    finally:
        daemon.kill()
        daemon.wait()
    return moved, wrong


def contradictions(cell: Cell) -> list[str]:
    """Incorrect rows of the ledger: a finished one without a whole recording, or two unfinished ones at once."""
    if not (cell.folder / "history" / "history.sqlite").is_file():
        return []
    found = []
    with Store.reader(cell.folder / "history") as store:
        rows = store.ledger.rows()
        for row in rows:
            if row.state in {"recorded", "assessed"}:
                recording = read_recording(store.recordings.path(row.id))
                if recording.duration_s < 5.9:
                    found.append(f"replay {row.id} is {row.state} after {recording.duration_s:.1f} s")
    if sum(row.state == "started" for row in rows) > 1:
        found.append("two replays are unfinished: the older one was not repaired")
    return found
