"""Recordings go to an archive, are found there when they are no longer here, and nothing is lost, doubled or overwritten."""

import hashlib
import os
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.dataset as ds
import pytest

from monitor.config.load import from_document
from monitor.config.schema import Configuration
from monitor.errors import ArchiveConflict, ArchiveRefused, ArchiveUnavailable, BadConfiguration, BadInput
from monitor.publish.documents import ArmLink, Waiting
from monitor.recording import Context, Recording
from monitor.service import uploads as uploads_module
from monitor.service.computing import Apart
from monitor.service.housekeeping import Housekeeping
from monitor.service.monitor_document import MonitorDocument, OfOthers
from monitor.service.preflight import service_conditions
from monitor.service.problems import Problems
from monitor.service.uploads import FIRST_RETRY_S, IDLE_S, LONGEST_RETRY_S, PROBLEM, SLOW, SLOW_S, Stopping, Uploads
from monitor.store.archive.archive import Archive, RecordingCache, key_of, split_address
from monitor.store.archive.places import ArchiveSettings
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.store.identify_files import named_recordings
from monitor.store.store import Store
from monitor.views.terminal.arm import monitor_lines

DAY = 86_400.0
NOW = 1.8e9
OTHERS = OfOthers(None, None, None, None, None, ArmLink(heard=True), Waiting(to_send=0, to_answer=0, dropped=0), {}, [])


def recording(at_unix_s: float | None, seed: int = 0) -> Recording:
    """Two seconds that no identification would take; the archive does not ask."""
    q = np.random.default_rng(seed).normal(size=(20, 6))
    return Recording(t_s=np.arange(20) / 10.0, q=q, qd=q, current=q, context=Context(robot="ur5", recorded_at_unix_s=at_unix_s))


def rejected(store: Store, day: int, at_unix_s: float | None = None) -> int:
    """A window whose recording was made and not learned from: it is kept, and archived, like any other."""
    at = NOW - 400 * DAY + day * DAY
    ledger_id = store.ledger.claim(at, "scheduled", at)
    assert ledger_id is not None
    write_recording(store.recordings.path(ledger_id), recording(at if at_unix_s is None else at_unix_s, day))
    store.ledger.mark_recorded(ledger_id)
    store.ledger.end(ledger_id, "rejected", "a test", at)
    return ledger_id


def configuration(folder: Path, **store: object) -> Configuration:
    robot = {"model": "ur5", "site": "lab", "id": "cell-1"}
    return from_document({"robot": robot, "store": {"directory": str(folder), "recordings": "archive", **store}}, folder / "cell.toml")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Fetched recordings, apart from those of other tests."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)
    return tmp_path / "cache/joint-monitor/recordings"


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    (tmp_path / "archive").mkdir()
    with Store.open(tmp_path) as store:
        yield store


def uploads_of(store: Store, settings: Configuration) -> tuple[Uploads, Problems]:
    problems = Problems(lambda: NOW)
    return Uploads(store, lambda: settings, problems, lambda: NOW), problems


def drained(uploads: Uploads) -> float:
    """Steps until there is a pause, which is returned."""
    for _ in range(100):
        if (pause_s := uploads.step()) > 0.0:
            return pause_s
    raise AssertionError("uploads do not come to an end")


def listed(problems: Problems) -> dict[str, str]:
    return {each.name: each.text for each in problems.listed()}


