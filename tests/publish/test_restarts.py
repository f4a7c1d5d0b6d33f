"""A stream of alerts while router, daemon and subscriber restart in random order: none is lost or repeated, and order is kept."""

import itertools
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from prepared import Process

from monitor.errors import BusError
from monitor.publish.client import Client
from monitor.store.store import Store

ROUTER = (
    "import json, sys, time, zenoh\n"
    "from monitor.publish.session import session_config\n"
    "config = session_config(mode='router', listen=(sys.argv[1],))\n"
    "with zenoh.open(config):\n"
    "    print('up', flush=True)\n"
    "    time.sleep(3600)\n"
)


class Subscriber:
    """A client in its own thread that reconnects after each interruption, and what it received in each connection."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.lives: list[list[int]] = []
        self.last: dict[int, str] = {}  # joint → text of its alert
        self.back: list[str] = []  # states that came after newer ones
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def _live(self) -> None:
        received: list[int] = []
        self.lives.append(received)
        while not self._stop.is_set():
            try:
                with Client(self.endpoint, "lab", "cell-1", timeout_s=2.0) as client:
                    for message in client.watch("**", until=self._stop.is_set):
                        if message.key == "event":
                            received.append(message.document["seq"])
                        elif message.key.startswith("alert/"):
                            self._note(message.document)
            except BusError:
                time.sleep(0.1)  # no router at this moment

    def _note(self, alert: dict) -> None:
        joint, text = alert["joint"], alert["text"]
        if _number(text) < _number(self.last.get(joint, "")):
            self.back.append(f"joint {joint}: {self.last[joint]}, then {text}")
        self.last[joint] = text

    def knows(self, last: int, numbers: dict[int, int]) -> bool:
        """Whether it received that transition or a later one, and states of the joints that are as new as these."""
        received = self.lives[-1][-1:]
        return bool(received and received[0] >= last) and all(_number(self.last.get(joint, "")) >= n for joint, n in numbers.items())

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
    """A router, a daemon with a steady stream of alerts, and two subscribers, of which one is never restarted."""

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

    def _daemon(self, *how: str) -> "subprocess.Popen[str]":
        return _up([sys.executable, str(Path(__file__).parent / "alerting_daemon.py"), str(self.folder), self.endpoint, *how])

    def restart(self, what: str) -> None:
        if what == "subscriber":
            self.restless.restart()
        elif what == "router":
            _kill(self.router)
            self.router = self._router()
        else:
            _kill(self.daemon)
            self.daemon = self._daemon()

    def caught_up_s(self, limit_s: float) -> float:
        """The time until both subscribers have the store's last transition and the last state of every joint."""
        last, numbers = self.known()
        began = time.monotonic()
        while not all(subscriber.knows(last, numbers) for subscriber in (self.faithful, self.restless)):
            if time.monotonic() - began > limit_s:
                received = {s.lives[-1][-1] if s.lives[-1] else None: s.last for s in (self.faithful, self.restless)}
                raise AssertionError(f"after {limit_s:g} s the store knows {last} {numbers}, the subscribers {received}")
            time.sleep(0.02)
        return time.monotonic() - began

    def known(self) -> tuple[int, dict[int, int]]:
        """The store's last transition, and each joint's last one."""
        with Store.reader(self.folder) as store:
            events = store.events.rows()
        assert [event.seq for event in events] == list(range(1, len(events) + 1)), "the store lost or doubled a number"
        return len(events), {event.document["joint"]: _number(event.document["text"]) for event in events}

    def settle(self) -> None:
        """Stop the stream of alerts: the daemon ends, and a later one without new alerts publishes what is left."""
        self.daemon.stdin.write("\n")
        self.daemon.stdin.flush()
        while not (line := self.daemon.stdout.readline()).startswith("down"):
            assert line
        self.daemon.wait(timeout=30.0)
        self.daemon = self._daemon("quiet")

    def end(self) -> None:
        for subscriber in (self.faithful, self.restless):
            subscriber.end()
        for process in (self.router, self.daemon):
            _kill(process)


def _up(command: list[str]) -> "subprocess.Popen[str]":
    process = Process(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    if process.stdout.readline() != "up\n":
        process.kill()
        raise AssertionError(f"{command[1]} did not come up")
    return process


def _kill(process: "subprocess.Popen[str]") -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()
    for pipe in (process.stdin, process.stdout):
        pipe.close()


def play(folder: Path, port: int, restarts: list[str], seed: int) -> dict[str, float]:
    rng = random.Random(seed)
    site, waits = Site(folder, port), []
    try:
        site.caught_up_s(20.0)
        for n, what in enumerate(restarts):
            site.restart(what)
            if n % 5 == 4:
                waits.append(site.caught_up_s(20.0))
            else:
                time.sleep(rng.uniform(0.2, 1.5))
        site.settle()
        waits.append(site.caught_up_s(20.0))
        last, numbers = site.known()
        for name, subscriber in (("faithful", site.faithful), ("restless", site.restless)):
            for received in subscriber.lives:
                gaps = [(a, b) for a, b in itertools.pairwise(received) if b != a + 1]
                assert not gaps, f"{name}: after {gaps[0][0]} came {gaps[0][1]}"
            assert not subscriber.back, f"{name}: {subscriber.back[0]}"
            assert {joint: _number(text) for joint, text in subscriber.last.items()} == numbers, name
        assert site.faithful.lives[-1][-1] == last
        return {"transitions": last, "lives": len(site.restless.lives), "worst_s": max(waits)}
    finally:
        site.end()


def _number(text: str) -> int:
    return int(text.removeprefix("transition ") or 0)


def test_restarts_lose_and_repeat_no_transition(tmp_path, free_port):
    """One restart of each; the daemon restarts right after the router. `make soak` plays a hundred in random order."""
    play(tmp_path, free_port, ["subscriber", "router", "daemon"], seed=1)


@pytest.mark.soak
@pytest.mark.timeout(1500)
def test_a_hundred_restarts_lose_and_repeat_no_transition(tmp_path, free_port, soak_row):
    """The order is seeded, and it takes about six minutes. Every fifth restart waits until both subscribers are up to date."""
    restarts = random.Random(2).choices(("router", "daemon", "subscriber"), k=100)
    found = play(tmp_path, free_port, restarts, seed=2)
    soak_row("100 restarts: transitions, each once and in order at both ends", f"{found['transitions']}", "all")
    soak_row("… until the last state is right at every subscriber", f"at most {found['worst_s']:.1f} s", "≤ 5 s")
    assert found["worst_s"] <= 5.0
