"""The history survives crashes of a process, and reports it where it cannot."""

import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from prepared import Process

from monitor.errors import OlderHistory, StoreError
from monitor.reason import Sentence
from monitor.store.store import Store

DAY = 86_400.0


def commit(store: Store, ledger_id: int, **changes: object) -> list:
    given = {
        "at_unix_s": 10.0,
        "recorded_at_unix_s": 5.0,
        "assessment": {"n": ledger_id},
        "friction": [{"coulomb_nm": 1.5}, {"coulomb_nm": 2.5}],
        "belief": {"b": ledger_id},
        "health": {"h": 1},
        "model": {"m": 1},
        "events": [{"kind": "raised"}],
    }
    return store.assessments.commit(ledger_id, **(given | changes))


def replayed(store: Store, window: float) -> int:
    ledger_id = store.ledger.claim(window, "scheduled", window)
    assert ledger_id is not None
    store.recordings.path(ledger_id).write_bytes(b"PAR1")
    store.ledger.mark_recorded(ledger_id)
    return ledger_id


def test_a_window_is_claimed_only_once(tmp_path: Path):
    """The ledger refuses the second claim of a window, also after a restart."""
    with Store.open(tmp_path) as store:
        assert store.ledger.claim(DAY, "scheduled", DAY) is not None
        assert store.ledger.claim(DAY, "scheduled", DAY + 1) is None
    with Store.open(tmp_path) as store:
        assert store.ledger.claim(DAY, "scheduled", DAY + 2) is None


def test_a_replay_that_was_cut_short_becomes_aborted_and_is_not_run_again(tmp_path: Path):
    """`started` without a recording means that the daemon died: the row becomes aborted, with the reason."""
    with Store.open(tmp_path) as store:
        store.ledger.claim(DAY, "scheduled", DAY)
    with Store.open(tmp_path) as store:
        assert store.ledger.repair(2 * DAY) == []
        (row,) = store.ledger.rows()
    assert (row.state, row.ended_at_unix_s) == ("aborted", 2 * DAY)
    assert "ended during this replay" in (row.reason_text or "")


def test_a_recording_that_was_saved_before_the_crash_waits_for_its_assessment(tmp_path: Path):
    """The file was renamed and the ledger not updated: the store takes the file over, and no recording is lost."""
    with Store.open(tmp_path) as store:
        ledger_id = store.ledger.claim(DAY, "scheduled", DAY)
        store.recordings.path(ledger_id).write_bytes(b"PAR1")
        (store.recordings.directory / ".replay-000002.parquet.tmp").write_bytes(b"half")
    with Store.open(tmp_path) as store:
        (row,) = store.ledger.repair(2 * DAY)
        assert (row.id, row.state, row.recording) == (ledger_id, "recorded", store.recordings.path(ledger_id).name)
        assert list(store.recordings.directory.glob(".*")) == []


def test_an_assessment_is_all_or_nothing(tmp_path: Path):
    """A document that cannot be stored leaves belief, history, events and ledger as they were."""
    with Store.open(tmp_path) as store:
        first, second = replayed(store, DAY), replayed(store, 2 * DAY)
        commit(store, first)
        with pytest.raises(ValueError, match="JSON"):
            commit(store, second, events=[{"kind": "raised"}, {"change": float("nan")}])
        state = store.assessments.state()
        assert state is not None
        assert (state.revision, state.belief) == (1, {"b": first})
        assert [event.seq for event in store.events.rows()] == [1]
        assert [row.state for row in store.ledger.rows()] == ["assessed", "recorded"]


def test_a_replay_is_assessed_only_once(tmp_path: Path):
    """The second commit of the same replay is refused and changes nothing."""
    with Store.open(tmp_path) as store:
        ledger_id = replayed(store, DAY)
        commit(store, ledger_id)
        with pytest.raises(StoreError, match="not waiting"):
            commit(store, ledger_id)
        assert len(store.assessments.friction(joint=1)) == 1


