"""Settings of the page: its address, and who may see it."""

import ipaddress
import os
from dataclasses import dataclass
from pathlib import Path

from monitor.errors import BadInput
from monitor.views.language.catalogue import LANGUAGES

SHORTEST_TOKEN = 16  # characters: as many as 64 random bits have in hexadecimal


@dataclass(frozen=True, slots=True, kw_only=True)
class PageSettings:
    """The section [page]. Without an address there is no page."""

    listen: str = ""  # HOST:PORT, e.g. "127.0.0.1:8420"; empty: no page
    language: str = "browser"  # of the page: that which the browser asks for; or en, or de
    token_file: str = ""  # holds the token that a browser must enter; needed beyond loopback; may begin with ${CREDENTIALS_DIRECTORY}

    def __post_init__(self) -> None:
        """Raises BadInput where `listen` is no address, or an address beyond loopback without a token."""
        if self.language not in ("browser", *LANGUAGES):
            raise BadInput(f"page: language = {self.language!r}; expected browser, {', '.join(LANGUAGES)}")
        if not self.listen:
            return
        self.address()
        if not self.loopback and not self.token_file:
            raise BadInput(
                f"page: listen = {self.listen!r} is open to the network; expected token_file beside it, or a loopback 127.0.0.1:PORT"
            )

    def address(self) -> tuple[str, int]:
        """Host and port. Raises BadInput."""
        return address_of(self.listen, "page")

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the page."""
        return is_loopback(self.address()[0])

    def token(self, directory: Path) -> str | None:
        """The token; None where none is asked for. A relative `token_file` begins at `directory`.

        Raises BadInput where the file cannot be read, or where the token is short enough to be guessed.
        """
        if not self.token_file:
            return None
        path = directory / self.token_file.replace("${CREDENTIALS_DIRECTORY}", os.environ.get("CREDENTIALS_DIRECTORY", ""))
        try:
            token = path.read_text("utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput(f"page: token_file {path}: cannot be read: {error}") from None
        if len(token) < SHORTEST_TOKEN:
            raise BadInput(
                f"page: token_file {path}: holds {len(token)} characters; expected {SHORTEST_TOKEN} or more: openssl rand -hex 16"
            )
        return token


def address_of(listen: str, what: str) -> tuple[str, int]:
    """Host and port of HOST:PORT. `what` names the section in a message. Raises BadInput."""
    host, _, port = listen.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and 0 <= int(port) <= 65535):
        raise BadInput(f"{what}: listen = {listen!r}; expected HOST:PORT, e.g. 127.0.0.1:8420")
    return host.strip("[]"), int(port)


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach the address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
