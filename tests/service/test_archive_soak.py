"""The daemon itself beside an archive: killed at any moment, and stopped while a server stands still."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pyarrow import fs
from s3_server import Passage, S3Server, s3_server
from test_archive import rejected

from monitor.store.archive.archive import Archive
from monitor.store.archive.places import ArchiveSettings
from monitor.store.store import Store

pytestmark = pytest.mark.soak

RECORDINGS, KILLS = 60, 12
ENDS_WITHIN_S = 25.0  # of SIGTERM, beside a server that stands still; systemd waits for 120


def started(folder: Path, server: S3Server, endpoint: str) -> "subprocess.Popen[bytes]":
    """The daemon, with an arm that does not answer."""
    (folder / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[bus]\nlisten = ["tcp/127.0.0.1:0"]\n'
        f'[store]\ndirectory = "history"\nrecordings = "s3://recordings/soak"\nrecordings_endpoint = "{endpoint}"\n'
        f'recordings_keys_file = "{server.keys_file()}"\n'
    )
    environment = {**os.environ, "AWS_EC2_METADATA_DISABLED": "true"}
    with (folder / "log").open("ab") as log:
        command = [sys.executable, "-m", "monitor", "run", "--config", str(folder / "cell.toml")]
        return subprocess.Popen(command, stdout=log, stderr=log, env=environment)


def archived(folder: Path) -> int:
    with Store.reader(folder / "history") as store:
        return store.archived.count()


def until(true: Callable[[], bool], process: "subprocess.Popen[bytes]") -> None:
    begin = time.monotonic()
    while not true():
        assert process.poll() is None
        assert time.monotonic() - begin < 90.0
        time.sleep(0.02)


@pytest.mark.timeout(600)
def test_a_daemon_that_is_killed_again_and_again_loses_and_doubles_nothing(tmp_path: Path, soak_row: Callable[[str, str, str], None]):
    """kill −9 while recordings go, some behind a server that stands still. In the end each is there once, as it was recorded."""
    dice = random.Random(27)
    (tmp_path / "s3").mkdir()
    with Store.open(tmp_path / "history") as store:
        numbers = [rejected(store, day) for day in range(RECORDINGS)]
    with s3_server(tmp_path / "s3") as server:
        for kill in range(KILLS):
            passage = Passage(server.port, dice.randrange(1000, 60_000), cut=kill % 2 == 0)
            process = started(tmp_path, server, passage.endpoint)  # it lets none to five recordings through
            try:
                until(lambda passage=passage: passage.stands_still.is_set() or archived(tmp_path) == RECORDINGS, process)
            finally:
                process.kill()
                process.wait()
                passage.close()
        process = started(tmp_path, server, server.endpoint)
        try:
            until(lambda: archived(tmp_path) == RECORDINGS, process)
        finally:
            process.send_signal(signal.SIGTERM)
            assert process.wait(60.0) == 0
        settings = ArchiveSettings(address="s3://recordings/soak", endpoint=server.endpoint, keys_file=str(server.keys_file()))
        archive = Archive.open(settings)
        with Store.reader(tmp_path / "history") as store:
            for number in numbers:
                row = store.archived.of(number)
                assert (
                    archive.read(row.address.removeprefix("s3://recordings/soak/"), row.sha256)
                    == store.recordings.path(number).read_bytes()
                )
        found = server.client().get_file_info(fs.FileSelector("recordings/soak", recursive=True))
        files = sum(info.type == fs.FileType.File for info in found)
    soak_row(f"{RECORDINGS} recordings to S3, the daemon killed {KILLS} times", f"{files} objects", f"{RECORDINGS}")
    assert files == RECORDINGS


def test_a_daemon_ends_soon_beside_a_server_that_stands_still(tmp_path: Path, soak_row: Callable[[str, str, str], None]):
    """Amazon's library would wait for the upload: the recording is sent again after the next start."""
    (tmp_path / "s3").mkdir()
    with Store.open(tmp_path / "history") as store:
        rejected(store, 1)
    with s3_server(tmp_path / "s3") as server:
        passage = Passage(server.port, 3000, cut=False)
        process = started(tmp_path, server, passage.endpoint)
        try:
            assert passage.stands_still.wait(90.0)
            begin = time.monotonic()
            process.send_signal(signal.SIGTERM)
            assert process.wait(90.0) == 0
            took_s = time.monotonic() - begin
        finally:
            process.kill()
            passage.close()
        assert archived(tmp_path) == 0
    soak_row("the daemon stopped while an upload stands still", f"{took_s:.1f} s", f"< {ENDS_WITHIN_S:g} s")
    assert took_s < ENDS_WITHIN_S
