"""The file of users, line by line: one is put in or taken out, the others and every remark stay. I/O."""

import os
from pathlib import Path

from monitor.config.files import write_whole
from monitor.errors import BadInput
from monitor.plant.screen.people import User, line_of, read_users

MODE = 0o640  # a digest is no token, but nobody else need see who may what
HEAD = "# NAME:ROLE:DIGEST of the token; written by joint-monitor plant user\n"


def put_user(path: Path, user: User) -> None:
    """Put a user in, or in the place of his line. Raises BadInput where the file holds anything else, or cannot be written."""
    lines, found = _lines(path), False
    for k, line in enumerate(lines):
        if _name(line) == user.name:
            lines[k], found = line_of(user), True
    if not found:
        lines.append(line_of(user))
    _write(path, lines)


def take_user_out(path: Path, name: str) -> None:
    """Take a user out. Raises BadInput where he is not there."""
    lines = _lines(path)
    left = [line for line in lines if _name(line) != name]
    if len(left) == len(lines):
        raise BadInput(f"{path}: holds no user {name!r}; nothing was done")
    _write(path, left)


def read_users_file(path: Path) -> str:
    """The text of the file. Raises BadInput where it cannot be read, or holds anything but users."""
    try:
        text = path.read_text("utf-8")
    except OSError as error:
        raise BadInput(f"users_file {path}: cannot be read: {error.strerror}; joint-monitor plant user writes it") from None
    except UnicodeDecodeError:
        raise BadInput(f"users_file {path}: is no UTF-8") from None
    read_users(text, str(path))
    return text


def _lines(path: Path) -> list[str]:
    return read_users_file(path).splitlines() if path.exists() else HEAD.splitlines()


def _name(line: str) -> str | None:
    return None if line.lstrip().startswith("#") or not line.strip() else line.strip().partition(":")[0]


def _write(path: Path, lines: list[str]) -> None:
    """Keep whose file it is: the service reads it, and root may have called this."""
    before = path.stat() if path.exists() else None
    write_whole(path, ("\n".join(lines) + "\n").encode(), mode=MODE if before is None else before.st_mode & 0o777)
    if before is not None and (before.st_uid, before.st_gid) != (os.getuid(), os.getgid()):
        os.chown(path, before.st_uid, before.st_gid)
