"""The disk below a history: its file system, and what it or SQLite refuses, each with a sentence of its own. I/O."""

import errno
import os
import pwd
import re
import sqlite3
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from monitor.errors import StoreError, StoreUnavailable
from monitor.reason import Reason, Sentence

DAMAGE = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})  # what SQLite says of a file that is not as it was written

WHERE = " ({file_system} at {mount}, user {user})"
DAMAGED = Sentence(
    "history_file_damaged",
    "{path}: damaged: {why}" + WHERE + "; the next start of `joint-monitor run` puts the newest good backup in its place",
)
LOCKED = Sentence("history_locked", "{path}: locked: another program keeps others out" + WHERE + "; end what it does there")
NO_SHARED_MEMORY = Sentence(
    "history_no_shared_memory",
    "{path}: the memory that programs share at it, {path}-shm, cannot be had: {why}" + WHERE + "; expected a disk of this machine",
)
NOT_PERMITTED = Sentence(
    "history_not_permitted",
    "{path}: this user may not read and write it, and its folder" + WHERE + "; call as its owner: sudo -u {owner} joint-monitor …",
)
READ_ONLY = Sentence("history_read_only", "{path}: its file system is mounted read-only" + WHERE + "; mount it for writing")
NO_SPACE = Sentence("history_no_space", "{path}: no space is left" + WHERE + "; remove something, or enlarge it")
DISK_FAILS = Sentence("history_disk_fails", "{path}: the disk fails: {why}" + WHERE + "; the kernel's messages (dmesg) say more")
NOT_OPENED = Sentence("history_not_opened", "{path}: {why}" + WHERE)
ON_NETWORK = Sentence(
    "history_on_network",
    "{path}: lies on a network file system" + WHERE + ", where SQLite cannot share memory, nor rely on locks; name a folder on a disk of "
    "this machine in [store] directory; recordings may go there as an archive, [store] recordings",
)

MOUNTS = Path("/proc/self/mountinfo")
NETWORK = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "ncpfs", "9p", "afs", "ceph", "lustre", "gfs2", "ocfs2", "glusterfs", "beegfs", "gpfs"}
    | {"pvfs2", "orangefs", "coda", "vboxsf", "prl_fs", "vmhgfs"}
)
FUSE_OF_A_DISK = frozenset({f"fuse.{name}" for name in ("fuse-overlayfs", "bindfs", "mergerfs", "gocryptfs", "encfs", "cryfs")})


class Mount(NamedTuple):
    """Where a path lies."""

    file_system: str  # ext4, nfs4, fuse.sshfs, …
    at: str

    @property
    def network(self) -> bool:
        """Whether another machine keeps it, as far as its kind tells; of FUSE, all but what is known to lie on a disk."""
        is_fuse = self.file_system == "fuse" or self.file_system.startswith("fuse.")
        return self.file_system in NETWORK or (is_fuse and self.file_system not in FUSE_OF_A_DISK)


def mount_of(path: Path) -> Mount:
    """The file system of a path, which need not exist yet. proc_pid_mountinfo(5)."""
    place, found = path.resolve(), Mount("an unknown file system", "/")
    with suppress(OSError):  # without /proc it is not known
        for line in MOUNTS.read_text("utf-8", "surrogateescape").splitlines():
            ours, _, its = line.partition(" - ")
            at = re.sub(r"\\([0-7]{3})", lambda octal: chr(int(octal[1], 8)), ours.split()[4])
            if place.is_relative_to(at) and len(at) >= len(found.at):  # of two at one place, the later one is on top
                found = Mount(its.split()[0], at)
    return found


def refuse_network(directory: Path) -> None:
    """Raises StoreError where a directory lies on a network file system: a history there would be lost some day."""
    if mount_of(directory).network:
        raise StoreError(ON_NETWORK(path=str(directory), **_where(directory)))


