"""Malformed queries: each gets one error reply that names the mistake, without any effect, growth or crash."""

import json
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import zenoh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from prepared import Process

from monitor.publish.session import session_config

PREFIX = "joint-monitor/v1/lab/cell-1"
COMMANDS = ("torque", "cmd/ack", "cmd/shelve", "cmd/replay")
GOOD = {
    "torque": {"q": [0.1] * 6, "qd": [0.5] * 6, "qdd": [0.0] * 6, "temperature_c": [30.0] * 6},
    "cmd/ack": {"joint": 3, "condition": "wear_rising", "by": "ada"},  # a valid request, but there is no such alert
    "cmd/shelve": {"joint": 3, "condition": "wear_rising", "by": "ada", "hours": 2.0},
    "cmd/replay": {"by": "ada"},
}
NEEDED = {"torque": ("q", "qd"), "cmd/ack": ("joint", "condition", "by"), "cmd/shelve": ("joint", "condition", "by", "hours")}
NEEDED["cmd/replay"] = ("by",)
WRONG = (None, True, "", "x" * 300, -1, 1e300, 10**30, [], {}, [[]], [1.0] * 5, [[1.0] * 6, [1.0] * 5], ["a"] * 6, [True] * 6, [1e9] * 6)


class Asked:
    """A daemon in a process of its own, and a client."""

    def __init__(self, folder: Path, port: int) -> None:
        endpoint = f"tcp/127.0.0.1:{port}"
        command = [sys.executable, str(Path(__file__).parent / "quiet_daemon.py"), str(folder), endpoint]
        self.daemon = Process(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.daemon.stdout.readline() == "up\n"
        self.session = zenoh.open(session_config(mode="client", connect=(endpoint,)))

    def ask(self, key: str, payload: bytes | None = None, parameters: str = "") -> None:
        """Send one query, and require exactly one error reply with a text."""
        replies = list(self.session.get(zenoh.Selector(f"{PREFIX}/{key}", parameters or None), payload=payload, timeout=30.0))
        assert len(replies) == 1, (key, payload, parameters)
        assert replies[0].err is not None, (key, payload, parameters)
        assert json.loads(replies[0].err.payload.to_bytes())["error"].startswith(key), (key, payload, parameters)

    def resident_mb(self) -> float:
        """Memory of the daemon."""
        (line,) = [line for line in Path(f"/proc/{self.daemon.pid}/status").read_text().splitlines() if line.startswith("VmRSS")]
        return int(line.split()[1]) / 1024.0

    def end(self) -> str:
        """End the daemon and return its last line."""
        self.session.close()
        self.daemon.stdin.write("\n")
        self.daemon.stdin.flush()
        line = self.daemon.stdout.readline()
        self.daemon.wait(timeout=30.0)
        return line


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    asked = Asked(tmp_path_factory.mktemp("malformed"), port)
    try:
        yield asked
        assert asked.end() == "down 0 0\n", "a malformed question made something happen"
    finally:
        asked.daemon.kill()
        asked.daemon.wait()
        asked.daemon.stdin.close()
        asked.daemon.stdout.close()


def malformed(rng: random.Random) -> tuple[str, bytes | None, str]:
    """Key, payload and parameters of a query that must be refused."""
    kind = rng.randrange(6)
    key = rng.choice(COMMANDS)
    if kind == 0:  # no text at all
        return key, rng.randbytes(rng.choice((0, 1, 10, 100, 3000))) + b"\xff", ""
    if kind == 1:  # broken off
        text = json.dumps(GOOD[key]).encode()
        return key, text[: rng.randrange(len(text))], ""
    if kind == 2:  # one byte flipped beyond ASCII
        text = bytearray(json.dumps(GOOD[key]).encode())
        text[rng.randrange(len(text))] = rng.randrange(128, 256)
        return key, bytes(text), ""
    if kind == 3:  # something is missing, of another kind, or too much
        document = dict(GOOD[key])
        name = rng.choice(NEEDED[key])
        wrong = rng.choice(WRONG)
        if wrong is None:
            del document[name]
        elif name in ("condition", "by"):
            document[name] = rng.choice([item for item in WRONG if not isinstance(item, str)] + ["", "x" * 300])
        else:
            document[name] = wrong
        if rng.random() < 0.2:
            document["more"] = 1
        return key, json.dumps(document).encode(), ""
    if kind == 4:  # no object
        return key, rng.choice((None, b"null", b"[]", b"1", b'"q"', b"true", b"[" * 5000, b'{"q":' * 3000, b"1e999", b"NaN")), ""
    value = rng.choice(("", "-1", "x", "9" * 400, "1e3", "٣", "0x1", "2026", "\\", "%00"))
    if rng.random() < 0.5:
        return (
            "history",
            None,
            rng.choice((f"joint={value}x", f"limit={value}x", "after=-1", f"since={value}", "from=yesterday", "limit=0")),
        )
    return "event", None, rng.choice((f"after=x{value}", f"before={value}", "x" * 2000))


JSON = st.recursive(
    st.none() | st.booleans() | st.floats(allow_nan=False, allow_infinity=False) | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=7) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)
NAMES = st.sampled_from(sorted({name for document in GOOD.values() for name in document}))
# torque needs qd, an acknowledgement needs an active alert, and a replay needs a name
OBJECTS = st.dictionaries(NAMES, JSON, max_size=4).map(lambda document: {k: v for k, v in document.items() if k != "qd"})
ANYTHING = st.binary(max_size=200).map(lambda blob: blob + b"\xff") | (JSON | OBJECTS).map(lambda value: json.dumps(value).encode())


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(key=st.sampled_from(COMMANDS[:3]), payload=ANYTHING)
def test_every_generated_malformed_query_gets_an_error(asked, key, payload):
    """Bytes and JSON of every shape, with names that the daemon knows and with others."""
    asked.ask(key, payload)


def test_a_few_hundred_malformed_queries_each_get_an_error(asked):
    """A sample of the hundred thousand queries of `make soak`."""
    rng = random.Random(8)
    for _ in range(300):
        asked.ask(*malformed(rng))


@pytest.mark.soak
@pytest.mark.timeout(2400)
def test_a_hundred_thousand_malformed_queries_each_get_an_error(asked, soak_row):
    """Four threads query: every query gets its error, and the daemon's memory does not grow."""
    began, failures = time.monotonic(), []

    def keep_asking(seed: int, count: int) -> None:
        rng = random.Random(seed)
        try:
            for _ in range(count):
                asked.ask(*malformed(rng))
        except BaseException as error:
            failures.append(error)

    def play(count: int, seed: int) -> None:
        threads = [threading.Thread(target=keep_asking, args=(seed + n, count // 4)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if failures:
            raise failures[0]

    play(20_000, 100)  # allocators and caches reach their size
    first = asked.resident_mb()
    play(80_000, 200)
    grown = asked.resident_mb() - first
    seconds = time.monotonic() - began
    soak_row("100 000 malformed queries: daemon's memory over the last 80 000", f"{grown:+.1f} of {first:.0f} MB", "flat: ≤ 5 MB")
    soak_row("… each answered with one error; queries a second", f"{100_000 / seconds:.0f}", "all")
    assert grown <= 5.0
