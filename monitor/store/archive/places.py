"""Where an archive is, and who we are there: a folder or an S3 bucket. What a server answers becomes a sentence with the remedy. I/O."""

import configparser
import errno
import os
import re
import ssl
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar
from urllib.parse import urlsplit

from monitor.errors import ArchiveRefused, ArchiveUnavailable, BadInput

Found = TypeVar("Found")

FOLDER = "${CREDENTIALS_DIRECTORY}"  # the service manager's folder of secrets
CONNECT_S = 5.0  # [s] a server of the same plant answers in milliseconds
SILENT_S = 10.0  # [s] a transfer that stands still for longer is given up
ATTEMPTS = 2  # within one call; whoever calls tries again later
REGION = "us-east-1"  # servers other than Amazon's ask for one, and take any
BUCKET = re.compile(r"s3://(?P<bucket>[A-Za-z0-9][A-Za-z0-9._-]{1,61}[A-Za-z0-9])(?P<prefix>(/[^/?#\s]+)*)/?\Z")
ENDPOINT = re.compile(r"https?://[^/@?\s]+/?\Z")
_CODE = re.compile(r"AWS Error ([A-Z_]+)")
_UNPARSED = re.compile(r"Unable to parse ExceptionName: (\w+)")
_CURL = re.compile(r"curlCode: (\d+)")

# what a server says (AWS Error …, by its SDK's names) → what is wrong and what to do
KEYS = "check the file [store] recordings_keys_file, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
CLOCKS = "the clocks of this host and of the server differ by more than it allows: set this host's clock (timedatectl)"
REFUSALS = {
    "NO_SUCH_BUCKET": "the bucket does not exist: create it there, or correct [store] recordings",
    "ACCESS_DENIED": f"access is denied: allow this key to list, read and write below the prefix, or {KEYS}",
    "INVALID_ACCESS_KEY_ID": f"the access key is not known there: {KEYS}",
    "SIGNATURE_DOES_NOT_MATCH": f"the secret key is wrong: {KEYS}",
    "INVALID_SIGNATURE": f"the secret key is wrong: {KEYS}",
    "INCOMPLETE_SIGNATURE": f"the keys are not complete: {KEYS}",
    "MISSING_AUTHENTICATION_TOKEN": f"there are no keys: {KEYS}",
    "INVALID_CLIENT_TOKEN_ID": f"the access key is not known there: {KEYS}",
    "UNRECOGNIZED_CLIENT": f"the access key is not known there: {KEYS}",
    "EXPIRED_TOKEN": f"the keys have expired: {KEYS}",
    "REQUEST_TIME_TOO_SKEWED": CLOCKS,
    "REQUEST_EXPIRED": CLOCKS,
    "INVALID_OBJECT_STATE": "it lies in cold storage: restore it there first",
    "PERMANENT_REDIRECT": "the bucket is in another region: set [store] recordings_region",
}
OF_OTHERS = (
    "its certificate is not trusted: of an authority that is not known here (name its file in [store] recordings_ca_file), of another name "
    "than recordings_endpoint has, or expired"
)
NO_CONNECTION = {  # curl's number → the same, where no answer came
    6: "its name is not known: check [store] recordings_endpoint and the name server",
    7: "nobody listens there, or a firewall is between",
    28: "no answer in time: it is overloaded, or a firewall is between",
    35: "TLS fails: does the server speak https? A server without it has an endpoint that begins with http://",
    51: OF_OTHERS,
    60: OF_OTHERS,
    77: "the file [store] recordings_ca_file cannot be read",
}
PERSON_NEEDED = {35, 51, 60, 77}  # waiting does not change these


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


def authority_of(settings: ArchiveSettings) -> None:
    """Read the certificate of the server's authority. Raises ArchiveRefused where the file has none."""
    try:
        if settings.ca_file:
            ssl.create_default_context(cafile=settings.ca_file)
    except OSError as wrong:  # ssl.SSLError is one
        why = "holds no certificate as PEM" if isinstance(wrong, ssl.SSLError) else f"cannot be read: {wrong.strerror}"
        raise ArchiveRefused(f"{settings.ca_file}: {why}") from None


class Place(Protocol):
    """A folder or a bucket. Keys are relative to `address`, with slashes."""

    address: str

    def look(self) -> None:
        """See whether it is there and lets us in."""

    def listed(self, folder: str) -> Iterator[tuple[str, int]]:
        """Key and size of each file below a folder, "" or ending in a slash, in order."""

    def has(self, key: str) -> bool:
        """Whether there is something of this name."""

    def read(self, key: str) -> bytes | None:
        """Its content; None where it is not there."""

    def write(self, key: str, content: bytes) -> None:
        """Bring it, whole or not at all."""