def test_each_recording_goes_to_the_archive_once_and_the_history_says_where(tmp_path: Path, store: Store):
    """Address and SHA-256 stand in the history. Another start sends nothing; a recording without its outcome waits for that."""
    first, second = rejected(store, 1), rejected(store, 2)
    unfinished = store.ledger.claim(NOW, "scheduled", NOW)
    write_recording(store.recordings.path(unfinished), recording(NOW))
    settings = configuration(tmp_path)
    uploads, problems = uploads_of(store, settings)
    assert drained(uploads) == IDLE_S
    assert [row.ledger_id for row in store.archived.rows()] == [first, second]
    for row in store.archived.rows():
        content = Path(row.address).read_bytes()
        assert content == store.recordings.path(row.ledger_id).read_bytes()
        assert (hashlib.sha256(content).hexdigest(), len(content)) == (row.sha256, row.size)
        assert Path(row.address).relative_to(tmp_path / "archive").parts[:2] == ("site=lab", "robot=cell-1")
    before = sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "archive").rglob("*"))
    drained(uploads_of(store, settings)[0])
    assert sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "archive").rglob("*")) == before
    document = MonitorDocument(store, problems, lambda: NOW).collect(OTHERS).store.archive
    assert (document.recordings, document.waiting) == (2, 0)
    assert problems.listed() == []
    rejected(store, 3)
    said = MonitorDocument(store, problems, lambda: NOW).collect(OTHERS).model_dump(mode="json")
    assert f"archive {tmp_path / 'archive'}: 2 recordings; 1 wait, the oldest since 20" in monitor_lines(said)


def test_pandas_and_pyarrow_read_the_archive_by_its_partitions_without_our_code(tmp_path: Path, store: Store):
    """site, robot and year are columns of the whole, as any reader of partitioned Parquet finds them."""
    for day in (1, 2, 300):
        rejected(store, day)
    drained(uploads_of(store, configuration(tmp_path))[0])
    frame = pd.read_parquet(tmp_path / "archive")
    assert (len(frame), set(frame["site"]), set(frame["robot"])) == (60, {"lab"}, {"cell-1"})
    years = {path.parent.name.removeprefix("year=") for path in (tmp_path / "archive").rglob("*.parquet")}
    assert {str(year) for year in frame["year"].unique()} == years
    one = ds.dataset(tmp_path / "archive", partitioning="hive").to_table(filter=ds.field("year") == int(min(years)))
    assert 0 < one.num_rows < 60


def test_a_monitor_killed_between_upload_and_note_sends_nothing_under_a_second_name(tmp_path: Path, store: Store):
    """The name follows from the recording alone, so the next start finds it there. Half a file, which a kill leaves, is no recording."""
    number = rejected(store, 1)
    content = store.recordings.path(number).read_bytes()
    settings = configuration(tmp_path)
    archive = Archive.open(settings.archive)
    key = key_of("lab", "cell-1", NOW - 399 * DAY, number, content)
    archive.put(content, key)
    (tmp_path / "archive" / key).with_name(".half.parquet.tmp").write_bytes(content[:100])
    drained(uploads_of(store, settings)[0])
    assert [row.address for row in store.archived.rows()] == [archive.address(key)]
    assert [each.key for each in archive.recordings()] == [key]


def test_another_content_under_the_name_is_told_and_never_overwritten(tmp_path: Path, store: Store):
    """The recording stays here, and the next ones go on. After a person has put it right, the next start brings it."""
    damaged, sound = rejected(store, 1), rejected(store, 2)
    settings = configuration(tmp_path)
    content = store.recordings.path(damaged).read_bytes()
    place = tmp_path / "archive" / key_of("lab", "cell-1", NOW - 399 * DAY, damaged, content)
    place.parent.mkdir(parents=True)
    place.write_bytes(b"PAR1 cut short")
    uploads, problems = uploads_of(store, settings)
    assert drained(uploads) == IDLE_S
    assert place.read_bytes() == b"PAR1 cut short"
    assert [row.ledger_id for row in store.archived.rows()] == [sound]
    assert f"replay {damaged}: " in listed(problems)[PROBLEM]
    assert "another content" in listed(problems)[PROBLEM]
    assert store.retention.prune(days=1, most_bytes=0, at_unix_s=NOW, among={sound}) == []  # the last ten stay
    place.unlink()
    drained(uploads_of(store, settings)[0])
    assert len(store.archived.rows()) == 2


