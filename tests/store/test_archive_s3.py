"""The archive on a real S3 server, with the faults that servers and networks have. Another client reads what was written."""

import os
import signal
import subprocess
import sys
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pyarrow.dataset as ds
import pytest
import trustme
from pyarrow import fs
from s3_server import KEYS, Passage, S3Server, refusing_server, s3_server
from test_archive import NOW, configuration, drained, listed, rejected, uploads_of

from monitor.errors import ArchiveRefused, ArchiveUnavailable
from monitor.service.preflight import service_conditions
from monitor.service.uploads import IDLE_S, PROBLEM
from monitor.store.archive import places as archive_places
from monitor.store.archive.archive import Archive, key_of
from monitor.store.archive.places import ArchiveSettings
from monitor.store.from_files.archived_files import local_file
from monitor.store.identify_files import named_recordings
from monitor.store.store import Store

pytestmark = pytest.mark.slow  # a server in a process of its own

CONTENT = b"PAR1" + bytes(range(256)) * 8192  # 2 MB: more than any buffer between here and there


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with s3_server(tmp_path_factory.mktemp("s3")) as server:
        yield server


@pytest.fixture(autouse=True)
def own_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No keys but those of the test, and nothing outside of this machine is asked for any."""
    for name in [each for each in os.environ if each.startswith("AWS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "none"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)


@pytest.fixture
def settings(server: S3Server, request: pytest.FixtureRequest) -> ArchiveSettings:
    """A prefix of its own for each test."""
    prefix = f"s3://recordings/{zlib.crc32(request.node.name.encode()):x}"
    return ArchiveSettings(address=prefix, endpoint=server.endpoint, keys_file=str(server.keys_file()))


@pytest.mark.slow
def test_recordings_go_to_the_bucket_and_another_client_reads_them_by_their_partitions(
    tmp_path: Path, server: S3Server, settings: ArchiveSettings
):
    """A witness: pyarrow's dataset with a client of its own. Then a recording that is only there is found by path and by address."""
    given = configuration(
        tmp_path, recordings=settings.address, recordings_endpoint=server.endpoint, recordings_keys_file=settings.keys_file
    )
    with Store.open(tmp_path) as store:
        numbers = [rejected(store, day) for day in (1, 2, 300)]
        uploads, problems = uploads_of(store, given)
        assert drained(uploads) == IDLE_S
        assert problems.listed() == []
        rows = store.archived.rows()
        assert [row.ledger_id for row in rows] == numbers
        prefix = settings.address.removeprefix("s3://")
        whole = ds.dataset(prefix, filesystem=server.client(), partitioning="hive").to_table().to_pandas()
        assert (len(whole), set(whole["site"]), set(whole["robot"])) == (60, {"lab"}, {"cell-1"})
        path = store.recordings.path(numbers[0])
        content = path.read_bytes()
        path.unlink()
        assert store.archived.path(numbers[0]).read_bytes() == content
    (found,) = named_recordings([path], None)  # the history knows the server, and the file of the keys
    assert found.source == path.name
    condition = {each.name: each for each in service_conditions(given)}["archive"]
    assert (condition.holds, condition.text.endswith("3 recordings are in it, 0 wait")) == (True, True)


def test_an_address_is_read_with_the_keys_of_the_environment(server: S3Server, settings: ArchiveSettings, monkeypatch: pytest.MonkeyPatch):
    """As every other program finds them: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_ENDPOINT_URL."""
    archive = Archive.open(settings)
    key = key_of("lab", "cell-1", NOW, 1, CONTENT)
    archive.put(CONTENT, key)
    monkeypatch.setenv("AWS_ENDPOINT_URL", server.endpoint)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", KEYS[0])
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", KEYS[1])
    assert local_file(Path(archive.address(key))).read_bytes() == CONTENT


