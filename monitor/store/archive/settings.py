"""Where an archive of recordings is, and who we are there: a value, and the file of the keys. I/O."""

import configparser
import os
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

from monitor.errors import ArchiveRefused

FOLDER = "${CREDENTIALS_DIRECTORY}"  # the service manager's folder of secrets


@dataclass(frozen=True, slots=True, kw_only=True)
class ArchiveSettings:
    """Where the archive is. It holds no key: keys are read where they are used."""

    address: str  # s3://BUCKET/PREFIX, or the absolute path of a folder
    endpoint: str = ""  # of another server than Amazon's, e.g. https://minio.example:9000; empty: $AWS_ENDPOINT_URL, else Amazon's
    region: str = ""  # empty: $AWS_REGION, else us-east-1
    keys_file: str = ""  # as ~/.aws/credentials; may begin with ${CREDENTIALS_DIRECTORY}; empty: the environment's, or ~/.aws
    ca_file: str = ""  # PEM of the authority that signed the server's certificate; empty: those of the system

    def as_document(self) -> dict[str, str]:
        """As a history keeps it."""
        return asdict(self)

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> "ArchiveSettings":
        """As a history has kept it; what a later version has added is left out."""
        known = {each.name for each in fields(cls)}
        return cls(**{name: str(value) for name, value in document.items() if name in known})


class Keys(NamedTuple):
    """The keys to a server. Nothing prints them."""

    access: str
    secret: str
    token: str | None

    def __repr__(self) -> str:
        return "Keys(…)"


def keys_of(settings: ArchiveSettings) -> Keys | None:
    """The keys of the file; None where the environment or ~/.aws has them.

    A command that a person calls has no folder of secrets, and takes the person's own keys. Raises ArchiveRefused where the file has none.
    """
    path = settings.keys_file
    if path.startswith(FOLDER):
        if not (folder := os.environ.get("CREDENTIALS_DIRECTORY")):
            return None
        path = path.replace(FOLDER, folder)
    if not path:
        return None
    parser = configparser.ConfigParser(interpolation=None)
    try:
        with open(path, encoding="utf-8") as file:
            parser.read_string(file.read())
        section = parser["default" if parser.has_section("default") else next(iter(parser.sections()))]
        return Keys(section["aws_access_key_id"], section["aws_secret_access_key"], section.get("aws_session_token"))
    except OSError as wrong:
        if "AWS_ACCESS_KEY_ID" in os.environ:
            return None
        raise ArchiveRefused(f"{path}: the keys of the archive cannot be read: {wrong.strerror}") from None
    except (configparser.Error, UnicodeDecodeError, KeyError, StopIteration):  # whose text may repeat a key
        raise ArchiveRefused(
            f"{path}: holds no keys; expected three lines: [default], aws_access_key_id = …, aws_secret_access_key = …"
        ) from None