def test_what_a_person_puts_right_in_the_archive_is_brought_within_a_day(tmp_path: Path, store: Store):
    """Without a restart, and the problem stays until then: it does not go and come back each day."""
    damaged = rejected(store, 1)
    settings, clock, told = configuration(tmp_path), [0.0], []
    content = store.recordings.path(damaged).read_bytes()
    place = tmp_path / "archive" / key_of("lab", "cell-1", NOW - 399 * DAY, damaged, content)
    place.parent.mkdir(parents=True)
    place.write_bytes(b"PAR1 cut short")
    problems = Problems(lambda: NOW)
    uploads = Uploads(store, lambda: settings, problems, lambda: NOW, lambda: clock[0])
    drained(uploads)
    clock[0] += 1.1 * DAY
    while uploads.step() == 0.0:
        told.append(PROBLEM in listed(problems))
    assert len(told) == 2, "compared, and tried once more"
    assert all(told)
    assert store.archived.rows() == []
    place.unlink()
    clock[0] += 1.1 * DAY
    drained(uploads)
    assert place.read_bytes() == content
    assert [row.ledger_id for row in store.archived.rows()] == [damaged]
    assert PROBLEM not in listed(problems)


def test_an_archive_that_is_away_is_a_problem_after_some_tries_and_over_when_it_is_back(tmp_path: Path, store: Store):
    """A mount that is missing is not made below its mount point. The pauses double, up to a limit."""
    rejected(store, 1)
    (tmp_path / "archive").rename(tmp_path / "unmounted")
    uploads, problems = uploads_of(store, configuration(tmp_path))
    pauses = [uploads.step() for _ in range(10)]
    assert pauses[:3] == [FIRST_RETRY_S, 2 * FIRST_RETRY_S, 4 * FIRST_RETRY_S]
    assert pauses[-1] == LONGEST_RETRY_S
    assert "mount" in listed(problems)[PROBLEM]
    assert "1 recordings wait here" in listed(problems)[PROBLEM]
    assert not (tmp_path / "archive").exists()
    (tmp_path / "unmounted").rename(tmp_path / "archive")
    assert drained(uploads) == IDLE_S
    assert problems.listed() == []
    assert uploads.step() == IDLE_S


def test_a_short_cut_of_the_connection_is_no_problem(tmp_path: Path, store: Store):
    """A server that starts again is not worth a word."""
    rejected(store, 1)
    (tmp_path / "archive").rename(tmp_path / "unmounted")
    uploads, problems = uploads_of(store, configuration(tmp_path))
    uploads.step()
    (tmp_path / "unmounted").rename(tmp_path / "archive")
    drained(uploads)
    assert problems.listed() == []
    assert store.archived.count() == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="NOT ROOT: cannot become another user, so a folder of another's is not tested")
def test_a_folder_that_may_not_be_written_is_told_at_once():
    """Waiting does not change it, and the sentence says what would."""
    with tempfile.TemporaryDirectory() as name:  # other users cannot enter pytest's folder
        Path(name).chmod(0o755)
        before = os.geteuid()
        os.seteuid(65534)
        try:
            with pytest.raises(ArchiveRefused, match="to the user of the service"):
                Archive.open(ArchiveSettings(address=name)).put(b"PAR1", key_of("lab", "cell-1", NOW, 1, b"PAR1"))
        finally:
            os.seteuid(before)


def test_an_upload_that_hangs_blocks_nothing_and_is_told_by_another_thread(tmp_path: Path, store: Store, monkeypatch):
    """The next window is entered meanwhile. Maintenance looks at the clock, because the thread itself cannot."""
    rejected(store, 1)
    entered, let_go, clock = threading.Event(), threading.Event(), [0.0]

    def hang(*_: object) -> None:
        entered.set()
        let_go.wait(60.0)

    monkeypatch.setattr(Archive, "put", hang)
    problems = Problems(lambda: NOW)
    uploads = Uploads(store, lambda: configuration(tmp_path), problems, lambda: NOW, lambda: clock[0])
    stopping = threading.Event()
    thread = threading.Thread(target=uploads.run, args=(stopping,), daemon=True)
    thread.start()
    assert entered.wait(60.0)
    assert store.ledger.claim(NOW, "scheduled", NOW) is not None
    uploads.observe()
    assert problems.listed() == []
    clock[0] = SLOW_S + 60.0
    uploads.observe()
    assert "for 6 min" in listed(problems)[SLOW]
    stopping.set()
    let_go.set()
    thread.join(60.0)
    assert not thread.is_alive()


