"""The section [opcua] of the plant's file."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval

from monitor.errors import BadInput

PATH = "/joint-monitor"  # of the endpoint's address


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcuaSettings:
    """Where the server listens, and who may read."""

    listen: str = ""  # HOST:PORT, e.g. "0.0.0.0:4840"; empty: no server
    host: str = ""  # by which clients reach it; empty: the address of `listen`, or this host's name where that is every address
    users_file: str = ""  # lines NAME:ROLE:DIGEST as joint-monitor plant user writes them; the token is the password, every role may read
    allow_anonymous: bool = False  # true: whoever reaches the server may read, over an encrypted channel
    allow_unsecured: bool = False  # true: also without encryption; a password then travels as it is
    trusted_clients: str = ""  # folder of client certificates (DER or PEM), or of their authorities; empty: any certificate
    cert_file: str = ""  # own certificate (DER or PEM); empty: the server makes one when it first starts, and keeps it
    key_file: str = ""  # its key (PEM)
    sites: tuple[str, ...] = ()  # only these sites are served; empty: all
    most_arms: Annotated[int, Interval(ge=1, le=1000)] = 200  # more are left out, and that is told; an arm takes 0.6 MB
    bad_after_h: Annotated[float, Interval(gt=0.0, le=8760.0)] = 24.0  # [h] silence after which values are Bad instead of Uncertain

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        if not self.listen:
            return
        self.address()
        if not (self.users_file or self.allow_anonymous):
            raise BadInput("opcua: nobody could sign in; expected users_file, or allow_anonymous = true")
        if bool(self.cert_file) != bool(self.key_file):
            raise BadInput("opcua: cert_file and key_file belong together; expected both or neither")
        if "/" in self.host or any(character.isspace() for character in self.host):
            raise BadInput(f"opcua: host = {self.host!r}; expected a name or an address alone, e.g. plant.example")

    def address(self) -> tuple[str, int]:
        """Host and port. Raises BadInput."""
        host, _, port = self.listen.rpartition(":")
        host = host.strip("[]")
        if not host or "/" in host or not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
            raise BadInput(f"opcua: listen = {self.listen!r}; expected HOST:PORT, e.g. 0.0.0.0:4840")
        return host, int(port)

    def url(self, host_name: str) -> str:
        """The endpoint's address. host_name : of this host, where the server listens at every address."""
        host, port = self.address()
        shown = self.host or (host_name if host in {"0.0.0.0", "::"} else host)  # noqa: S104 - compared, not opened
        return f"opc.tcp://{f'[{shown}]' if ':' in shown else shown}:{port}{PATH}"