def refused_by(error: OSError | sqlite3.Error, path: Path) -> StoreError:
    """The error of a disk or a database as a StoreError with a sentence of its own; StoreUnavailable where a later attempt may succeed."""
    sentence, why = _of_sqlite(error, path) if isinstance(error, sqlite3.Error) else _of_disk(error)
    refuses_to_write = getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_READONLY
    passes = refuses_to_write or sentence in {LOCKED, NO_SHARED_MEMORY, READ_ONLY, NO_SPACE, DISK_FAILS}
    kind = StoreUnavailable if passes else StoreError
    return kind(sentence(path=str(path), why=why, owner=owner_of(path) or "OWNER", **_where(path)))


def damaged(path: Path, why: str) -> Reason:
    """The sentence of a file that is not as it was written."""
    return DAMAGED(path=str(path), why=why, **_where(path))


def not_writable(path: Path) -> StoreError | None:
    """Why this user could not write a history that he can read; None where he could."""
    if _is_read_only(path):
        return refused_by(OSError(errno.EROFS, ""), path)
    return None if _may_use(path) else refused_by(OSError(errno.EACCES, ""), path)


def owner_of(path: Path) -> str | None:
    """The name of its owner; None where this user may not see even that."""
    for each in (path, path.parent):
        with suppress(OSError, KeyError):
            return each.owner()
    return None


def _where(path: Path) -> dict[str, str]:
    mount, user = mount_of(path), f"uid {os.geteuid()}"
    with suppress(KeyError):
        user = pwd.getpwuid(os.geteuid()).pw_name
    return {"file_system": mount.file_system, "mount": mount.at, "user": user}


def _of_disk(error: OSError) -> tuple[Sentence, str]:
    sentence = {
        errno.EACCES: NOT_PERMITTED,
        errno.EPERM: NOT_PERMITTED,
        errno.EROFS: READ_ONLY,
        errno.ENOSPC: NO_SPACE,
        errno.EDQUOT: NO_SPACE,
        errno.EIO: DISK_FAILS,
    }.get(error.errno or 0, NOT_OPENED)
    return sentence, str(error.strerror or error)


def _of_sqlite(error: sqlite3.Error, path: Path) -> tuple[Sentence, str]:
    """https://sqlite.org/rescode.html: the lowest byte is the kind, the name tells more."""
    name = getattr(error, "sqlite_errorname", "")
    kind = getattr(error, "sqlite_errorcode", 0) & 0xFF
    why = f"{error} ({name})" if name else str(error)
    if kind in DAMAGE:
        return DAMAGED, str(error)
    if kind in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
        return LOCKED, why
    if kind == sqlite3.SQLITE_FULL or (kind == sqlite3.SQLITE_IOERR and _is_full(path)):
        return NO_SPACE, why
    if kind == sqlite3.SQLITE_PROTOCOL or "_SHM" in name:
        return NO_SHARED_MEMORY, why
    if kind == sqlite3.SQLITE_IOERR:
        return DISK_FAILS, why
    if kind in {sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_AUTH}:
        if _is_read_only(path):
            return READ_ONLY, why
        if not _may_use(path):
            return NOT_PERMITTED, why
    return NOT_OPENED, why


def _is_full(path: Path) -> bool:
    with suppress(OSError):
        return os.statvfs(path.parent).f_bavail == 0
    return False


def _is_read_only(path: Path) -> bool:
    with suppress(OSError):
        return bool(os.statvfs(path.parent).f_flag & os.ST_RDONLY)
    return False


def _may_use(path: Path) -> bool:
    """Whether this user may read and write the history and the files beside it, and make such files."""
    beside = [Path(f"{path}{suffix}") for suffix in ("", "-wal", "-shm")]
    files = all(os.access(each, os.R_OK | os.W_OK, effective_ids=True) for each in beside if os.path.lexists(each))
    return files and os.access(path.parent, os.R_OK | os.W_OK | os.X_OK, effective_ids=True)
