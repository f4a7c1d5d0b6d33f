"""A simulated arm in a process of its own, for as long as a test needs it."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from monitor.acquire.settings import Installation
from monitor.model.robot import load_robot
from monitor.simulate.arm.physics import drive_gain


def known_gains(robot: str) -> Installation:
    """An installation with the gains of the simulated arm, which no manufacturer publishes for an e-Series."""
    return Installation(gains_nm_per_a=tuple(drive_gain(load_robot(robot)).tolist()))


@contextmanager
def simulated_arm(host: str, *options: str) -> Iterator[str]:
    """The arm's address, once the arm listens there."""
    process = subprocess.Popen([sys.executable, "-m", "monitor.simulate", "--bind", host, *options], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert "listening" in line, f"the simulator printed {line!r}"
        yield host
    finally:
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
