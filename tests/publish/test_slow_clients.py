"""Clients that do not read or that query too much: the others are served as usual."""

import os
import signal
import subprocess
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest
import zenoh
from published import raw

from monitor.errors import BadInput
from monitor.publish.bus import QUEUE_LENGTH, Bus, QueryHandler
from monitor.publish.client import Client
from monitor.publish.documents import Document
from monitor.publish.session import BusSettings, prefix, session_config

ROOT = Path(__file__).parents[2]
PREFIX = prefix("lab", "cell-1")
GREEDY = """
import sys, time, zenoh
from monitor.publish.documents import Document
from monitor.publish.session import session_config
session = zenoh.open(session_config(mode="client", connect=(sys.argv[1],)))
subscriber = session.declare_subscriber(sys.argv[2] + "/**", lambda sample: None)
time.sleep(0.3)
for _ in range(100):
    session.get(sys.argv[2] + "/history", handler=lambda reply: None, timeout=60.0)
print("asked", flush=True)
sys.stdin.readline()
health = []
while not health:
    health = [reply.ok for reply in session.get(sys.argv[2] + "/health", timeout=2.0) if reply.ok is not None]
print("back", flush=True)
session.close()
"""


@pytest.fixture
def endpoint(free_port: int) -> str:
    return f"tcp/127.0.0.1:{free_port}"


def test_a_client_that_no_longer_reads_is_disconnected_and_may_return(endpoint):
    """40 MB of answers to a frozen process: other queries and publications continue within seconds, and it reconnects by itself.

    Zenoh's default waits 5 s each time, and 10 s were measured. The daemon's setting is 0.5 s; 4 s leave room for a busy machine.
    """
    big = {"rows": "x" * 400_000}
    answers = {
        "torque": QueryHandler("torque", lambda _: raw("torque", {})),
        "history": QueryHandler("history", lambda _: raw("history", big), payload=False),
    }
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    stop = threading.Event()
    with Bus(BusSettings(listen=(endpoint,)), PREFIX, answers) as bus:

        def speak() -> None:
            number = 0
            while not stop.wait(0.02):
                number += 1
                bus.say(raw("health", {"number": number}))

        speaker = threading.Thread(target=speak)
        speaker.start()
        greedy = subprocess.Popen(
            [sys.executable, "-c", GREEDY, endpoint, PREFIX], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        try:
            with (
                Client(endpoint, "lab", "cell-1", timeout_s=20.0) as client,
                zenoh.open(session_config(mode="client", connect=(endpoint,))) as session,
            ):
                received, waited = [], []
                session.declare_subscriber(f"{PREFIX}/health", lambda _: received.append(time.monotonic()))
                assert greedy.stdout.readline() == "asked\n"
                greedy.send_signal(signal.SIGSTOP)
                end = time.monotonic() + 6.0
                while time.monotonic() < end:
                    began = time.monotonic()
                    client.get("torque", {"q": 0})
                    waited.append(time.monotonic() - began)
                    time.sleep(0.01)
                assert max(waited) < 4.0
                assert max(later - earlier for earlier, later in pairwise(received)) < 4.0
                assert bus.dropped == 0
                greedy.send_signal(signal.SIGCONT)
                greedy.stdin.write("\n")
                greedy.stdin.flush()
                assert greedy.stdout.readline() == "back\n"
        finally:
            stop.set()
            speaker.join()
            greedy.kill()
            greedy.communicate()


def test_every_query_of_a_flood_is_answered_or_refused(endpoint):
    """More queries than may wait, with slow answers: each gets one reply, an answer or `busy`. Later queries work as before."""
    flood, gate = 2 * QUEUE_LENGTH, threading.Event()
    replies: list[str] = []
    done = threading.Semaphore(0)

    def answer(_: object) -> Document:
        gate.wait(20.0)
        return raw("torque", {})

    with Bus(BusSettings(listen=(endpoint,)), PREFIX, {"torque": QueryHandler("torque", answer)}):
        with zenoh.open(session_config(mode="client", connect=(endpoint,))) as session:

            def count(reply: zenoh.Reply) -> None:
                replies.append("answer" if reply.ok is not None else reply.err.payload.to_bytes().decode())
                done.release()

            for _ in range(flood):
                session.get(f"{PREFIX}/torque", payload=b'{"q":0}', handler=count, timeout=60.0)
            for _ in range(flood - QUEUE_LENGTH - 2):  # two are being answered
                assert done.acquire(timeout=30.0)
            assert all("busy" in reply for reply in replies)
            gate.set()
            for _ in range(QUEUE_LENGTH + 2):
                assert done.acquire(timeout=30.0)
        assert len(replies) == flood
        assert replies.count("answer") == QUEUE_LENGTH + 2
        with Client(endpoint, "lab", "cell-1") as client:
            assert client.get("torque", {"q": 0})[0].document == {}


def test_a_payload_that_is_too_large_is_refused_unread(endpoint):
    """For a payload of 4 MB and more, the error names the limit."""
    with (
        Bus(BusSettings(listen=(endpoint,)), PREFIX, {"torque": QueryHandler("torque", lambda _: raw("torque", {}))}),
        Client(endpoint, "lab", "cell-1") as client,
    ):
        with pytest.raises(BadInput, match="at most 4000000 are read"):
            client.get("torque", {"q": "x" * 4_000_001})
        assert client.get("torque", {"q": 0})[0].document == {}
