"""A stream of alerts while router, daemon and subscriber are restarted in random order: nothing lost, nothing doubled, order kept."""

import itertools
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from monitor.client import Client
from monitor.errors import BusError
from monitor.store import Store

ROOT = Path(__file__).parents[2]
ROUTER = (
    "import json, sys, time, zenoh\n"
    "from monitor.publish.bus import session_config\n"
    "config = session_config(mode='router', listen=(sys.argv[1],))\n"
    "with zenoh.open(config):\n"
    "    print('up', flush=True)\n"
    "    time.sleep(3600)\n"
)


class Subscriber:
    """A client in a thread of its own that comes back as often as it is cut off; what each of its lives was told."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.lives: list[list[int]] = []
        self.last: dict[int, str] = {}  # joint → text of its alert
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def _live(self) -> None:
        told: list[int] = []
        self.lives.append(told)
        while not self._stop.is_set():
            try:
                with Client(self.endpoint, "lab", "cell-1", timeout_s=2.0) as client:
                    for message in client.watch("**", until=self._stop.is_set):
                        if message.key == "event":
                            told.append(message.document["seq"])
                        elif message.key.startswith("alert/"):
                            self.last[message.document["joint"]] = message.document["text"]
            except BusError:
                time.sleep(0.1)  # no router at this moment

    def restart(self) -> None:
        self.end()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._stop.set()
        self._thread.join(timeout=20.0)
        assert not self._thread.is_alive()


class Site:
    """A router, a daemon that raises alerts without rest, and two subscribers, one of which is never restarted."""

    def __init__(self, folder: Path, port: int) -> None:
        self.endpoint, self.folder = f"tcp/127.0.0.1:{port}", folder
        self.router = self._router()
        try:
            self.daemon = self._daemon()
        except BaseException:
            _kill(self.router)
            raise
        self.faithful, self.restless = Subscriber(self.endpoint), Subscriber(self.endpoint)

    def _router(self) -> "subprocess.Popen[str]":
        return _up([sys.executable, "-c", ROUTER, self.endpoint])

    def _daemon(self) -> "subprocess.Popen[str]":
        return _up([sys.executable, str(Path(__file__).parent / "alerting_daemon.py"), str(self.folder), self.endpoint])

    def restart(self, what: str) -> None:
        if what == "subscriber":
            self.restless.restart()
        elif what == "router":
            _kill(self.router)
            self.router = self._router()
        else:
            _kill(self.daemon)
            self.daemon = self._daemon()

    def settle(self) -> tuple[int, dict[int, str]]:
        """The alerts come to rest; the last number and what each joint's alert says."""
        self.daemon.stdin.write("\n")
        self.daemon.stdin.flush()
        while not (line := self.daemon.stdout.readline()).startswith("down"):
            assert line
        self.daemon.wait(timeout=30.0)
        with Store.reader(self.folder) as store:
            numbers = [event.seq for event in store.events()]
            texts = {event.document["joint"]: event.document["text"] for event in store.events()}
        assert numbers == list(range(1, len(numbers) + 1)), "the store lost or doubled a number"
        return len(numbers), texts

    def end(self) -> None:
        for subscriber in (self.faithful, self.restless):
            subscriber.end()
        for process in (self.router, self.daemon):
            _kill(process)


def _up(command: list[str]) -> "subprocess.Popen[str]":
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}  # this checkout, whatever is installed
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    if process.stdout.readline() != "up\n":
        process.kill()
        raise AssertionError(f"{command[1]} did not come up")
    return process


def _kill(process: "subprocess.Popen[str]") -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()
    for pipe in (process.stdin, process.stdout):
        pipe.close()


def play(folder: Path, port: int, restarts: int, seed: int) -> None:
    dice = random.Random(seed)
    site = Site(folder, port)
    try:
        time.sleep(2.0)
        for _ in range(restarts):
            site.restart(dice.choice(("router", "daemon", "subscriber")))
            time.sleep(dice.uniform(0.2, 1.5))
        site.restart("daemon")  # whatever was cut off last is back for a moment
        deadline = time.monotonic() + 15.0
        while time.monotonic() < deadline and not (site.faithful.lives[-1] and site.restless.lives[-1]):
            time.sleep(0.1)
        last, texts = site.settle()
        site.daemon = site._daemon()  # says the last values and what was not said yet, then goes on
        site.daemon.stdin.write("\n")
        site.daemon.stdin.flush()
        settled = time.monotonic()
        while time.monotonic() - settled < 5.0 and (site.faithful.lives[-1][-1:] < [last] or site.restless.lives[-1][-1:] < [last]):
            time.sleep(0.05)
        waited = time.monotonic() - settled
        site.daemon.wait(timeout=30.0)
        for name, subscriber in (("faithful", site.faithful), ("restless", site.restless)):
            for told in subscriber.lives:
                gaps = [(a, b) for a, b in itertools.pairwise(told) if b != a + 1]
                assert not gaps, f"{name}: after {gaps[0][0]} came {gaps[0][1]}"
            assert subscriber.lives[-1][-1] >= last, name
            assert {
                joint: int(text.split()[1]) >= int(texts[joint].split()[1]) for joint, text in subscriber.last.items()
            } == dict.fromkeys(texts, True), name
        print(
            json.dumps(
                {"transitions": last, "restarts": restarts, "lives": len(site.restless.lives), "last state after s": round(waited, 2)}
            )
        )
    finally:
        site.end()


def _number(text: str) -> int:
    return int(text.removeprefix("transition "))


def test_restarts_lose_and_double_no_transition(tmp_path, free_port):
    """Five restarts in random order; `make soak` plays a hundred."""
    play(tmp_path, free_port, restarts=5, seed=1)


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_a_hundred_restarts_lose_and_double_no_transition(tmp_path, free_port):
    """Seeded; about seven minutes."""
    play(tmp_path, free_port, restarts=100, seed=2)