def open_place(settings: ArchiveSettings) -> Place:
    """The place of an address. Raises BadInput for an address that is none."""
    if settings.address.startswith("s3://"):
        return Bucket(settings)
    path = settings.address.removeprefix("file://")
    if "://" in path or not os.path.isabs(path):
        raise BadInput(f"{settings.address}: expected s3://BUCKET/PREFIX, or the absolute path of a folder")
    return Folder(Path(path))


class Folder:
    """A folder, on this machine or of a file server. It must exist: below a mount that is away nothing is written."""

    def __init__(self, path: Path) -> None:
        self.address, self._path = str(path), path

    def look(self) -> None:
        """Raises ArchiveUnavailable where it is away, ArchiveRefused where it cannot be written."""
        self._there()
        if not os.access(self._path, os.W_OK | os.X_OK):
            raise ArchiveRefused(f"{self.address}: cannot be written by this user: give it to the user of the service")

    def listed(self, folder: str) -> Iterator[tuple[str, int]]:
        """Key and size of each file below `folder`."""
        self._there()
        for path in sorted((self._path / folder).rglob("*.parquet")):
            with suppress(FileNotFoundError):
                yield path.relative_to(self._path).as_posix(), path.stat().st_size

    def has(self, key: str) -> bool:
        """Whether the file exists."""
        self._there()
        try:
            return (self._path / key).exists()
        except OSError as wrong:
            raise _disk(wrong, self._path / key) from None

    def read(self, key: str) -> bytes | None:
        """The file's content."""
        self._there()
        try:
            return (self._path / key).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as wrong:
            raise _disk(wrong, self._path / key) from None

    def write(self, key: str, content: bytes) -> None:
        """Temporary file, fsync, hard link, fsync of the folder: a link never replaces a file."""
        self.look()
        path, temporary = self._path / key, None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, 0o444)  # immutable, and readable by others as far as its folder is
            with suppress(FileExistsError):  # its content is compared afterwards
                _named(temporary, path)
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        except OSError as wrong:
            raise _disk(wrong, path) from None
        finally:
            if temporary is not None:
                with suppress(OSError):
                    os.unlink(temporary)

    def _there(self) -> None:
        if not self._path.is_dir():
            raise ArchiveUnavailable(f"{self.address}: there is no such folder: create it, or mount what it lies on")


def _named(temporary: str, path: Path) -> None:
    """Give the file its name, unless that is taken."""
    try:
        os.link(temporary, path)
    except OSError as wrong:
        if wrong.errno not in {errno.EPERM, errno.ENOTSUP, errno.ENOSYS}:
            raise
        if path.exists():  # a file system without hard links, as FAT or some network ones
            raise FileExistsError(path) from None
        os.rename(temporary, path)


def _disk(wrong: OSError, path: Path) -> ArchiveUnavailable | ArchiveRefused:
    text = f"{path}: {wrong.strerror or wrong}"
    if wrong.errno in {errno.EACCES, errno.EPERM, errno.EROFS}:
        return ArchiveRefused(f"{text}: give the folder to the user of the service")
    return ArchiveUnavailable(text)


class Bucket:
    """A bucket of an S3 server, through pyarrow. An upload is visible when it is complete, or not at all."""

    def __init__(self, settings: ArchiveSettings) -> None:
        match = BUCKET.match(settings.address)
        if match is None:
            raise BadInput(
                f"{settings.address}: expected s3://BUCKET or s3://BUCKET/PREFIX, a bucket of 3 letters or more, no user, query or blanks"
            )
        self.address = settings.address.rstrip("/")
        self._root = f"{match['bucket']}{match['prefix']}"
        self._settings = settings
        self._made: Any = None

    def look(self) -> None:
        """List the prefix: a bucket that is absent, and a key without rights, answer otherwise."""
        from pyarrow.fs import FileSelector

        with suppress(FileNotFoundError):  # the bucket is there, and nothing is below the prefix yet
            self._asked(lambda fs: fs.get_file_info(FileSelector(self._root)), "")

    def listed(self, folder: str) -> Iterator[tuple[str, int]]:
        """Key and size of each object below `folder`."""
        from pyarrow.fs import FileSelector, FileType

        base = f"{self._root}/{folder}".rstrip("/")
        try:
            found = self._asked(lambda fs: fs.get_file_info(FileSelector(base, recursive=True)), folder)
        except FileNotFoundError:  # allow_not_found would take an absent bucket for an empty one
            return
        for info in sorted(found, key=lambda each: each.path):
            if info.type == FileType.File:
                yield info.path.removeprefix(f"{self._root}/"), int(info.size)

    def has(self, key: str) -> bool:
        """Whether the object exists."""
        from pyarrow.fs import FileType

        return bool(self._asked(lambda fs: fs.get_file_info(f"{self._root}/{key}"), key).type == FileType.File)

    def read(self, key: str) -> bytes | None:
        """The object's content."""

        def content(fs: Any) -> bytes:
            with fs.open_input_file(f"{self._root}/{key}") as file:
                return bytes(file.read())

        try:
            return self._asked(content, key)
        except FileNotFoundError:
            return None

    def write(self, key: str, content: bytes) -> None:
        """One PUT, or a multipart upload of a large recording."""

        def send(fs: Any) -> None:
            with fs.open_output_stream(f"{self._root}/{key}", metadata={"Content-Type": "application/vnd.apache.parquet"}) as stream:
                stream.write(content)

        try:
            self._asked(send, key)
        except FileNotFoundError:
            raise ArchiveRefused(f"{self.address}: {REFUSALS['NO_SUCH_BUCKET']}") from None

    def _asked(self, ask: Callable[[Any], Found], key: str) -> Found:
        """What the server answers. Raises FileNotFoundError where an object is not there, else as the archive does."""
        where = f"{self.address}/{key}" if key else self.address
        try:
            if self._made is None:
                self._made = _file_system(self._settings)
            return ask(self._made)
        except FileNotFoundError as wrong:
            if "NO_SUCH_BUCKET" in str(wrong):
                raise ArchiveRefused(f"{self.address}: {REFUSALS['NO_SUCH_BUCKET']}") from None
            raise
        except (OSError, ValueError) as wrong:
            if key and _CURL.search(str(wrong)) is None:
                self.look()  # a server says why it refuses where it may send a text, as it may not when it is asked for an object
            raise _answered(str(wrong), where, self._settings) from None