def test_events_are_numbered_and_wait_until_they_are_published(tmp_path: Path):
    """After a restart, unpublished events are returned in order, and published ones are not."""
    with Store.open(tmp_path) as store:
        events = commit(store, replayed(store, DAY), events=[{"kind": "raised"}, {"kind": "updated"}])
        store.events.mark_published(events[0].seq)
    with Store.open(tmp_path) as store:
        assert [event.document["kind"] for event in store.events.rows(unpublished=True)] == ["updated"]
        assert [event.seq for event in store.events.rows()] == [1, 2]


def test_a_second_daemon_on_the_same_directory_is_refused(tmp_path: Path):
    """Two writers would replay twice. The second one gets a message with the process of the first."""
    with Store.open(tmp_path), pytest.raises(StoreError, match="in use by another"), Store.open(tmp_path):
        pass


def test_commands_read_beside_the_daemon_and_get_a_message_before_the_first_run(tmp_path: Path):
    """A reader gets the committed state. Without a history it gets a message."""
    with pytest.raises(StoreError, match="no history yet"), Store.reader(tmp_path):
        pass
    with Store.open(tmp_path) as store:
        commit(store, replayed(store, DAY))
        with Store.reader(tmp_path) as reader:
            assert [row["coulomb_nm"] for row in reader.assessments.friction(limit=2)] == [1.5, 2.5]


def test_a_newer_history_is_refused_with_the_reason(tmp_path: Path):
    """A later schema is not opened, so it cannot be overwritten."""
    with Store.open(tmp_path) as store:
        store.database.connection.execute("PRAGMA user_version = 99")
    for opened in (Store.open, Store.reader, Store.shared):
        with pytest.raises(StoreError, match="newer"), opened(tmp_path):
            pass


@pytest.mark.parametrize("version", [1, 10])
def test_a_history_of_before_1_0_is_refused_with_what_to_do(tmp_path: Path, version: int):
    """The sentence names its version, and how its recordings go into a new history. The file stays as it was."""
    with closing(sqlite3.connect(tmp_path / "history.sqlite")) as connection:
        connection.executescript(f"CREATE TABLE ledger (id INTEGER PRIMARY KEY); PRAGMA user_version = {version}")
    before = (tmp_path / "history.sqlite").read_bytes()
    for opened in (Store.open, Store.reader, Store.shared):
        with (
            pytest.raises(OlderHistory, match=rf"before 1\.0 \(schema {version}\).*another one in.*joint-monitor import"),
            opened(tmp_path),
        ):
            pass
    assert (tmp_path / "history.sqlite").read_bytes() == before


@pytest.mark.parametrize("version", [0, 1, 3])
def test_another_programs_database_is_refused_and_stays_unchanged(tmp_path: Path, version: int):
    """For any number of schema in it, no table is added to it."""
    with closing(sqlite3.connect(tmp_path / "history.sqlite")) as connection:
        connection.executescript(f"CREATE TABLE photo (name TEXT); PRAGMA user_version = {version}")
    before = (tmp_path / "history.sqlite").read_bytes()
    for opened in (Store.open, Store.reader, Store.shared):
        with pytest.raises(StoreError, match="another program's"), opened(tmp_path):
            pass
    assert (tmp_path / "history.sqlite").read_bytes() == before


@pytest.mark.parametrize("name", ["cell #1? 50%20", "Zelle ü", "Latin-1 \udcfc"])
def test_a_folder_of_any_name_holds_a_history(tmp_path: Path, name):
    """Characters with a meaning in a URI have none in the path, and a name may hold bytes that are no UTF-8."""
    folder = tmp_path / name
    with Store.open(folder) as store:
        commit(store, replayed(store, DAY))
    with Store.open(folder) as store:
        assert store.restored is None
        assert store.back_up(3).stat().st_size > 10_000
    with Store.reader(folder) as store:
        assert len(store.ledger.rows()) == 1
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]


