"""Recordings that somebody has changed in the archive: whoever reads one says so, and takes none of it for what was recorded."""

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
from command_line import ended
from s3_server import s3_server
from test_reassess import BEGAN_S, DAY_S, lived, scheduler  # noqa: F401 - fixtures

from monitor.store.archive.archive import Archive, key_of
from monitor.store.archive.places import ArchiveSettings
from monitor.store.store import Store

if find_spec("distributed") is None:
    pytest.skip("dask is absent: it is of the extra `archive`", allow_module_level=True)


@dataclass
class Remote:
    """An arm of two replays whose recordings are in the archive alone."""

    home: Path
    config: Path
    addresses: list[str]
    change: Callable[[str], None]  # bytes of an object, at its full length


@pytest.fixture(params=["bucket", pytest.param("folder", marks=pytest.mark.soak)])
def remote(request: pytest.FixtureRequest, lived: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Remote]:  # noqa: F811
    """In a folder, and on a real S3 server."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)
    home = tmp_path / "press"
    shutil.copytree(lived / "site=south" / "press", home)
    (tmp_path / "archive").mkdir()
    if request.param == "folder":
        settings = ArchiveSettings(address=str(tmp_path / "archive"))

        def change(address: str) -> None:
            path = Path(address)
            path.chmod(0o644)
            path.write_bytes(_other(path.read_bytes()))

        yield _archived(home, settings, change)
        return
    with s3_server(tmp_path / "archive") as server:
        settings = ArchiveSettings(
            address=f"s3://{server.bucket}/plant", endpoint=server.endpoint, keys_file=str(server.keys_file().absolute())
        )

        def overwrite(address: str) -> None:
            client, name = server.client(), address.removeprefix("s3://")
            with client.open_input_file(name) as file:
                content = file.read()
            with client.open_output_stream(name) as file:
                file.write(_other(content))

        yield _archived(home, settings, overwrite)


def _other(content: bytes) -> bytes:
    changed = bytearray(content)
    changed[len(changed) // 2] ^= 0xFF
    return bytes(changed)


def _archived(home: Path, settings: ArchiveSettings, change: Callable[[str], None]) -> Remote:
    archive, addresses = Archive.open(settings), []
    with Store.open(home) as store:
        store.archived.note_place(settings)
        for number, path in store.recordings.numbered():
            content = path.read_bytes()
            copy = archive.put(content, key_of("lab", "press", BEGAN_S + (number - 1) * DAY_S, number, content))
            store.archived.add(number, copy, BEGAN_S)
            addresses.append(copy.address)
            path.unlink()
    config = home / "cell.toml"
    config.write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "press"\n[store]\ndirectory = "."\n')
    return Remote(home, config, addresses, change)


def test_a_question_to_a_changed_recording_is_answered_with_what_is_wrong(remote: Remote):
    """By its number and by its address; the other one is answered."""
    remote.change(remote.addresses[1])
    for which in ("2", f"'{remote.addresses[1]}'"):
        result = ended("query", "--history", remote.home, f"SELECT count(*) FROM replay({which})")
        assert (result.returncode, result.stdout) == (1, "")
        assert f"{remote.addresses[1]}: holds another content than was recorded: its SHA-256 begins with" in result.stderr
    sound = ended("query", "--history", remote.home, "--csv", "SELECT count(*) AS n FROM replay(1)")
    assert sound.returncode == 0, sound.stderr
    assert int(sound.stdout.split()[1]) > 100


def test_a_verdict_of_a_changed_recording_is_not_computed_again_but_named(remote: Remote):
    """`assess --from-store` counts it among those that cannot be recomputed, says where the recording lies, and ends with 3."""
    assert ended("assess", "--from-store", "--config", remote.config).returncode == 0
    shutil.rmtree(remote.home.parent / "cache")
    remote.change(remote.addresses[1])
    result = ended("assess", "--from-store", "--config", remote.config)
    assert result.returncode == 3
    assert "2 verdicts: 1 come out the same to the last bit, 0 differ, 1 cannot be recomputed" in result.stdout
    assert f"replay 2: {remote.addresses[1]}: holds another content than was recorded" in result.stdout
    document = json.loads(ended("assess", "--from-store", "--config", remote.config, "--json").stdout)
    assert [each["replay"] for each in document["other_recordings"]] == [2]


def test_a_reassessment_names_a_changed_recording_and_judges_the_others(remote: Remote, scheduler: str, tmp_path: Path):  # noqa: F811
    """What it was identified to before the change is another result, and is found again once the recording is."""
    remote.change(remote.addresses[1])
    common = ("reassess", remote.home, "--results", tmp_path / "results", "--scheduler", scheduler)
    result = ended(*common)
    assert result.returncode == 0, result.stderr
    assert "1 verdicts come out the same to the last bit, 0 differ, 1 cannot be recomputed" in result.stdout
    assert "1 replays have another recording than was made" in result.stdout
    assert f"error: press, replay 2: {remote.addresses[1]}: holds another content than was recorded" in result.stdout
    remote.change(remote.addresses[1])  # back
    again = json.loads(ended(*common, "--json").stdout)
    assert (again["verdicts"]["identical"], again["errors"], again["left_out"]["changed"]) == (2, [], 0)


@pytest.mark.parametrize("remote", ["folder"], indirect=True)
def test_a_recording_that_the_archive_has_lost_is_gone_and_no_other_one(remote: Remote, scheduler: str, tmp_path: Path):  # noqa: F811
    """It is named, and nobody is told that somebody changed it."""
    Path(remote.addresses[1]).unlink()
    document = json.loads(ended("reassess", remote.home, "--results", tmp_path / "results", "--scheduler", scheduler, "--json").stdout)
    assert (document["left_out"]["gone"], document["left_out"]["changed"]) == (1, 0)
    assert [each["replay"] for each in document["errors"]] == [2]
    assert f"{remote.addresses[1]}: is not there" in document["errors"][0]["reason"]