@pytest.mark.slow
def test_uploads_go_from_a_process_of_their_own_which_ends_at_once_with_the_service(tmp_path: Path, store: Store):
    """The daemon holds none of its libraries. What a child refuses is told as here."""
    rejected(store, 1)
    stops: list[bool] = []

    def alive() -> None:
        if stops:
            raise Stopping

    settings, problems = configuration(tmp_path), Problems(lambda: NOW)
    uploads = Uploads(store, lambda: settings, problems, lambda: NOW, compute=Apart(alive))
    assert drained(uploads) == IDLE_S
    assert store.archived.count() == 1
    rejected(store, 2)
    (tmp_path / "archive").rename(tmp_path / "unmounted")
    assert [uploads.step() for _ in range(3)] == [FIRST_RETRY_S, 2 * FIRST_RETRY_S, 4 * FIRST_RETRY_S]
    assert "mount" in listed(problems)[PROBLEM]
    stops.append(True)
    with pytest.raises(Stopping):
        uploads.step()
    uploads.run(threading.Event())  # it returns


def test_only_what_the_archive_has_is_pruned_and_the_rest_stays_whatever_the_limits(tmp_path: Path, store: Store, monkeypatch):
    """keep_local_days is short. What the archive has lost is brought again, and stays until it is there. The last ten stay in any case."""
    numbers = [rejected(store, day) for day in range(16)]
    settings, clock = configuration(tmp_path, keep_local_days=1.0), [0.0]
    problems = Problems(lambda: NOW)
    uploads = Uploads(store, lambda: settings, problems, lambda: NOW, lambda: clock[0])
    monkeypatch.setattr(uploads_module, "AT_A_TIME", 4)
    uploads.step()
    store.notes.set("production_arm", str(numbers[1]))  # the replay that ordinary work is measured against
    Housekeeping(store, lambda: settings.store, problems, lambda: NOW, uploads.observe).maintain()
    assert all(store.recordings.path(number).exists() for number in numbers)  # nobody has looked into the archive
    place = Path(store.archived.of(numbers[3]).address)
    place.rename(tmp_path / "expired")  # by a rule of the bucket, or by a person
    drained(uploads)
    here = [store.recordings.path(number).exists() for number in numbers]
    assert here == [False, True, False, True, False, False, *[True] * 10]
    assert place.exists()  # it was brought again
    for number in numbers:
        path = store.archived.path(number)
        assert read_recording(path).context.recorded_at_unix_s == store.ledger.row(number).window_unix_s
    assert store.archived.count() == 16  # none of the pruned ones is sent again, none of the others is forgotten
    assert problems.listed() == []
    Path(store.archived.of(numbers[0]).address).rename(tmp_path / "expired")
    assert drained(uploads) == IDLE_S
    assert problems.listed() == []
    clock[0] = 1.1 * DAY
    drained(uploads)
    assert not store.recordings.path(numbers[3]).exists()
    assert "replay-000001" in listed(problems)[PROBLEM]
    assert "is not there any more, and not here" in listed(problems)[PROBLEM]


@pytest.fixture
def remote(tmp_path: Path, store: Store) -> int:
    """A window whose recording is in the archive alone."""
    number = rejected(store, 1)
    drained(uploads_of(store, configuration(tmp_path))[0])
    store.recordings.path(number).unlink()
    store.ledger.mark_removed(number, NOW)
    return number


