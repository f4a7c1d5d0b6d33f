"""The section [screen], and the file of users, line by line: one is put in or taken out, the others and every remark stay. I/O."""

import ipaddress
import os
from dataclasses import dataclass
from pathlib import Path

from monitor.config.files import write_whole
from monitor.errors import BadInput
from monitor.plant.screen.people import Grant, User, grant_named, line_of, read_users, role_named
from monitor.views.language.catalogue import LANGUAGES
from monitor.views.web.settings import SHORTEST_TOKEN, address_of, is_loopback


@dataclass(frozen=True, slots=True, kw_only=True)
class ScreenSettings:
    """The section [screen]. Without an address there is no screen."""

    listen: str = ""  # HOST:PORT, e.g. "127.0.0.1:8400"; empty: no screen
    language: str = "browser"  # of the screen: that which the browser asks for; or en, or de
    users_file: str = ""  # lines NAME:ROLE:DIGEST[:SITE,SITE], written by joint-monitor plant user; may begin with ${CREDENTIALS_DIRECTORY}
    proxies: tuple[str, ...] = ()  # addresses of a reverse proxy whose X-Forwarded-User and -Groups are believed (oauth2-proxy)
    proxy_secret: str = ""  # which the proxy sends with every request; any other process of its machine is not believed then
    proxy_roles: tuple[str, ...] = ()  # "group:NAME=ROLE" or "user:NAME=ROLE"; "NAME=ROLE" is both; ROLE@SITE,SITE at these alone
    proxy_role: str = ""  # of everybody else whom the proxy lets through; empty: nothing

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong; an address beyond loopback needs one of both ways to know a person."""
        if self.language not in ("browser", *LANGUAGES):
            raise BadInput(f"screen: language = {self.language!r}; expected browser, {', '.join(LANGUAGES)}")
        for each in self.proxies:
            try:
                ipaddress.ip_address(each)
            except ValueError:
                raise BadInput(f"screen: proxies: {each!r} is no address; expected e.g. 127.0.0.1") from None
        self.roles()
        if self.proxy_role:
            role_named(self.proxy_role)
        if self.proxy_secret and (len(self.proxy_secret) < SHORTEST_TOKEN or not self.proxy_secret.isascii()):
            raise BadInput(
                f"screen: proxy_secret: holds {len(self.proxy_secret)} characters; expected {SHORTEST_TOKEN} or more, all of them ASCII: "
                "openssl rand -hex 16"
            )
        if self.proxy_secret and not self.proxies:
            raise BadInput("screen: proxy_secret, but no proxies; expected the addresses whose word is believed")
        if (self.proxy_roles or self.proxy_role) and not self.proxies:
            raise BadInput("screen: proxy_roles, but no proxies; expected the addresses whose word is believed")
        if self.proxies and not (self.proxy_roles or self.proxy_role):
            raise BadInput('screen: proxies, but neither proxy_role nor proxy_roles: nobody could look; expected e.g. proxy_role = "look"')
        if not self.listen:
            return
        host, _ = self.address()
        if not is_loopback(host) and not self.knows_people:
            raise BadInput(
                f"screen: listen = {self.listen!r} is open to the network; expected users_file or proxies beside it, "
                "or a loopback 127.0.0.1:PORT"
            )

    def address(self) -> tuple[str, int]:
        """Host and port. Raises BadInput."""
        return address_of(self.listen, "screen")

    @property
    def knows_people(self) -> bool:
        """Whether a person must say who he is; else everybody of this machine may do everything."""
        return bool(self.users_file or self.proxies)

    @property
    def believes_this_machine(self) -> bool:
        """Whether any process of this machine could name itself as a person of the proxy."""
        return not self.proxy_secret and any(ipaddress.ip_address(each).is_loopback for each in self.proxies)

    def roles(self) -> dict[str, list[Grant]]:
        """Roles by group or user of the proxy; one name may have several, at several sites. Raises BadInput."""
        found: dict[str, list[Grant]] = {}
        for each in self.proxy_roles:
            name, sign, role = each.rpartition("=")
            if not sign or not name:
                raise BadInput(f'screen: proxy_roles: {each!r}; expected "GROUP=ROLE"')
            role, limited, sites = role.partition("@")
            found.setdefault(name, []).append(grant_named(role, sites.split(",") if limited else ()))
        return found

    def users_path(self, folder: Path) -> Path | None:
        """The file of users; None where there is none. A relative name begins at `folder`."""
        if not self.users_file:
            return None
        return folder / self.users_file.replace("${CREDENTIALS_DIRECTORY}", os.environ.get("CREDENTIALS_DIRECTORY", ""))


# --- The file of users, line by line: one is put in or taken out, the others and every remark stay

MODE = 0o640  # a digest is no token, but nobody else need see who may what
HEAD = "# NAME:ROLE:DIGEST of the token, and :SITE,SITE where it is limited to these; written by joint-monitor plant user\n"


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