@pytest.mark.parametrize(
    ("keys", "address", "expected"),
    [
        ((KEYS[0], "a-wrong-secret"), None, "the secret key is wrong"),
        (("nobody", "a-wrong-secret"), None, "the access key is not known there"),
        (("reader", "another-secret-of-the-tests"), None, "access is denied"),
        (KEYS, "s3://no-such-bucket/x", "the bucket does not exist"),
    ],
)
@pytest.mark.slow
def test_a_server_that_refuses_is_told_at_once_with_what_to_do_and_without_a_key(
    tmp_path: Path, server: S3Server, settings: ArchiveSettings, keys: tuple[str, str], address: str | None, expected: str
):
    """In `check` and in the problems. Nothing is lost: with the right key the recording goes."""
    place = tmp_path / "keys"
    place.write_text(f"[default]\naws_access_key_id = {keys[0]}\naws_secret_access_key = {keys[1]}\n")
    given = configuration(
        tmp_path, recordings=address or settings.address, recordings_endpoint=server.endpoint, recordings_keys_file=str(place)
    )
    with Store.open(tmp_path) as store:
        rejected(store, 1)
        uploads, problems = uploads_of(store, given)
        assert uploads.step() > 0.0
        text = listed(problems)[PROBLEM]
        assert expected in text
        assert "1 recordings wait here" in text
        condition = {each.name: each for each in service_conditions(given)}["archive"]
        assert not condition.holds
        assert expected in condition.text
        assert keys[1] not in f"{text}{condition.text}{given}{given.archive}"
        if address is None:
            place.write_text(server.keys_file().read_text())
            assert drained(uploads) == IDLE_S
            assert (store.archived.count(), problems.listed()) == (1, [])


@pytest.mark.parametrize(
    ("status", "code", "kind", "expected"),
    [
        (403, "RequestTimeTooSkewed", ArchiveRefused, "set this host's clock"),
        (400, "ExpiredToken", ArchiveRefused, "the keys have expired"),
        (503, "SlowDown", ArchiveUnavailable, "it is tried again"),
        (500, "InternalError", ArchiveUnavailable, "it is tried again"),
    ],
)
def test_other_answers_of_servers_have_their_remedy(
    settings: ArchiveSettings, monkeypatch: pytest.MonkeyPatch, status: int, code: str, kind: type[Exception], expected: str
):
    """A clock that is wrong, keys for a day, a server that has too much to do."""
    monkeypatch.setattr(archive_places, "ATTEMPTS", 1)
    with refusing_server(status, code) as endpoint, pytest.raises(kind, match=expected):
        Archive.open(replace(settings, endpoint=endpoint)).put(CONTENT, key_of("lab", "cell-1", NOW, 1, CONTENT))


def test_a_proxy_that_the_environment_names_is_used(settings: ArchiveSettings, monkeypatch: pytest.MonkeyPatch):
    """Many plants reach a server outside in no other way; no_proxy names those inside."""
    monkeypatch.setattr(archive_places, "ATTEMPTS", 1)
    outside = Archive.open(replace(settings, endpoint="http://s3.outside.invalid"))
    with refusing_server(503, "SlowDown") as proxy:
        monkeypatch.setenv("http_proxy", proxy)
        monkeypatch.delenv("no_proxy", raising=False)
        monkeypatch.delenv("NO_PROXY", raising=False)
        with pytest.raises(ArchiveUnavailable, match="SLOW_DOWN"):
            outside.look()
        Archive.open(settings).look()  # a server on this machine needs none
        monkeypatch.setenv("no_proxy", "outside.invalid")
        with pytest.raises(ArchiveUnavailable, match=r"\(curl \d+\)"):  # it asked for the name itself
            Archive.open(outside.settings).look()


def test_what_tls_needs_is_told_and_an_authority_of_ones_own_can_be_named(
    tmp_path: Path, settings: ArchiveSettings, monkeypatch: pytest.MonkeyPatch
):
    """https:// to a server that speaks http, one that nobody here certifies, one of another name; and the file that helps."""
    monkeypatch.setattr(archive_places, "ATTEMPTS", 1)
    authority = trustme.CA()
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    ours = str(tmp_path / "ca.pem")

    def told(kind: type[Exception], **changes: str) -> str:
        with pytest.raises(kind) as error:
            Archive.open(replace(settings, **changes)).look()
        return str(error.value)

    assert "begins with http://" in told(ArchiveRefused, endpoint=settings.endpoint.replace("http:", "https:"))
    with refusing_server(503, "SlowDown", authority.issue_cert("127.0.0.1")) as endpoint:
        assert "recordings_ca_file" in told(ArchiveRefused, endpoint=endpoint)
        assert "SLOW_DOWN" in told(ArchiveUnavailable, endpoint=endpoint, ca_file=ours)
    with refusing_server(503, "SlowDown", authority.issue_cert("minio.example")) as endpoint:
        assert "another name than" in told(ArchiveRefused, endpoint=endpoint, ca_file=ours)


