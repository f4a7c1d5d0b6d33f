"""Messages to the service manager and its journal: sd_notify(3), systemd.journal-fields(7). I/O.

They are plain datagrams. Where there is no service manager, nothing is sent and nothing fails.
"""

import logging
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress

JOURNAL = "/run/systemd/journal/socket"  # where journald receives records with fields
FIELDS = (
    "robot",
    "replay",
    "verdict",
    "window",
    "alert",
    "trouble",
)  # keys of a record's `extra` that become fields: JOINT_MONITOR_REPLAY=17, …


def notify(message: str) -> None:
    """Send a message to the service manager, where there is one."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel, suppress(OSError):  # the manager may be restarting
        channel.sendto(message.encode(), "\0" + address[1:] if address.startswith("@") else address)


def reloading() -> None:
    """Announce that a reload begins; READY=1 ends it."""
    notify(f"RELOADING=1\nMONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}")


class Heartbeats:
    """When each worker was last known to be alive, by the monotonic clock."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seen: dict[str, tuple[float, float]] = {}  # when it was last alive, and the time it may take [s]

    def beat(self, worker: str, within_s: float) -> None:
        """Note that a worker is alive now, and is expected to be noted again within that time."""
        with self._lock:
            self._seen[worker] = (time.monotonic(), within_s)

    def late(self) -> list[str]:
        """The workers that were not noted in time, each with the time since it was last noted."""
        now = time.monotonic()
        with self._lock:
            return [f"{worker} for {now - at:.0f} s" for worker, (at, within_s) in self._seen.items() if now - at > within_s]

    def ages_s(self) -> dict[str, float]:
        """Seconds since each worker was last known to be alive."""
        now = time.monotonic()
        with self._lock:
            return {worker: round(now - at, 1) for worker, (at, _) in self._seen.items()}


class Watchdog:
    """Reports to the service manager that this process is alive, while every worker is. systemd restarts a process that stops reporting."""

    def __init__(self, heartbeats: Heartbeats) -> None:
        self._heartbeats = heartbeats
        self._every_s = watchdog_s() / 3.0
        self._kicked = 0.0
        self._late = False

    def check(self) -> None:
        """Check the workers. The main loop calls it often, and the call itself is the main loop's heartbeat."""
        late = self._heartbeats.late()
        if late and not self._late:
            log.error("not alive: %s; the service manager is not told that all is well any more", ", ".join(late))
        elif self._late and not late:
            log.info("all workers are alive again")
        self._late = bool(late)
        if self._every_s and not late and time.monotonic() - self._kicked >= self._every_s:
            self._kicked = time.monotonic()
            notify("WATCHDOG=1")


class StatusLine:
    """What `systemctl status` shows of a running service. The first line also says that it is ready."""

    def __init__(self) -> None:
        """Nothing was said yet."""
        self._said, self._said_at = "", 0.0

    def say(self, status: str) -> bool:
        """Say how the service is, where that has changed, once a second at most. Returns whether this was the first line."""
        if status == self._said or time.monotonic() - self._said_at < 1.0:
            return False
        notify(f"READY=1\nSTATUS={status}")
        first = not self._said
        self._said, self._said_at = status, time.monotonic()
        return first


def watchdog_s() -> float:
    """The time [s] after which the service manager restarts a silent process; 0 where it does not watch."""
    if os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return 0.0
    text = os.environ.get("WATCHDOG_USEC", "")
    return int(text) / 1e6 if text.isascii() and text.isdigit() else 0.0


class JournalHandler(logging.Handler):
    """A log handler that sends records with their fields, so that `journalctl JOINT_MONITOR_REPLAY=17` finds them."""

    def __init__(self, about: Mapping[str, str], address: str = JOURNAL) -> None:
        """`about` goes with every record, e.g. {"JOINT_MONITOR_ROBOT": "cell-1"}. Raises OSError where there is no journal."""
        super().__init__()
        self._about = dict(about)
        self._channel = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._channel.connect(address)

    def emit(self, record: logging.LogRecord) -> None:
        """One datagram; what the journal does not take is lost, as on a full disk."""
        fields = {
            "MESSAGE": self.format(record),
            "PRIORITY": str(_priority(record.levelno)),
            "SYSLOG_IDENTIFIER": "joint-monitor",
            "LOGGER": record.name,
            "CODE_FILE": record.pathname,
            "CODE_LINE": str(record.lineno),
            "CODE_FUNC": record.funcName or "",
            **self._about,
        }
        for name in FIELDS:
            value = getattr(record, name, None)
            if value is not None:
                fields[f"JOINT_MONITOR_{name.upper()}"] = str(value)
        with suppress(OSError):
            self._channel.send(b"".join(_field(name, value) for name, value in fields.items()))

    def close(self) -> None:
        """Close the socket."""
        self._channel.close()
        super().close()


def _field(name: str, value: str) -> bytes:
    data = value.encode(errors="replace")
    if b"\n" in data:
        return name.encode() + b"\n" + struct.pack("<Q", len(data)) + data + b"\n"
    return name.encode() + b"=" + data + b"\n"


def _priority(level: int) -> int:
    """The syslog priority of a logging level."""
    return next(priority for least, priority in ((50, 2), (40, 3), (30, 4), (20, 6), (0, 7)) if level >= least)


def stderr_is_journal() -> bool:
    """Whether standard error is connected to the journal."""
    stream = os.environ.get("JOURNAL_STREAM", "")
    try:
        about = os.fstat(2)
    except OSError:
        return False
    return stream == f"{about.st_dev}:{about.st_ino}"


class TimedFormatter(logging.Formatter):
    """A line of the log where no journal adds the time: it begins with it, in UTC."""

    converter = staticmethod(time.gmtime)

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s %(message)s", "%Y-%m-%dT%H:%M:%SZ")


def log_to_stderr() -> None:
    """Set up the log of a process that ends soon: lines on standard error, to which the journal adds the time where it reads it."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(levelname)s %(name)s %(message)s") if stderr_is_journal() else TimedFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def log_as_a_service(site: str, robot: str, *, verbose: bool = False) -> None:
    """Set up the log: to the journal with its fields where standard error is connected to it, else to standard error.

    verbose : what a replay consists of as well, and not its beginning and end alone; of this program, not of its libraries.
    """
    handler: logging.Handler | None = None
    if stderr_is_journal():
        with suppress(OSError):
            handler = JournalHandler({"JOINT_MONITOR_SITE": site, "JOINT_MONITOR_ROBOT": robot})
    if handler is None:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(TimedFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    if verbose:
        logging.getLogger("monitor").setLevel(logging.DEBUG)


log = logging.getLogger(__name__)
