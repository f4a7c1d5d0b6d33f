"""A simulator in a process of its own and on an address of its own, and what the tests of the wire share."""

import itertools
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from prepared import Process

from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting
from monitor.simulate.remote import Remote

START_S = 30.0  # imports on a busy machine


class Spawned:
    """One simulator process."""

    def __init__(self, address: str, *arguments: str) -> None:
        self.address = address
        command = [sys.executable, "-m", "monitor.simulate", "--bind", address, *arguments]
        self.process = Process(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        ready, _, _ = select.select([self.process.stdout], [], [], START_S)
        line = self.process.stdout.readline() if ready else ""
        if not line.startswith("listening"):
            self.process.kill()
            raise RuntimeError(f"no simulator on {address}: {self.process.communicate()[1]}")

    def remote(self) -> Remote:
        return Remote(self.address)

    def end(self) -> int:
        self.process.terminate()
        try:
            self.process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
        return self.process.returncode


_numbers = itertools.count()


def fresh_address() -> str:
    """A loopback address that no other test of this run uses. Each worker of pytest-xdist has a range of its own."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
    return f"127.0.1.{10 + 40 * (worker % 6) + next(_numbers) % 40}"


@contextmanager
def simulated(*arguments: str) -> Iterator[Spawned]:
    spawned = Spawned(fresh_address(), *arguments)
    try:
        yield spawned
    finally:
        spawned.end()


def result_of(process: subprocess.Popen[str], timeout_s: float = 40.0) -> dict:
    """The JSON object on the client's last line of output (ur-rtde prints to the same stream)."""
    out, err = process.communicate(timeout=timeout_s)
    assert process.returncode == 0, err
    return json.loads(out.strip().splitlines()[-1])


def wait_for(process: subprocess.Popen[str], word: str) -> None:
    """Read the client's output until a line contains the word. ur-rtde prints to the same stream."""
    while line := process.stdout.readline():
        if word in line:
            return
    raise AssertionError(process.stderr.read())


def eventually(condition: Callable[[], bool], within_s: float) -> bool:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.01)
    return condition()


def excitation(robot: str = "ur5", *, period_s: float = 4.0, repetitions: int = 1, seed: int = 1) -> Excitation:
    """A smooth random trajectory that starts and ends at rest: Σa = 0 (no speed), Σk·b = 0 (no acceleration)."""
    rng = np.random.default_rng(seed)
    k = np.arange(1, 6)[:, None]
    a, b = rng.normal(scale=0.3, size=(2, 5, 6))
    return Excitation(
        robot=robot,
        mounting=Mounting(),
        period_s=period_s,
        repetitions=repetitions,
        offset_rad=np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0]),
        a_rad_s=a - a.mean(axis=0),
        b_rad_s=b - k * (k * b).sum(axis=0) / (k * k).sum(),
    )
