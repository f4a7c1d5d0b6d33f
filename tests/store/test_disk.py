"""What SQLite and the disk refuse has a sentence of its own, with path, file system and user; damage alone is called damage."""

import os
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

import pytest

from monitor.config.load import from_document, load
from monitor.config.schema import Configuration
from monitor.errors import BadConfiguration, StoreError, StoreUnavailable
from monitor.plant.database import Database
from monitor.plant.run import check_files
from monitor.plant.settings import load_plant
from monitor.service.preflight import service_conditions
from monitor.store import disk
from monitor.store.backup import HISTORY, backups
from monitor.store.disk import mount_of
from monitor.store.store import Store

CELL = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n'
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="NOT ROOT: cannot mount, nor become another user, so these disks are not tried")
HOLDS = """
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("PRAGMA locking_mode = EXCLUSIVE")
connection.execute("CREATE TABLE held (a)")
print("holds", flush=True)
sys.stdin.read()
"""


def settings(folder: Path) -> Configuration:
    """Of an arm whose history is in `folder`/history."""
    return from_document({"robot": {"model": "ur5", "site": "lab", "id": "a"}, "store": {"directory": "history"}}, folder / "cell.toml")


def history(folder: Path) -> Path:
    """A history with a backup, closed."""
    with Store.open(folder / "history") as store:
        store.back_up(1)
    return folder / "history" / HISTORY


def let_in(folder: Path) -> None:
    """Everybody may enter this folder of the test; its own parents are closed to others."""
    for each in (folder, *folder.parents):
        if each.name.startswith(("history", "test_", "pytest-", "popen-")):
            each.chmod(0o755)


@contextmanager
def another_user() -> Iterator[None]:
    before = os.geteuid()
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(before)


