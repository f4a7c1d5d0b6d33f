"""A simulated arm in a process of its own, for as long as a test needs it."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from prepared import Process

from monitor.acquire.settings import Installation
from monitor.model.robot import load_robot
from monitor.simulate.arm.physics import drive_gain

AT_START = "--home=0.1,-1.5,0.2,-1.4,0.1,-0.1"  # where `short()` of excitations.py begins: no test waits for a way there and back
ASIDE = "--home=0,-1.57,0,-1.57,0,0"  # from here there is a way of 0.2 rad to it


def known_gains(robot: str) -> Installation:
    """An installation with the gains of the simulated arm, which no manufacturer publishes for an e-Series."""
    return Installation(gains_nm_per_a=tuple(drive_gain(load_robot(robot)).tolist()))


@contextmanager
def simulated_arm(host: str, *options: str) -> Iterator[str]:
    """The arm's address, once the arm listens there. It stands where `short()` begins unless another `--home` is given."""
    command = [sys.executable, "-m", "monitor.simulate", "--bind", host, AT_START, *options]
    process = Process(command, stdout=subprocess.PIPE, text=True)
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