WRITER = """
import sys
from pathlib import Path
from monitor.store.store import Store
with Store.open(Path(sys.argv[1])) as store:
    store.ledger.repair(0.0)
    start = len(store.ledger.rows())
    for n in range(start, start + 10_000):
        i = store.ledger.claim(float(n), "scheduled", float(n))
        store.recordings.path(i).write_bytes(b"PAR1")
        store.ledger.mark_recorded(i)
        store.assessments.commit(i, at_unix_s=1.0, recorded_at_unix_s=1.0, assessment={}, friction=[{}] * 6,
                     belief={"n": n}, health={}, model={}, events=[{"n": n}])
        print(n, flush=True)
"""


@pytest.mark.slow
def test_sigkill_at_any_moment_loses_and_repeats_nothing(tmp_path: Path):
    """Everything that the writer reported as committed is there once after SIGKILL. Revision, events and history agree."""
    for _ in range(6):
        process = Process([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
        committed = -1
        for _ in range(25):
            committed = int(process.stdout.readline())
        os.kill(process.pid, signal.SIGKILL)
        committed = max([committed, *(int(line) for line in process.stdout.read().splitlines() if line.strip())])
        process.wait()
        with Store.open(tmp_path) as store:
            waiting = store.ledger.repair(0.0)
            rows = store.ledger.rows()
            state = store.assessments.state()
            assert state is not None
            assert state.belief["n"] >= committed
            assessed = [row for row in rows if row.state == "assessed"]
            assert state.revision == len(assessed) == len(store.events.rows())
            assert len(store.assessments.friction(joint=6)) == len(assessed)
            assert len(waiting) <= 1
            for row in waiting:
                store.ledger.end(row.id, "rejected", "test", 0.0)


def test_a_stop_waits_until_a_person_allows_motion_again(tmp_path: Path):
    """The stop is stored in one transaction with the end of its window, or without a window. A person allows motion once, by name."""
    with Store.open(tmp_path) as store:
        ledger_id = store.ledger.claim(DAY, "scheduled", DAY)
        store.ledger.end(ledger_id, "aborted", "joint 3 hit something", DAY + 1, stop="protective_stop")
        harmless = store.ledger.claim(2 * DAY, "scheduled", 2 * DAY)
        store.ledger.end(harmless, "aborted", "the cable was pulled", 2 * DAY)
        with Store.shared(tmp_path) as beside:  # `joint-monitor replay` beside the daemon
            beside.stops.add("torque_band", "too heavy", 3 * DAY)
        assert [(stop.ledger_id, stop.cause) for stop in store.stops.waiting()] == [(ledger_id, "protective_stop"), (None, "torque_band")]
        with Store.shared(tmp_path) as beside:  # `joint-monitor allow` beside the daemon
            assert len(beside.stops.allow("Ada", "looked at it", 4 * DAY)) == 2
            assert beside.stops.allow("Ada", "again", 5 * DAY) == []
        assert store.stops.waiting() == []


def test_a_first_pass_is_valid_until_its_circumstances_change(tmp_path: Path):
    """A change and its reversal are two changes, because other things may have moved meanwhile."""
    with Store.open(tmp_path) as store:
        assert not store.first_passes.is_latest("a")
        store.first_passes.add("a", {"payload_kg": 1.0}, 1.0)
        assert store.first_passes.is_latest("a")
        store.first_passes.add("b", {"payload_kg": 2.0}, 2.0)
        assert not store.first_passes.is_latest("a")
        assert store.first_passes.latest() == {"payload_kg": 2.0}


def test_a_stop_is_stored_whatever_its_reason_holds(tmp_path: Path):
    """A reason comes back as code, parameters and text; of one with a figure that JSON cannot hold, the text is kept."""
    measured = Sentence("measured_for_a_test", "joint {joint} needs {torque_nm:.1f} N·m")
    with Store.open(tmp_path) as store:
        store.stops.add("torque_band", measured(joint=2, torque_nm=126.6), DAY)
        store.stops.add("torque_band", measured(joint=2, torque_nm=float("nan")), DAY)
        first, second = store.stops.waiting()
    assert (first.reason.code, dict(first.reason.parameters)) == ("measured_for_a_test", {"joint": 2, "torque_nm": 126.6})
    assert first.text == "a replay by hand was ended by torque_band: joint 2 needs 126.6 N·m"
    assert second.reason.text == "joint 2 needs nan N·m"
