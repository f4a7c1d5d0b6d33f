"""SIGKILL at random moments over simulated weeks of a schedule: motions, reports and history agree."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from monitor.store.store import Store

HOUR = 3600.0
START = 1_780_272_000.0

# An arm that writes down, beyond any crash of the monitor's, each time it moves; a clock that goes on where it was, an hour in 20 ms.
#
# The interpreter and what it imports are loaded once, by a nest; every life is a process of its own that opens the store anew.
SERVICE = """
import os, sys, time
from dataclasses import replace
from pathlib import Path
from monitor.config.load import from_document
from monitor.acquire.schedule.needed import Told, need
from monitor.service.shared_state import ReplayRequests
from monitor.service.scheduler import Clocks, Scheduler
from monitor.store.store import Store
from monitor.service.problems import Problems

folder, pace = Path(sys.argv[1]), float(sys.argv[2])

def live():
    began, base = time.monotonic(), float((folder / "clock").read_text())
    moved = os.open(folder / "moved", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    read = [base]
    def now():
        read[0] = base + (time.monotonic() - began) * pace
        return read[0]
    same = lambda: read[0]  # a millisecond between two clocks would be minutes here

    class Arm:
        configuration = from_document({"robot": {"model": "ur5", "site": "lab", "id": "cell-1"}, "store": {"directory": str(folder)},
                                       "schedule": {"cron": "0 */6 * * *", "grace_s": 7200.0, "every_h": 8.0}}, folder / "cell.toml")
        def __init__(self, store): self.store = store
        def perform(self, window, kind="scheduled", closes_unix_s=None):
            number = self.store.ledger.claim(window, kind, now())
            if number is None: return None
            os.write(moved, f"{window!r}\\n".encode()); os.fsync(moved)
            time.sleep(0.004)
            path = self.store.recordings.path(number)
            path.with_name(f".{path.name}.tmp1").write_bytes(b"PAR1" * 1000)
            os.replace(path.with_name(f".{path.name}.tmp1"), path)
            self.store.ledger.mark_recorded(number)
            self.finish(number)
        def finish(self, number):
            self.store.assessments.commit(number, at_unix_s=now(), recorded_at_unix_s=now(), assessment={"n": number},
                                          friction=[{"n": number}] * 6, belief={"n": number}, health={}, model={}, events=[{"n": number}])
            os.write(1, f"safe {number}\\n".encode())
        def skip(self, window, reason):
            number = self.store.ledger.claim(window, "scheduled", now())
            if number is not None: self.store.ledger.end(number, "skipped", reason, now())
        def recover(self):
            for row in self.store.ledger.repair(now()): self.finish(row.id)
        def roll_back(self): raise AssertionError("the clock never went back")
        def next_due(self, at): pass
        def needed(self): return need(self.configuration.schedule, Told())

    with Store.open(folder) as store:
        arm = Arm(store)
        scheduler = Scheduler(arm, store, Problems(now), ReplayRequests(), Clocks(now=now, monotonic=same))
        arm.recover()
        if os.environ.get("BACK_UP"): store.back_up(3)
        while True:
            scheduler.tick()
            (folder / "clock.tmp").write_text(repr(now()))
            os.replace(folder / "clock.tmp", folder / "clock")
            time.sleep(0.002)

for _ in sys.stdin:
    pid = os.fork()
    if pid == 0:
        try:
            live()
        except BaseException:
            import traceback
            traceback.print_exc()
        os._exit(1)
    print("born", pid, flush=True)
    print("dead", os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


def killed(parent: "subprocess.Popen[str]", rng: random.Random) -> set[int]:
    """Run the service until it is killed. Return the replays that it reported as stored."""
    assert parent.stdin is not None
    assert parent.stdout is not None
    parent.stdin.write("live\n")
    parent.stdin.flush()
    reported: set[int] = set()
    pid = None
    in_production = rng.random() < 0.7  # the others are killed while they open the store, recover, and check for the first time
    while pid is None or (in_production and not reported):
        word, number = next_event(parent)
        if word == "born":
            pid = number
        else:
            assert word == "safe", (word, number)
            reported.add(number)
    time.sleep(rng.uniform(0.0, 0.6 if in_production else 0.08))
    os.kill(pid, signal.SIGKILL)
    while (event := next_event(parent))[0] == "safe":
        reported.add(event[1])
    assert event == ("dead", -signal.SIGKILL)
    return reported


def next_event(parent: "subprocess.Popen[str]") -> tuple[str, int]:
    """The next line of the parent process or of the service in it: a word and a number."""
    assert parent.stdout is not None
    word, number = parent.stdout.readline().split()
    return word, int(number)


def contradictions(folder: Path, reported: set[int]) -> list[str]:
    """Sentences about everything in the history that is not correct."""
    moved = [float(line) for line in (folder / "moved").read_text().splitlines()]
    found = [f"window {window} moved the arm {moved.count(window)} times" for window in set(moved) if moved.count(window) > 1]
    with Store.open(folder) as store:
        if store.restored is not None:
            found.append(store.restored.reason.text)
        rows = store.ledger.rows()
        assessed = {row.id for row in rows if row.state == "assessed"}
        found += [f"replay {number} was said to be safe and is not" for number in sorted(reported - assessed)]
        entered = {row.window_unix_s for row in rows}
        found += [f"the arm moved in {window}, and the ledger does not know" for window in moved if window not in entered]
        open_ones = [row for row in rows if row.state in {"started", "recorded"}]
        if len(open_ones) > 1:
            found.append(f"{len(open_ones)} replays are unfinished at once")
        state = store.assessments.state()
        counts = {
            "assessed": len(assessed),
            "events": len(store.events.rows()),
            "friction": len(store.assessments.friction(joint=6)),
            "verdicts": len(store.assessments.rows()),
        }
        if state is None or {state.revision, *counts.values()} != {len(assessed)}:
            found.append(f"revision, {counts} do not agree")
        found += [
            f"replay {row.id} has no recording" for row in rows if row.state == "assessed" and not store.recordings.path(row.id).is_file()
        ]
    return found


def lived(folder: Path, kills: int, seed: int) -> tuple[list[str], int, float]:
    rng, reported, wrong = random.Random(seed), set[int](), []
    (folder / "clock").write_text(repr(START))
    command = [sys.executable, "-c", SERVICE, str(folder), repr(HOUR / 0.02)]
    with (
        (folder / "wrong").open("w") as errors,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True) as parent,
    ):
        for number in range(kills):
            reported |= killed(parent, rng)
            wrong += [f"kill {number}: {what}" for what in contradictions(folder, reported)]
    assert (folder / "wrong").read_text() == ""
    return wrong, len(reported), (float((folder / "clock").read_text()) - START) / (7 * 24 * HOUR)


def test_a_few_kills_over_simulated_weeks_leave_a_correct_history(tmp_path: Path):
    """The arm moved once per window, the ledger has every motion, and every replay reported as stored is stored."""
    wrong, reported, weeks = lived(tmp_path, 6, 3)
    assert wrong == []
    assert reported >= 2
    assert weeks > 0.1


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_two_hundred_kills_over_simulated_weeks_leave_a_correct_history(tmp_path: Path, soak_row):
    """The same with two hundred kills."""
    wrong, reported, weeks = lived(tmp_path, 200, 200)
    soak_row(f"kill −9, 200 times over {weeks:.0f} simulated weeks, {reported} replays", f"{len(wrong)} lies", "0 lies")
    assert wrong == []
