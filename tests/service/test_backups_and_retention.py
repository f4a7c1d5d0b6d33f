"""A history of years: it is backed up, restored after damage, pruned, and recomputed to the last bit."""

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from once import once
from test_store import DAY, commit, replayed

from monitor.config.load import from_document
from monitor.config.schema import Configuration
from monitor.errors import StoreError
from monitor.recording import Recording
from monitor.service.history.assess_and_store import EstimatorState, assess_stored, load_state, state_after
from monitor.service.history.recompute import recompute
from monitor.service.motion import check_conditions
from monitor.service.preflight import service_conditions
from monitor.service.problems import Problems
from monitor.service.uploads import Uploads
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store import backup as module
from monitor.store.archive.archived import LEAST_KEPT, KeptRecording, to_prune
from monitor.store.backup import back_up, backups, fault
from monitor.store.formats.recordings import write_recording
from monitor.store.provenance import differences, processor_family
from monitor.store.store import RESTORED, Store

HISTORY = "history.sqlite"


def history(folder: Path, replays: int = 3) -> None:
    with Store.open(folder) as store:
        for n in range(replays):
            commit(store, replayed(store, n * DAY))


def torn(path: Path) -> None:
    """All pages but the first two are random bytes, as on a disk that lost its writes."""
    with path.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(8192)
        file.write(os.urandom(size - 8192))


@pytest.mark.parametrize("damage", [torn, lambda path: path.write_bytes(b"this is no database" * 100), lambda path: path.write_bytes(b"")])
def test_a_damaged_history_is_set_aside_and_the_newest_good_backup_takes_its_place(tmp_path: Path, damage: Callable[[Path], Any]):
    """Torn pages, another file, an empty file. The newest backup is damaged too, so the one before it is used."""
    history(tmp_path)
    good = back_up(tmp_path, 14)
    (good.parent / "history-99990101T000000Z.sqlite").write_bytes(b"SQLite format 3\0" + os.urandom(5000))
    history(tmp_path / "other")
    damage(tmp_path / HISTORY)
    with Store.open(tmp_path) as store:
        assert store.restored is not None
        assert store.restored.backup == good
        assert store.restored.set_aside.is_file()
        assert "***" not in store.restored.reason.text  # the text states what is wrong, and not which database
        assert len(store.assessments.rows()) == 3
        commit(store, replayed(store, 9 * DAY))
        assert store.events.rows()[-1].seq > 1_000_000  # the damaged history may have used the next numbers
        assert "replaced by the backup" in store.notes.get(RESTORED)  # until an alert has reported it
    with Store.open(tmp_path) as store:
        assert store.restored is None
        assert store.notes.get(RESTORED)


def test_a_lost_history_is_restored_from_its_backup_and_recordings_are_never_overwritten(tmp_path: Path):
    """The file was deleted, or a restoration was interrupted. Without a backup only the recordings show that there was a history."""
    history(tmp_path)
    back_up(tmp_path, 14)
    (tmp_path / HISTORY).unlink()
    with Store.open(tmp_path) as store:
        assert store.restored is not None
        assert "gone" in store.restored.reason.text
        assert len(store.assessments.rows()) == 3
    for path in (tmp_path / "backups").iterdir():
        path.unlink()
    (tmp_path / HISTORY).unlink()
    with Store.open(tmp_path) as store:
        assert store.restored is not None
        assert [number for number, _ in store.ledger.orphans()] == [1, 2, 3]