@pytest.mark.parametrize("cut", [True, False], ids=["cut", "stands still"])
def test_a_connection_that_is_cut_or_stands_still_in_the_midst_of_an_upload_leaves_nothing(
    server: S3Server, settings: ArchiveSettings, monkeypatch: pytest.MonkeyPatch, cut: bool
):
    """It may be tried again; half a recording never appears."""
    passage = Passage(server.port, 300_000, cut=cut)
    key = key_of("lab", "cell-1", NOW, 1, CONTENT)
    with monkeypatch.context() as hasty:  # the server itself has the usual time, on a machine with other work
        hasty.setattr(archive_places, "ATTEMPTS", 1)
        hasty.setattr(archive_places, "SILENT_S", 1.0)
        try:
            with pytest.raises(ArchiveUnavailable):
                Archive.open(replace(settings, endpoint=passage.endpoint)).put(CONTENT, key)
        finally:
            passage.close()
    archive = Archive.open(settings)
    assert list(archive.recordings()) == []
    assert not archive.put(CONTENT, key).was_there
    assert archive.put(CONTENT, key).was_there


def test_a_process_killed_in_the_midst_of_an_upload_leaves_nothing_and_the_next_one_brings_it_once(
    tmp_path: Path, server: S3Server, settings: ArchiveSettings
):
    """kill −9, with a part of the recording on the wire."""
    passage = Passage(server.port, 300_000, cut=False)
    (tmp_path / "content").write_bytes(CONTENT)
    key = key_of("lab", "cell-1", NOW, 1, CONTENT)
    program = (
        "import sys; from pathlib import Path; from monitor.store.archive.archive import Archive; "
        "from monitor.store.archive.places import ArchiveSettings; "
        f"Archive.open(ArchiveSettings(**{replace(settings, endpoint=passage.endpoint).as_document()!r}))"
        f".put(Path({str(tmp_path / 'content')!r}).read_bytes(), {key!r})"
    )
    process = subprocess.Popen([sys.executable, "-c", program])
    try:
        assert passage.stands_still.wait(90.0)
        process.send_signal(signal.SIGKILL)
        assert process.wait(60.0) == -signal.SIGKILL
    finally:
        process.kill()
        passage.close()
    archive = Archive.open(settings)
    assert list(archive.recordings()) == []
    assert archive.read(archive.put(CONTENT, key).address.removeprefix(f"{settings.address}/")) == CONTENT
    assert [each.key for each in archive.recordings()] == [key]


def test_a_large_recording_goes_in_parts(settings: ArchiveSettings):
    """An hour of work at 500 Hz is more than one request carries."""
    content = CONTENT * 12
    archive = Archive.open(settings)
    key = key_of("lab", "cell-1", NOW, 2, content)
    assert archive.put(content, key).size == len(content)
    assert [(each.key, each.size) for each in archive.recordings("lab", "cell-1")] == [(key, len(content))]


@pytest.mark.slow
def test_a_server_that_is_away_for_a_while_gets_everything_when_it_is_back(tmp_path: Path, server: S3Server, settings: ArchiveSettings):
    """The recordings that were made meanwhile, too; the bucket holds each once. Last in this module: the server is stopped."""
    given = configuration(
        tmp_path, recordings=settings.address, recordings_endpoint=server.endpoint, recordings_keys_file=settings.keys_file
    )
    with Store.open(tmp_path) as store:
        rejected(store, 1)
        uploads, problems = uploads_of(store, given)
        assert drained(uploads) == IDLE_S
        server.stop()
        rejected(store, 2)
        for _ in range(3):
            assert uploads.step() > 0.0
        assert "nobody listens there" in listed(problems)[PROBLEM]
        rejected(store, 3)
        server.start()
        assert drained(uploads) == IDLE_S
        assert problems.listed() == []
        keys = [each.key for each in Archive.open(settings).recordings()]
        assert [row.address.removeprefix(f"{settings.address}/") for row in store.archived.rows()] == keys
        found = server.client().get_file_info(fs.FileSelector(settings.address.removeprefix("s3://"), recursive=True))
        assert sum(info.type == fs.FileType.File for info in found) == 3
