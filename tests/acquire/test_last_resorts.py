"""What ends the streaming process without its own help: no new socket, and the dead-man timer. Each is tried in a process of its own."""

import configparser
import signal
import socket
import struct
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from monitor.acquire.ur.last_resorts import NUMBERS, RETURN_ALLOW, RETURN_KILL_PROCESS, filter_program

pytestmark = pytest.mark.real_time

ROOT = Path(__file__).parent.parent.parent
FORBIDDEN = """
import os, socket, sys, threading, time
from monitor.acquire.ur.last_resorts import forbid_new_sockets
peer = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
begun, act = threading.Event(), threading.Event()
def later():
    begun.set()
    act.wait()
    {act}
thread = threading.Thread(target=later)
thread.start()
begun.wait()
why = forbid_new_sockets()
assert why is None, why
peer.sendall(b"ping")
assert peer.recv(4) == b"pong"
r, w = os.pipe()
os.write(w, b"x")
open("/dev/null").close()
print("goes on", flush=True)
act.set()
thread.join()
print("alive", flush=True)
"""


@pytest.fixture
def echo():
    """The port of a server that answers one `ping`."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            peer, _ = server.accept()
            with peer:
                assert peer.recv(4) == b"ping"
                peer.sendall(b"pong")
                peer.recv(1)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield server.getsockname()[1]
        thread.join(5.0)


@pytest.mark.parametrize(
    ("act", "ends"),
    [
        ("pass", 0),
        ("socket.socket()", -signal.SIGSYS),
        ("peer.connect(('127.0.0.1', 1))", -signal.SIGSYS),
        ("socket.getaddrinfo('localhost', 1)", None),
    ],
)
def test_a_process_that_may_open_no_socket_keeps_its_own_and_ends_at_the_first_new_one(echo, act, ends):
    """Also where a thread opens it that was running before: there ur-rtde reconnects. What is open goes on: sockets, pipes, files."""
    done = subprocess.run(
        [sys.executable, "-c", FORBIDDEN.format(act=act), str(echo)], capture_output=True, text=True, timeout=30, check=False
    )
    assert done.stdout.startswith("goes on"), done.stderr
    if ends is not None:
        assert done.returncode == ends
    assert ("alive" in done.stdout) == (done.returncode == 0)


def decided(program: bytes, architecture: int, number: int) -> int:
    """What the filter answers to one system call: the classic packet filter, interpreted."""
    code = [struct.unpack("=HBBI", program[at : at + 8]) for at in range(0, len(program), 8)]
    word, at = 0, 0
    while True:
        instruction, holds, fails, value = code[at]
        at += 1
        match instruction:
            case 0x20:
                word = {0: number, 4: architecture}[value]
            case 0x15:
                at += holds if word == value else fails
            case 0x35:
                at += holds if word >= value else fails
            case 0x06:
                return value


@pytest.mark.parametrize("machine", sorted(NUMBERS))
def test_on_each_architecture_the_filter_ends_two_calls_and_foreign_tables(machine):
    """The filter of the machine that the test does not run on is checked here too."""
    numbers = NUMBERS[machine]
    program = filter_program(numbers)
    ends = [number for number in range(600) if decided(program, numbers.architecture, number) == RETURN_KILL_PROCESS]
    assert ends == sorted((numbers.socket, numbers.connect))
    assert decided(program, numbers.architecture, 0) == RETURN_ALLOW
    assert decided(program, numbers.architecture, 0x4000_0000 + numbers.socket) == RETURN_KILL_PROCESS
    assert decided(program, 0x4000_0003, 3) == RETURN_KILL_PROCESS  # a 32-bit call


def test_the_service_under_systemd_may_set_the_filter():
    """`seccomp` is not part of @system-service: without its own line the arm would never move there."""
    unit = configparser.RawConfigParser(strict=False, allow_no_value=True, dict_type=MultiDict)
    unit.optionxform = str
    unit.read(ROOT / "deploy" / "joint-monitor@.service")
    allowed = [word for line in unit["Service"]["SystemCallFilter"].splitlines() if not line.startswith("~") for word in line.split()]
    assert "seccomp" in allowed
    assert "@system-service" in allowed  # prctl and setitimer


class MultiDict(dict):
    """Keeps every value of a key that stands several times."""

    def __setitem__(self, key, value):
        if key in self and isinstance(value, list):
            self[key].extend(value)
        else:
            super().__setitem__(key, value)


BLOCKED = """
import ctypes, signal, time
from monitor.acquire.ur import last_resorts as dead_man
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
signal.signal(signal.SIGALRM, signal.SIG_IGN)
dead_man.end_this_process_on_alarm()
for _ in range(20):
    dead_man.report_within(0.05)
    time.sleep(0.008)
print("in time", flush=True)
{then}
print("alive", flush=True)
"""


@pytest.mark.parametrize(
    ("then", "ends"),
    [
        ("ctypes.PyDLL(None).usleep(500_000)", -signal.SIGALRM),  # blocks with the interpreter in its hands
        ("time.sleep(0.5)", -signal.SIGALRM),
        ("dead_man.report_within(0.0); time.sleep(0.1)", 0),
    ],
)
def test_a_process_that_does_not_report_in_time_ends(then, ends):
    """Also while it holds the interpreter, and where its parent ignores SIGALRM."""
    done = subprocess.run([sys.executable, "-c", BLOCKED.replace("{then}", then)], capture_output=True, text=True, timeout=30, check=False)
    assert done.stdout.startswith("in time"), done.stderr
    assert done.returncode == ends
    assert ("alive" in done.stdout) == (ends == 0)