def test_entries_lost_with_a_torn_log_are_detected_and_no_recording_is_overwritten(tmp_path: Path):
    """The file is valid and ends a replay earlier. The recording shows this before its number is used for another replay."""
    lived_in, copy = tmp_path / "lived", tmp_path / "copy"
    with Store.open(lived_in) as store:
        commit(store, replayed(store, DAY))
        store.database.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        commit(store, replayed(store, 2 * DAY))
        shutil.copytree(lived_in, copy)  # as after a power cut
    with (copy / f"{HISTORY}-wal").open("r+b") as log:
        log.seek(100)
        log.write(os.urandom(64))
    with Store.open(copy) as store:
        assert [row.id for row in store.ledger.rows()] == [1]
        assert store.restored is not None
        assert "lost its newest entries (1 recordings from replay 2 on" in store.restored.reason.text
        store.ledger.adopt(2, 2 * DAY, 3 * DAY)
        assert store.ledger.claim(3 * DAY, "scheduled", 3 * DAY) == 3
        store.ledger.end(3, "rejected", "a test", 3 * DAY)
    with Store.open(copy) as store:
        assert store.restored is None


def test_a_damaged_history_without_a_backup_is_kept_and_a_new_one_begins(tmp_path: Path):
    """Nothing is deleted: the file is kept under another name, and the recordings can be entered later."""
    history(tmp_path)
    torn(tmp_path / HISTORY)
    with Store.open(tmp_path) as store:
        assert store.restored is not None
        assert store.restored.backup is None
        assert "no good backup" in store.restored.reason.text
        assert [number for number, _ in store.ledger.orphans()] == [1, 2, 3]
        assert store.ledger.rows() == []


def test_a_history_that_cannot_be_read_for_another_reason_is_not_replaced(tmp_path: Path):
    """A lock, or a folder in its place, does not show that its pages are damaged."""
    history(tmp_path)
    back_up(tmp_path, 14)
    other = sqlite3.connect(tmp_path / HISTORY, isolation_level=None)
    with closing(other):
        other.execute("PRAGMA locking_mode = EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreError, match="locked"), Store.open(tmp_path):
            pass
    assert list(tmp_path.glob("damaged-*")) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="NOT ROOT: cannot become another user, so what one who may not read is told is not tested")
