"""Fixtures of the simulator's tests: simulators and clients that end with the test."""

import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
from sim_process import Spawned, fresh_address, simulated


@pytest.fixture
def spawn() -> Iterator[Callable[..., Spawned]]:
    """Start simulators with these arguments; all end with the test."""
    all_of_them: list[Spawned] = []

    def start(*arguments: str) -> Spawned:
        all_of_them.append(Spawned(fresh_address(), *arguments))
        return all_of_them[-1]

    yield start
    for one in all_of_them:
        one.end()


@pytest.fixture(scope="module")
def ur5() -> Iterator[Spawned]:
    """A UR5 that the tests of one module share; each leaves it without a program."""
    with simulated("--robot", "ur5") as spawned:
        yield spawned


@pytest.fixture
def client() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start Python code that may use ur-rtde: its constructors hold the GIL and may hang, so never in the test's process."""
    running: list[subprocess.Popen[str]] = []

    def start(code: str, *arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", code, *arguments]
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return running[-1]

    yield start
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()
