"""A real PostgreSQL of the tests' own, where Debian's package is installed."""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

import psycopg

PASSWORD = "s3cret+word"


class Postgres:
    """One server; each `address` is a new database in it."""

    def __init__(self, binaries: Path, folder: Path, **settings: str) -> None:
        self.binaries, self.folder, self.settings = binaries, folder, settings
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        # the server refuses to run as root
        self.user = {"user": "postgres", "group": "postgres", "extra_groups": []} if os.geteuid() == 0 else {}
        if self.user:
            about = pwd.getpwnam("postgres")
            os.chown(folder, about.pw_uid, about.pw_gid)
        (folder / "password").write_text(PASSWORD)
        (folder / "password").chmod(0o644)
        made = [
            "--auth=scram-sha-256",
            "--username=plant",
            f"--pwfile={folder / 'password'}",
            "--no-sync",
            "--no-instructions",
            "--locale=C",
        ]
        self._run("initdb", "-D", str(folder / "data"), "--encoding=UTF8", *made)
        self.number = 0
        self.start()

    def _run(self, name: str, *arguments: str) -> None:
        subprocess.run([self.binaries / name, *arguments], check=True, capture_output=True, cwd=self.folder, **self.user)

    def start(self) -> None:
        settings = {"port": self.port, "listen_addresses": "127.0.0.1", "unix_socket_directories": self.folder, "fsync": "off"}
        settings |= {"autovacuum": "off", "shared_buffers": "16MB", "max_connections": 40, **self.settings}
        options = [f"--{name}={value}" for name, value in settings.items()]
        command = [self.binaries / "postgres", "-D", self.folder / "data", *options]
        self.process = None
        for _ in range(400):
            if self.process is None or self.process.poll() is not None:  # the memory of one that was killed is freed a moment later
                log = (self.folder / "log").open("ab")
                self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log, cwd=self.folder, **self.user)
            try:
                psycopg.connect(self._conninfo("postgres")).close()
                return
            except psycopg.OperationalError:
                time.sleep(0.05)
        raise AssertionError((self.folder / "log").read_text()[-3000:])

    def kill(self) -> None:
        """At once, with everything that it was doing."""
        self.process.send_signal(signal.SIGSTOP)  # else it would start one more child between the list of them and its end
        for child in subprocess.run(["pgrep", "-P", str(self.process.pid)], capture_output=True, text=True, check=False).stdout.split():
            try:
                os.kill(int(child), signal.SIGKILL)
            except ProcessLookupError:
                continue
        self.process.kill()
        self.process.wait()

    def _conninfo(self, name: str) -> str:
        return f"host=127.0.0.1 port={self.port} user=plant password={PASSWORD} dbname={name} connect_timeout=2"

    def address(self, options: str = "", **defaults: str) -> str:
        """Of a new database, made with these options; defaults : of each session in it."""
        self.number += 1
        with psycopg.connect(self._conninfo("postgres"), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE plant_{self.number} {options}")
            for name, value in defaults.items():
                connection.execute(f"ALTER DATABASE plant_{self.number} SET {name} = '{value}'")
        return f"postgresql+psycopg://plant:s3cret%2Bword@127.0.0.1:{self.port}/plant_{self.number}"

    def asked(self, address: str, question: str) -> str:
        """What psql answers."""
        command = [self.binaries / "psql", address.replace("+psycopg", ""), "--no-psqlrc", "-Atc", question]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def binaries() -> Path | None:
    """Of the newest PostgreSQL that Debian's package or the search path has; POSTGRES_BINARIES names those of another version."""
    if named := os.environ.get("POSTGRES_BINARIES"):
        return Path(named)
    debian = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    found = debian[-1] if debian else shutil.which("initdb")
    return Path(found).parent if found else None