@pytest.mark.parametrize("may_enter", [False, True])
def test_a_user_without_read_permission_gets_a_message_with_the_owner(may_enter: bool):
    """The directory belongs to the service. Every command that reads gets a message with what to do, and not "no history"."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o711)
        folder = Path(name) / "cell-1"
        history(folder, 1)
        folder.chmod(0o711 if may_enter else 0o700)
        document = {"robot": {"model": "ur5", "site": "lab", "id": "a"}, "store": {"directory": str(folder)}}
        settings = from_document(document, Path(name) / "cell.toml")
        before = os.geteuid()
        os.seteuid(65534)
        try:
            with pytest.raises(StoreError, match=r"may not be read by this user .*sudo -u root joint-monitor"), Store.reader(folder):
                pass
            with pytest.raises(StoreError, match="may not be read"):
                check_conditions(settings)
            found = {each.name: each for each in service_conditions(settings)}
        finally:
            os.seteuid(before)
    assert "may not be read" in found["history"].text
    assert found["disk"].text


@pytest.mark.skipif(os.geteuid() != 0, reason="NOT ROOT: nothing of root's can be handed over, which is not tested")
def test_files_that_root_makes_in_the_services_directory_belong_to_the_service(tmp_path: Path):
    """An administrator imports recordings or allows motion before the first start. The service must be able to write there later."""
    os.chown(tmp_path, 65534, 65534)
    history(tmp_path, 1)
    with Store.shared(tmp_path) as store:
        store.stops.allow("Ada", "seen", 1e9)
    back_up(tmp_path, 3)
    with Store.open(tmp_path):
        pass
    found = {path: path.stat().st_uid for path in tmp_path.rglob("*")}
    assert len(found) >= 5
    assert set(found.values()) == {65534}, found


def test_backups_keep_the_newest_of_each_day_and_no_more_days_than_asked(tmp_path: Path):
    """A service that is started a hundred times a day keeps the backups of older days."""
    history(tmp_path)
    folder = tmp_path / "backups"
    folder.mkdir()
    for day in range(1, 29):
        for hour in (3, 15):
            (folder / f"history-202601{day:02}T{hour:02}0000Z.sqlite").write_bytes(b"")
    made = back_up(tmp_path, 14)
    kept = [path.name for path in backups(tmp_path)]
    assert kept[0] == made.name
    assert kept[1:] == [f"history-202601{day:02}T150000Z.sqlite" for day in range(28, 15, -1)]
    assert fault(made) is None


def test_a_backup_is_made_beside_a_writer_and_holds_what_was_committed(tmp_path: Path):
    """The backup does not wait for the writer, and it can be opened as a history."""
    with Store.open(tmp_path) as store:
        commit(store, replayed(store, DAY))
        store.database.connection.execute("BEGIN IMMEDIATE")
        made = store.back_up(3)
        store.database.connection.execute("ROLLBACK")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / HISTORY).write_bytes(made.read_bytes())
    with Store.open(tmp_path / "elsewhere") as copy:
        assert len(copy.assessments.rows()) == 1


def test_a_damaged_history_never_replaces_a_good_backup(tmp_path: Path):
    """The copy is checked before it is kept."""
    history(tmp_path, 30)
    good = back_up(tmp_path, 1)
    torn(tmp_path / HISTORY)
    with pytest.raises(StoreError, match=r"damaged|cannot be written"):
        module.back_up(tmp_path, 1)
    assert backups(tmp_path) == [good]
    assert list(good.parent.glob(".*")) == []


def test_recordings_are_pruned_by_age_and_by_size_and_their_verdicts_stay(tmp_path: Path):
    """The oldest are deleted first, but never the last ten and never one without its assessment. The ledger notes it."""
    kept = [KeptRecording(n, tmp_path / str(n), n * DAY, 100) for n in range(30)]
    now = 30 * DAY
    assert to_prune(kept, days=0, most_bytes=0, now_unix_s=now) == []
    assert [each.ledger_id for each in to_prune(kept, days=25, most_bytes=0, now_unix_s=now)] == [0, 1, 2, 3, 4]
    assert [each.ledger_id for each in to_prune(kept, days=0, most_bytes=2700, now_unix_s=now)] == [0, 1, 2]
    assert len(to_prune(kept, days=1, most_bytes=1, now_unix_s=now)) == 30 - LEAST_KEPT
    with Store.open(tmp_path) as store:
        for n in range(15):
            commit(store, replayed(store, n * DAY))
        waiting = replayed(store, 0.5 * DAY)
        (store.recordings.directory / "replay-000002.parquet").unlink()  # by a person
        gone = store.retention.prune(days=1, most_bytes=0, at_unix_s=30 * DAY)
        assert gone == [f"replay-{n:06d}.parquet" for n in (1, 3, 4, 5)]  # fourteen are left, and ten are always kept
        assert store.recordings.path(waiting).is_file()
        assert [row.id for row in store.ledger.rows() if row.removed_at_unix_s is not None] == [1, 2, 3, 4, 5]
        assert len(store.assessments.rows()) == 15
        assert store.retention.prune(days=1, most_bytes=0, at_unix_s=30 * DAY) == []


# --- the same verdicts again ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    """Three recordings of a simulated arm."""
    excitation = replace(configuration(Path()).excitation, repetitions=1)
    arm = Controller(SimulateSettings(robot="ur5"))
    return once(tmp_path_factory, "recordings", lambda _: [stepped_replay(arm, excitation) for _ in range(3)])


def configuration(folder: Path, **sections: Any) -> Configuration:
    least = {"robot": {"model": "ur5", "site": "lab", "id": "cell-1"}, "store": {"directory": str(folder)}}
    return from_document(least | sections, folder / "cell.toml")


def lived(store: Store, configuration: Configuration, recordings: list[Recording], days: range) -> EstimatorState:
    """The given number of days with one replay each."""
    known = load_state(store)
    for day in days:
        at = 1.0e9 + day * DAY
        ledger_id = store.ledger.claim(at, "scheduled", at)
        recording = recordings[day % len(recordings)]
        context = replace(configuration.context, firmware=recording.context.firmware, recorded_at_unix_s=at)
        path = store.recordings.path(ledger_id)
        write_recording(path, replace(recording, context=context, source=path.name))
        store.ledger.mark_recorded(ledger_id)
        known = state_after(known, assess_stored(store, configuration, known, ledger_id, lambda at=at: at))
    return known


def test_every_past_verdict_is_recomputed_to_the_last_bit(tmp_path: Path, recordings: list[Recording]):
    """The recordings suffice. The settings are those of the day, although the configuration has changed since."""
    first = configuration(tmp_path)
    changed = configuration(tmp_path, health={"advisory_rise": 0.02}, identify={"signals": {"cutoff_hz": 7.0}})
    with Store.open(tmp_path) as store:
        lived(store, first, recordings, range(2))
        lived(store, changed, recordings, range(2, 4))
        result = recompute(store)
    assert (result["assessments"], result["identical"], result["different"], result["not_recomputable"]) == (4, 4, 0, 0)
    assert result["changed_since"] == []
    assert result["circumstances"]["processor"] == processor_family()


def test_a_recomputed_verdict_that_differs_is_named_with_the_difference_and_its_cause(tmp_path: Path, recordings: list[Recording]):
    """One stored figure was altered, and one replay was judged by another version of a package."""
    with Store.open(tmp_path) as store:
        lived(store, configuration(tmp_path), recordings, range(2))
        store.database.connection.execute(
            "UPDATE assessment SET document = json_set(document, '$.friction[2].coulomb_nm', 1.0) WHERE ledger_id = 2"
        )
        store.database.connection.execute("UPDATE provenance SET document = json_set(document, '$.programs.packages.numpy', '1.0')")
        result = recompute(store)
    assert (result["identical"], result["different"]) == (1, 1)
    (differing,) = result["differing"]
    assert differing["replay"] == 2
    assert differing["figures"] == 1
    assert differing["differs"][0].startswith("friction.3.coulomb_nm: 1.0, now ")
    assert len(result["changed_since"]) == 1
    assert result["changed_since"][0].startswith("packages.numpy: 1.0, now 2.")


def test_after_retention_a_recomputation_goes_on_from_the_next_checkpoint(
    tmp_path: Path, recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
):
    """Verdicts that cannot be recomputed any more are counted. From the next checkpoint on, all are identical."""
    monkeypatch.setattr("monitor.store.history.assessments.CHECKPOINT_EVERY", 3)
    with Store.open(tmp_path) as store:
        lived(store, configuration(tmp_path), recordings, range(5))
        store.recordings.path(2).unlink()
        result = recompute(store)
    assert (result["identical"], result["different"], result["not_recomputable"]) == (2, 0, 3)


def test_each_difference_is_named_by_its_key():
    """Nested keys are joined by dots; added and removed keys are listed too."""
    assert differences({"a": {"b": 1, "c": 2}, "d": 3}, {"a": {"b": 1, "c": 5}, "e": 4}) == [
        "a.c: 2, now 5",
        "d: 3, now None",
        "e: None, now 4",
    ]


def test_verdicts_are_recomputed_to_the_last_bit_from_recordings_that_only_the_archive_has(
    tmp_path: Path, recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
):
    """Local retention may be short. An archive that is away is an error, and no verdict that cannot be recomputed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "archive").mkdir()
    first = configuration(tmp_path, store={"directory": str(tmp_path), "recordings": "archive"})
    with Store.open(tmp_path) as store:
        lived(store, first, recordings, range(2))
        uploads = Uploads(store, lambda: first, Problems(lambda: 1e9), lambda: 1e9)
        while uploads.step() == 0.0:
            pass
        for row in store.ledger.rows():
            store.recordings.path(row.id).unlink()
            store.ledger.mark_removed(row.id, 1e9)
        result = recompute(store)
        assert (result["assessments"], result["identical"], result["not_recomputable"]) == (2, 2, 0)
        shutil.rmtree(tmp_path / "cache")
        (tmp_path / "archive").rename(tmp_path / "away")
        with pytest.raises(StoreError, match="there is no such folder"):
            recompute(store)