def _file_system(settings: ArchiveSettings) -> Any:
    """Pyarrow's file system of the server. Keys that are not set are the environment's."""
    try:
        from pyarrow.fs import AwsStandardS3RetryStrategy, S3FileSystem
    except ImportError:
        raise ArchiveRefused("this build of pyarrow has no S3: install that of PyPI, pip install --force-reinstall pyarrow") from None
    keys = keys_of(settings)
    if keys is not None or "AWS_ACCESS_KEY_ID" in os.environ:
        # with keys at hand, Amazon's library would still ask the network for the machine that it may run on, for seconds
        os.environ.setdefault("AWS_EC2_METADATA_DISABLED", "true")
    endpoint = _endpoint(settings)
    parts = urlsplit(endpoint if "://" in endpoint else f"https://{endpoint}")
    region = settings.region or os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION") or REGION
    return S3FileSystem(
        access_key=None if keys is None else keys.access,
        secret_key=None if keys is None else keys.secret,
        session_token=None if keys is None else keys.token,
        region=region,
        scheme=parts.scheme,
        endpoint_override=parts.netloc or None,
        connect_timeout=CONNECT_S,
        request_timeout=SILENT_S,
        background_writes=False,  # an error belongs to the write that met it
        allow_delayed_open=True,  # one request for a recording of a few megabytes
        retry_strategy=AwsStandardS3RetryStrategy(max_attempts=ATTEMPTS),
        tls_ca_file_path=settings.ca_file or None,
        proxy_options=_proxy(parts.scheme, parts.hostname or f"s3.{region}.amazonaws.com"),
    )


def _proxy(scheme: str, host: str) -> str | None:
    """The proxy that the environment names for a server, as other programs take it: https_proxy, http_proxy, no_proxy."""
    from urllib.request import getproxies, proxy_bypass

    is_here = host == "localhost" or host.startswith("127.")
    return None if is_here or proxy_bypass(host) else getproxies().get(scheme) or None


def _endpoint(settings: ArchiveSettings) -> str:
    """The server's address; empty: Amazon's."""
    return settings.endpoint or os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""


def _answered(text: str, where: str, settings: ArchiveSettings) -> ArchiveUnavailable | ArchiveRefused:
    """The error for what Amazon's library says. Its text is not repeated: only its code, which holds no secret."""
    code = found[1] if (found := _CODE.search(text)) else ""
    if found := _UNPARSED.search(text):  # a code of S3 that the library does not know: ExpiredToken → EXPIRED_TOKEN
        code = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", found[1]).upper()
    if code in REFUSALS:
        return ArchiveRefused(f"{where}: {REFUSALS[code]} ({code})")
    server = _endpoint(settings) or "Amazon S3"
    if found := _CURL.search(text):
        number = int(found[1])
        why = NO_CONNECTION.get(number, "no connection")
        return (ArchiveRefused if number in PERSON_NEEDED else ArchiveUnavailable)(f"{where}: {server}: {why} (curl {number})")
    return ArchiveUnavailable(f"{where}: {server} answers with {code or 'what is not understood'}; it is tried again")
