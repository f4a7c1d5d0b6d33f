"""Motions are entered before the arm may move, and one without a known end waits for a person."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from prepared import Process

from monitor.errors import MotionRefused, StoreError
from monitor.store.store import Store

BEGIN = """
import sys
from pathlib import Path
from monitor.store.store import Store
with Store.shared(Path(sys.argv[1])) as store, store.motions.turn(1.0):
    store.motions.begin(ledger_id=None, host="10.0.0.5", serial="7", configured=False, first_pass=False, at_unix_s=1.0)
    print("moving", flush=True)
    sys.stdin.read()
"""


def begun(store: Store, at: float = 1.0, ledger_id: int | None = None, serial: str | None = "7", configured: bool = False) -> int:
    """A motion that is under way."""
    return store.motions.begin(ledger_id=ledger_id, host="10.0.0.5", serial=serial, configured=configured, first_pass=False, at_unix_s=at)


def test_a_motion_whose_process_was_killed_becomes_a_stop_that_waits(tmp_path: Path):
    """While the process lives its motion is no stop, and nobody else may move the arm. After SIGKILL the next look makes a stop of it."""
    process = Process([sys.executable, "-c", BEGIN, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "moving\n"
        with Store.open(tmp_path) as store:
            assert store.motions.left_over() == []
            assert store.motions.give_up_left_over(2.0) == []
            with pytest.raises(MotionRefused, match="another joint-monitor moves this arm"), store.motions.turn(2.0):
                pass
            os.kill(process.pid, signal.SIGKILL)
            process.wait(5.0)
            assert [motion.host for motion in store.motions.left_over()] == ["10.0.0.5"]
            assert len(store.motions.give_up_left_over(3.0)) == 1
            (stop,) = store.stops.waiting()
            assert (stop.cause, stop.at_unix_s) == ("unknown_end", 3.0)
            assert "whether the arm came to rest" in stop.text
            assert store.motions.left_over() == []
            store.stops.allow("Ada", "looked", 4.0)
            with store.motions.turn(5.0):
                begun(store)
    finally:
        process.kill()
        process.communicate()


def test_the_next_motion_of_any_process_finds_the_motion_that_has_no_end(tmp_path: Path):
    """The stop is made before the next motion begins, and refuses it."""
    with Store.open(tmp_path) as store:
        with store.motions.turn(1.0):
            begun(store)
        with store.motions.turn(2.0), pytest.raises(MotionRefused, match="waits for a person"):
            begun(store)
        assert [stop.cause for stop in store.stops.waiting()] == ["unknown_end"]


def test_a_motion_that_ended_well_leaves_nothing(tmp_path: Path):
    """Its row says how it ended."""
    with Store.open(tmp_path) as store, store.motions.turn(1.0):
        store.motions.end(begun(store), "done", None, 3.0)
        assert store.motions.give_up_left_over(4.0) == []
        assert [(motion.ending, motion.ended_at_unix_s) for motion in store.motions.rows()] == [("done", 3.0)]


def test_a_stop_is_the_end_of_its_windows_motion_and_is_stored_once(tmp_path: Path):
    """The motion's end and the end of its window name the same stop."""
    with Store.open(tmp_path) as store:
        ledger_id = store.ledger.claim(1.0, "scheduled", 1.0)
        with store.motions.turn(1.0):
            motion = begun(store, ledger_id=ledger_id)
            store.motions.end_in_stop(motion, "protective_stop", "safety mode 3", 2.0)
        store.ledger.end(ledger_id, "aborted", "safety mode 3", 2.0, stop="protective_stop")
        assert [stop.cause for stop in store.stops.waiting()] == ["protective_stop"]
        assert [motion.ending for motion in store.motions.rows(ledger_id=ledger_id)] == ["protective_stop"]


def test_a_motion_cannot_begin_where_the_disk_refuses_its_row(tmp_path: Path):
    """Nothing may move without its row: the refusal is an error, and no half of the row is left."""
    with Store.open(tmp_path) as store:
        store.database.connection.execute("PRAGMA max_page_count = 1")  # SQLite then behaves as on a full disk
        with store.motions.turn(1.0), pytest.raises(StoreError, match="no space is left"):
            _ = [begun(store) for _ in range(10_000)]
        store.database.connection.execute("PRAGMA max_page_count = 100000")
        assert store.database.connection.execute("PRAGMA synchronous").fetchone() == (2,)  # FULL: a commit is on the disk


def test_the_serial_number_met_first_is_expected_until_a_person_allows_another(tmp_path: Path):
    """The stop names the other arm once. Allowing it makes that arm the expected one, and asks for a slow first pass."""
    with Store.open(tmp_path) as store:
        assert store.motions.expected_serial() is None
        with store.motions.turn(1.0):
            store.motions.end(begun(store), "done", None, 1.0)
            store.motions.end(begun(store, serial="8"), "done", None, 2.0)  # not what `serial` of the conditions allows
            assert store.motions.expected_serial() == "7"
            store.first_passes.add("digest", {"payload_kg": 0.0}, 1.0)
            store.stops.add_another_arm("9", "another arm answers", 3.0)
            store.stops.add_another_arm("9", "another arm answers", 4.0)
            (stop,) = store.stops.waiting()
            assert (stop.cause, stop.serial) == ("another_arm", "9")
            store.stops.allow("Ada", "the arm was replaced", 5.0)
            assert store.motions.expected_serial() == "9"
            assert not store.first_passes.is_latest("digest")
            store.motions.end(begun(store, serial="10", configured=True), "done", None, 6.0)
            assert store.motions.expected_serial() == "10"  # the configuration names it: a person has said so there


def test_a_restored_history_waits_for_a_person(tmp_path: Path):
    """What waited since the backup, or was under way, is lost with the damaged file."""
    with Store.open(tmp_path) as store:
        store.back_up(3)
        with store.motions.turn(1.0):
            begun(store)
    for suffix in ("", "-wal"):
        (tmp_path / f"history.sqlite{suffix}").unlink(missing_ok=True)
    with Store.open(tmp_path) as store:
        (stop,) = store.stops.waiting()
        assert stop.cause == "history_restored"
        assert "a motion under way, may be lost" in stop.text
    with Store.open(tmp_path) as store:
        assert len(store.stops.waiting()) == 1