def test_a_command_finds_a_recording_by_the_place_where_it_was(tmp_path: Path, store: Store, remote: int, cache: Path):
    """`identify …/recordings/replay-000001.parquet` goes on after retention has pruned it, with the history alone and no configuration."""
    path = store.recordings.path(remote)
    (found,) = named_recordings([path], None)
    assert (found.source, found.samples) == (path.name, 20)
    assert len(list(cache.iterdir())) == 1
    (tmp_path / "archive").rename(tmp_path / "away")
    assert named_recordings([path], None)[0].samples == 20  # it was fetched before
    with pytest.raises(BadInput, match="no such file"):
        named_recordings([path.with_name("replay-000099.parquet")], None)


def test_a_fetched_recording_is_compared_with_the_history_and_a_damaged_one_is_told(store: Store, remote: int, cache: Path):
    """Neither a damaged archive nor a damaged cache gives a recording that was not recorded."""
    row = store.archived.of(remote)
    cached = store.archived.path(remote)
    cached.write_bytes(b"PAR1 damaged")
    assert store.archived.path(remote).read_bytes() == Path(row.address).read_bytes()
    cached.unlink()
    os.chmod(row.address, 0o644)
    with Path(row.address).open("r+b") as file:
        file.seek(40)
        file.write(b"\0\1\2\3")
    with pytest.raises(ArchiveConflict, match="another content"):
        store.archived.path(remote)
    Path(row.address).unlink()
    with pytest.raises(ArchiveConflict, match="is not there"):
        store.archived.path(remote)


def test_the_cache_of_fetched_recordings_is_bounded(tmp_path: Path, cache: Path):
    """What was read longest ago goes first."""
    place = tmp_path / "place"
    place.mkdir()
    settings = ArchiveSettings(address=str(place))
    contents = [bytes([n]) * 1000 for n in range(4)]
    keys = [key_of("lab", "cell-1", NOW + n, n, content) for n, content in enumerate(contents)]
    archive, bounded = Archive.open(settings), RecordingCache(most_bytes=2500)
    for n, (content, key) in enumerate(zip(contents, keys, strict=True)):
        archive.put(content, key)
        path = bounded.fetched(settings, archive.address(key))
        os.utime(path, (n, n))
    assert {path.read_bytes()[0] for path in cache.iterdir()} == {2, 3}


def test_a_recording_that_cannot_be_kept_in_the_cache_leaves_nothing_there(tmp_path: Path, store: Store, remote: int, cache: Path):
    """On a disk that is full, each attempt would fill it further. Here a folder is in the way."""
    (cache / f"{store.archived.of(remote).sha256}.parquet").mkdir(parents=True)
    with pytest.raises(ArchiveRefused, match="fetched recordings cannot be written"):
        store.archived.path(remote)
    assert [path.is_dir() for path in cache.iterdir()] == [True]


def test_an_archive_lists_its_recordings_by_site_robot_and_year_and_leaves_other_files_out(tmp_path: Path):
    """Some are named with the site alone, some with the robot alone."""
    archive = Archive.open(ArchiveSettings(address=str(tmp_path)))
    for site, robot, at in (("lab", "a", 0.0), ("lab", "a", 400 * DAY), ("lab", "b", 0.0), ("hall", "a", 0.0)):
        archive.put(b"PAR1", key_of(site, robot, at, 7, b"PAR1"))
    (tmp_path / "site=lab" / "notes.parquet").write_bytes(b"PAR1")

    def found(**asked: object) -> list[tuple[str, str, int]]:
        return [(each.site, each.robot, each.year) for each in archive.recordings(**asked)]

    assert len(found()) == 4
    assert found(site="lab", robot="a") == [("lab", "a", 1970), ("lab", "a", 1971)]
    assert found(robot="a", year=1970) == [("hall", "a", 1970), ("lab", "a", 1970)]
    assert found(site="elsewhere") == []
    one = next(archive.recordings(site="hall"))
    assert (one.recorded_at_unix_s, one.replay, one.size) == (0.0, 7, 4)
    assert split_address(archive.address(one.key)) == (str(tmp_path), one.key)


