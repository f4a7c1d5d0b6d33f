"""An archive whose objects somebody has changed, and a history that does not know what was archived since its backup."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_archive import DAY, NOW, configuration, drained, listed, recording, rejected, uploads_of

from monitor.errors import ArchiveConflict
from monitor.service import uploads as uploads_module
from monitor.service.problems import Problems
from monitor.service.uploads import PROBLEM, Uploads
from monitor.store.archive.archive import Archive, key_of
from monitor.store.backup import HISTORY, back_up
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.store.store import Store


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fetched recordings, apart from those of other tests."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    (tmp_path / "archive").mkdir()
    with Store.open(tmp_path) as store:
        yield store


def change(path: Path) -> None:
    """Other bytes in the midst of a file, which is as long as before: neither a listing nor its name shows it."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.chmod(0o644)
    path.write_bytes(content)


def test_a_local_recording_goes_only_after_its_copy_was_read_back(tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch):
    """One object was changed at its full length: its recording stays, and is told. It is brought again once that is removed."""
    monkeypatch.setattr(uploads_module, "AT_A_TIME", 4)
    numbers = [rejected(store, day) for day in range(16)]
    clock, problems, settings = [0.0], Problems(lambda: NOW), configuration(tmp_path)
    uploads = Uploads(store, lambda: settings, problems, lambda: NOW, lambda: clock[0])
    drained(uploads)
    damaged = Path(store.archived.of(numbers[2]).address)
    change(damaged)
    settings = configuration(tmp_path, keep_local_days=1.0)
    clock[0] += 1.1 * DAY
    drained(uploads)
    assert [store.recordings.path(number).exists() for number in numbers] == [False, False, True, False, False, False, *[True] * 10]
    assert f"replay {numbers[2]}: {damaged}: holds another content" in listed(problems)[PROBLEM]
    assert "the recording stays here" in listed(problems)[PROBLEM]
    damaged.unlink()
    clock[0] += 1.1 * DAY
    drained(uploads)
    assert damaged.exists()
    clock[0] += 1.1 * DAY
    drained(uploads)
    assert problems.listed() == []
    assert not store.recordings.path(numbers[2]).exists()
    assert read_recording(store.archived.path(numbers[2])).samples == 20


def test_an_archive_that_goes_away_meanwhile_costs_no_recording(tmp_path: Path, store: Store):
    """What was not read back stays here, and goes when the archive is there again."""
    numbers = [rejected(store, day) for day in range(12)]
    uploads, problems = uploads_of(store, configuration(tmp_path, keep_local_days=1.0))
    uploads.step()  # brings them
    uploads.step()  # compares
    (tmp_path / "archive").rename(tmp_path / "unmounted")
    assert uploads.step() > 0.0
    assert all(store.recordings.path(number).exists() for number in numbers)
    (tmp_path / "unmounted").rename(tmp_path / "archive")
    drained(uploads)
    assert [store.recordings.path(number).exists() for number in numbers] == [False, False, *[True] * 10]
    assert problems.listed() == []


def test_a_local_recording_that_was_changed_after_it_was_archived_is_told(tmp_path: Path, store: Store):
    """The history knows its SHA-256. Once it is out of the way, the archive's copy is taken."""
    number = rejected(store, 1)
    drained(uploads_of(store, configuration(tmp_path))[0])
    local = store.archived.path(number)
    change(local)
    with pytest.raises(ArchiveConflict, match="is not the recording that was made: its SHA-256 begins with"):
        store.archived.path(number)
    local.unlink()
    assert read_recording(store.archived.path(number)).samples == 20


def test_a_local_recording_that_goes_between_two_looks_is_taken_from_the_archive(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
):
    """The service may let go of it while a command reads."""
    number = rejected(store, 1)
    drained(uploads_of(store, configuration(tmp_path))[0])
    store.recordings.path(number).unlink()
    monkeypatch.setattr(Path, "is_file", lambda _: True)  # as it was a moment ago
    assert read_recording(store.archived.path(number)).samples == 20


def test_a_changed_object_stays_a_problem_while_the_next_comparison_goes_on(tmp_path: Path, store: Store):
    """It does not end and begin again every day: each end and beginning is told."""
    numbers = [rejected(store, day) for day in range(12)]
    clock, problems, settings = [0.0], Problems(lambda: NOW), configuration(tmp_path)
    uploads = Uploads(store, lambda: settings, problems, lambda: NOW, lambda: clock[0])
    drained(uploads)
    change(Path(store.archived.of(numbers[1]).address))
    settings = configuration(tmp_path, keep_local_days=1.0)
    clock[0] += 1.1 * DAY
    drained(uploads)
    clock[0] += 1.1 * DAY
    told = []
    while uploads.step() == 0.0:
        told.append(listed(problems).get(PROBLEM, "").startswith(f"replay {numbers[1]}: "))
    assert told == [True, True]  # after the comparison, and after it was read back once more
    assert "more" not in listed(problems)[PROBLEM]  # it is told once


def restored(folder: Path, backup: Path) -> None:
    """The state of the history as it was at a backup."""
    for path in folder.glob(f"{HISTORY}*"):
        path.unlink()
    shutil.copy(backup, folder / HISTORY)


def test_a_history_restored_from_an_older_backup_learns_what_was_archived_since(tmp_path: Path):
    """By number and time. Another recording of the same number, and one whose content is not what its name says, are not taken."""
    (tmp_path / "archive").mkdir()
    settings = configuration(tmp_path)
    with Store.open(tmp_path) as store:
        numbers = [rejected(store, day) for day in range(4)]
        write_recording(store.recordings.path(numbers[1]), recording(None))  # it does not say when: it has the time of its window
        backup = back_up(tmp_path, 14)
        drained(uploads_of(store, settings)[0])
        addresses = [row.address for row in store.archived.rows()]
        for number in numbers[:3]:
            store.recordings.path(number).unlink()
            store.ledger.mark_removed(number, NOW)
    content = b"PAR1 of another history of this arm"
    Archive.open(settings.archive).put(content, key_of("lab", "cell-1", NOW - 10 * DAY, numbers[0], content))
    change(Path(addresses[2]))
    restored(tmp_path, backup)
    with Store.open(tmp_path) as store:
        assert store.archived.rows() == []
        uploads, problems = uploads_of(store, settings)
        drained(uploads)
        assert [(row.ledger_id, row.address) for row in store.archived.rows()] == [
            (number, address) for number, address in zip(numbers, addresses, strict=True) if number != numbers[2]
        ]
        assert read_recording(store.archived.path(numbers[0])).samples == 20
        assert f"replay {numbers[2]}: {addresses[2]}: holds another content" in listed(problems)[PROBLEM]