@contextmanager
def small_disk(kib: int = 2000) -> Iterator[Path]:
    """A file system of its own."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", name], check=False, capture_output=True).returncode:
            pytest.skip("NO MOUNT: this container mounts nothing, so a full and a read-only disk are not tried")
        try:
            yield Path(name)
        finally:
            subprocess.run(["umount", "-l", name], check=True)


def filled(folder: Path) -> None:
    with (folder / "fill").open("wb", 0) as file, suppress(OSError):
        while file.write(bytes(4096)):
            pass


@contextmanager
def locked(path: Path) -> Iterator[Path]:
    with subprocess.Popen([sys.executable, "-c", HOLDS, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"holds\n"
        yield path.parent.parent
        other.kill()


@contextmanager
def of_another_user(path: Path, mode: int) -> Iterator[Path]:
    path.chmod(mode)
    let_in(path.parent)
    with another_user():
        yield path.parent.parent


@contextmanager
def read_only(path: Path) -> Iterator[Path]:
    subprocess.run(["mount", "-o", "remount,ro", path.parent.parent], check=True)
    yield path.parent.parent


@contextmanager
def full(path: Path) -> Iterator[Path]:
    filled(path.parent.parent)
    yield path.parent.parent


@contextmanager
def in_the_way(path: Path) -> Iterator[Path]:
    """A folder has the name of the log."""
    Path(f"{path}-wal").mkdir()
    yield path.parent.parent


@contextmanager
def damaged(path: Path) -> Iterator[Path]:
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xa5" * (path.stat().st_size - 8192))
    yield path.parent.parent


@contextmanager
def no_database(path: Path) -> Iterator[Path]:
    path.write_bytes(b"a letter to the editor" * 1000)
    yield path.parent.parent


CASES = [
    pytest.param(locked, "history_locked", True, id="locked"),
    pytest.param(partial(of_another_user, mode=0o600), "history_not_permitted", False, id="not permitted", marks=needs_root),
    pytest.param(partial(of_another_user, mode=0o644), "history_not_permitted", False, id="readable alone", marks=needs_root),
    pytest.param(read_only, "history_read_only", True, id="read-only", marks=needs_root),
    pytest.param(full, "history_no_space", True, id="full", marks=needs_root),
    pytest.param(in_the_way, "history_not_opened", False, id="in the way"),
]


@pytest.mark.parametrize(("trouble", "code", "waits"), CASES)
def test_check_and_the_daemon_name_what_is_refused_and_restore_nothing(tmp_path: Path, trouble, code: str, waits: bool):
    """Where it may pass, the daemon waits for it. The file stays where it is, and no backup replaces it."""
    with ExitStack() as stack:
        folder = stack.enter_context(small_disk()) if trouble in {read_only, full} else tmp_path
        path = history(folder)
        before = path.read_bytes()
        with trouble(path) as place:
            found = next(each for each in service_conditions(settings(place)) if each.name == "history")
            with pytest.raises(StoreError) as refused, Store.open(path.parent) as store:
                store.notes.set("a", "b" * 3_000_000)
            where = mount_of(path)
        after = path.read_bytes()
    assert not found.holds
    assert found.reason.code == code
    assert isinstance(refused.value, StoreUnavailable) == waits, refused.value
    assert refused.value.reason.code in {code, "history_not_permitted"}
    for said in (found.text, str(refused.value)):
        assert "damaged" not in said
        assert str(path.parent) in said
        assert f"({where.file_system} at {where.at}, user " in said
    assert after == before
    assert list(path.parent.glob("damaged-*")) == []


@pytest.mark.parametrize("trouble", [damaged, no_database])
def test_damage_alone_is_called_damage_and_restores_the_backup(tmp_path: Path, trouble):
    """`check` says which file and that the next start restores; the next start does."""
    path = history(tmp_path)
    with trouble(path):
        found = next(each for each in service_conditions(settings(tmp_path)) if each.name == "history")
        assert found.reason.code == "history_file_damaged"
        assert f"{path}: damaged: " in found.text
        assert "puts the newest good backup in its place" in found.text
        with Store.open(path.parent) as store:
            assert store.restored is not None
            assert store.restored.backup == backups(path.parent)[0]


def test_each_kind_of_refusal_has_its_sentence():
    """By the codes of SQLite, also of those that no test here can make."""
    for name, code in (
        ("SQLITE_BUSY", "history_locked"),
        ("SQLITE_BUSY_SNAPSHOT", "history_locked"),
        ("SQLITE_LOCKED", "history_locked"),
        ("SQLITE_PROTOCOL", "history_no_shared_memory"),
        ("SQLITE_IOERR_SHMMAP", "history_no_shared_memory"),
        ("SQLITE_IOERR_SHMOPEN", "history_no_shared_memory"),
        ("SQLITE_IOERR_SHMLOCK", "history_no_shared_memory"),
        ("SQLITE_FULL", "history_no_space"),
        ("SQLITE_IOERR_READ", "history_disk_fails"),
        ("SQLITE_IOERR_FSYNC", "history_disk_fails"),
        ("SQLITE_CORRUPT", "history_file_damaged"),
        ("SQLITE_CORRUPT_INDEX", "history_file_damaged"),
        ("SQLITE_NOTADB", "history_file_damaged"),
        ("SQLITE_NOMEM", "history_not_opened"),
    ):
        error = sqlite3.OperationalError("what SQLite says")
        error.sqlite_errorname, error.sqlite_errorcode = name, getattr(sqlite3, name)
        assert disk.refused_by(error, Path("/var/lib/cell/history.sqlite")).reason.code == code, name


OF_THE_KERNEL = """22 27 0:21 / /proc rw,relatime - proc proc rw
27 1 254:0 / / rw,relatime - ext4 /dev/vda rw,discard
90 27 0:60 / {place} rw,relatime shared:3 - {kind} {source} rw,vers=4.2
91 90 0:61 / {place}/of\\040this\\040host rw,relatime - xfs /dev/sdb rw
"""


@pytest.mark.parametrize("kind", ["nfs4", "cifs", "9p", "fuse.sshfs"])
def test_a_history_on_a_network_file_system_is_refused_by_check_run_replay_and_plant(tmp_path: Path, monkeypatch, kind: str):
    """Before the daemon writes there. The mounts are as the kernel lists them; a disk mounted below is one of this machine again."""
    (tmp_path / "mounts").write_text(OF_THE_KERNEL.format(place=tmp_path, kind=kind, source="server:/export"))
    monkeypatch.setattr(disk, "MOUNTS", tmp_path / "mounts")
    config = tmp_path / "cell.toml"
    config.write_text(CELL)
    with pytest.raises(BadConfiguration, match=rf"cell.toml:6: store.directory: .*network file system \({kind} at {tmp_path}, user "):
        load(config, reads_files=True)
    found = next(each for each in service_conditions(load(config)) if each.name == "history")
    assert (found.holds, found.reason.code) == (False, "history_on_network")
    for opened in (Store.open, Store.shared):
        with pytest.raises(StoreError, match="network file system"), opened(tmp_path / "history"):
            pass
    assert not (tmp_path / "history").exists()
    (tmp_path / "plant.toml").write_text("")
    with pytest.raises(BadConfiguration, match="network file system"):
        check_files(load_plant(tmp_path / "plant.toml"))
    config.write_text(CELL.replace('"history"', '"of this host/history"'))
    load(config, reads_files=True)


@pytest.mark.parametrize("kind", ["ext4", "xfs", "btrfs", "zfs", "overlay", "tmpfs", "fuseblk", "fuse.fuse-overlayfs", "f2fs"])
def test_a_disk_of_this_machine_is_none_of_the_network(kind: str):
    """Containers and small computers have such ones."""
    assert not disk.Mount(kind, "/").network


@pytest.mark.parametrize("kind", ["nfs", "smb3", "ceph", "fuse.rclone", "fuse.glusterfs", "fuse.s3fs", "fuse.of_tomorrow", "fuse"])
def test_what_another_machine_keeps_is_of_the_network(kind: str):
    """So is every FUSE of which nobody knows that it lies on a disk."""
    assert disk.Mount(kind, "/").network


def test_a_locked_database_of_the_plant_is_said_with_its_place(tmp_path: Path):
    """The same sentences where the plant keeps its own."""
    database = Database(tmp_path / "plant.sqlite")
    database.migrate()
    database.close()
    with locked(tmp_path / "plant.sqlite"), pytest.raises(StoreUnavailable, match=r"plant.sqlite: locked: .* at /"):
        Database(f"sqlite:///{tmp_path / 'plant.sqlite'}?timeout=0.2").check()