def test_a_recording_without_a_time_is_archived_under_that_of_its_window(tmp_path: Path, store: Store):
    """And a file that is no Parquet, rejected for that, is kept as it is."""
    number = rejected(store, 3)
    store.recordings.path(number).write_bytes(b"no Parquet")
    drained(uploads_of(store, configuration(tmp_path))[0])
    (only,) = Archive.open(configuration(tmp_path).archive).recordings()
    assert only.recorded_at_unix_s == store.ledger.row(number).window_unix_s


def test_a_reload_may_name_another_archive_or_none(tmp_path: Path, store: Store):
    """What is archived stays where it is; what comes goes to the new place."""
    other = tmp_path / "other"
    other.mkdir()
    settings = [configuration(tmp_path)]
    uploads = Uploads(store, lambda: settings[0], Problems(lambda: NOW), lambda: NOW)
    rejected(store, 1)
    drained(uploads)
    settings[0] = configuration(tmp_path, recordings="other")
    rejected(store, 2)
    drained(uploads)
    assert [Path(row.address).is_relative_to(other) for row in store.archived.rows()] == [False, True]
    settings[0] = configuration(tmp_path, recordings="")
    rejected(store, 3)
    assert uploads.step() == IDLE_S
    assert store.archived.count() == 2
    assert MonitorDocument(store, Problems(lambda: NOW), lambda: NOW).collect(OTHERS).store.archive is None


@pytest.mark.slow
def test_the_check_says_whether_the_archive_is_there(tmp_path: Path, store: Store, remote: int):
    """With what to do where it is not."""
    settings = configuration(tmp_path)
    found = {each.name: each for each in service_conditions(settings)}["archive"]
    assert (found.holds, found.text.endswith("1 recordings are in it, 0 wait")) == (True, True)
    (tmp_path / "archive").rename(tmp_path / "away")
    found = {each.name: each for each in service_conditions(settings)}["archive"]
    assert not found.holds
    assert "create it, or mount" in found.text
    assert "archive" not in {each.name for each in service_conditions(configuration(tmp_path, recordings=""))}


@pytest.mark.parametrize(
    ("store", "expected"),
    [
        ({"recordings": "s3://AKIA:secret-word@bucket/x"}, "without user"),
        ({"recordings": "gs://bucket/secret-word"}, 'expected "s3://BUCKET/PREFIX"'),
        ({"recordings": "s3://bucket/x?key=secret-word"}, "without user, query"),
        ({"recordings": "s3://bucket", "recordings_endpoint": "http://user:secret-word@host"}, "the server's name"),
        ({"recordings": "", "keep_local_days": 3.0}, "name that in recordings"),
    ],
)
def test_a_wrong_address_is_told_without_repeating_what_may_be_a_key(tmp_path: Path, store: dict[str, object], expected: str):
    """People write keys into addresses."""
    with pytest.raises(BadConfiguration) as told:
        configuration(tmp_path, **store)
    assert expected in str(told.value)
    assert "secret-word" not in str(told.value)
    assert "store.recordings" in str(told.value) or "store.keep_local_days" in str(told.value)


def test_paths_of_the_archive_start_from_the_folder_of_the_file(tmp_path: Path):
    """Files of keys and certificates too, but for the service manager's folder."""
    keys = "${CREDENTIALS_DIRECTORY}/archive"
    settings = configuration(tmp_path, recordings="s3://bucket/a", recordings_keys_file=keys, recordings_ca_file="ca.pem").archive
    assert (settings.address, settings.keys_file, settings.ca_file) == ("s3://bucket/a", keys, str(tmp_path / "ca.pem"))
    assert configuration(tmp_path, recordings_keys_file="keys").archive == ArchiveSettings(
        address=str(tmp_path / "archive"), keys_file=str(tmp_path / "keys")
    )
    with pytest.raises(BadInput, match="absolute"):
        Archive.open(replace(settings, address="somewhere"))
    with pytest.raises(ArchiveUnavailable):
        Archive.open(ArchiveSettings(address=str(tmp_path / "nowhere"))).look()
