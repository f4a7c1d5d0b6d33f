"""A simulated arm in real time whose streaming process is on its own: it ends a motion at a collision, or because nobody watches."""

import os
import signal
import time

import pytest
from processes import alive, children, replaying
from simulated_arm import simulated_arm

from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time

HOST = "127.0.2.93"
WITHIN_S = 0.25  # of the arm's own clock, from the first contact until the stop is in force


def ended(remote: Remote) -> dict:
    """What the arm is once it stands and no program runs: by then every stop is among its stops."""
    deadline = time.monotonic() + 10.0
    while not ((truth := remote.truth())["standing"] and truth["program"] is None):
        assert time.monotonic() < deadline, "it moves on"
        time.sleep(0.05)
    return truth


def collision(host: str, *, parent_stopped: bool, at_s: float) -> tuple[float | None, str]:
    """Time from a push of 90 N·m on joint 2 to the stop [s], None where there was none; and the cause that the parent reports."""
    parent = replaying(host)
    try:
        assert parent.stdout is not None
        for line in parent.stdout:
            phase, elapsed = line.split()
            if phase == "aborted":
                return None, elapsed
            if phase == "play" and float(elapsed) >= at_s:
                break
        family = children(parent.pid)
        if parent_stopped:
            os.kill(parent.pid, signal.SIGSTOP)
        with Remote(host) as remote:
            pushed_s = remote.truth()["clock_s"]
            remote.fault("obstacle", joint=2, torque=90.0, seconds=3.0)
            truth = ended(remote)  # with the parent stopped nobody but the streaming process can end the motion
        os.kill(parent.pid, signal.SIGCONT)
        printed = parent.communicate(timeout=10.0)[0].split()
        assert not any(alive(pid) for pid in family)
    finally:
        parent.kill()
        parent.wait()
        with Remote(host) as remote:
            remote.fault("clear")
    stops = [stop["at_s"] - pushed_s for stop in truth["stops"] if stop["at_s"] >= pushed_s - 0.008]
    return (stops[0] if stops else None), printed[-1]


@pytest.mark.parametrize("parent_stopped", [False, True])
def test_a_collision_in_an_ordinary_replay_ends_it_within_a_quarter_of_a_second(parent_stopped):
    """90 N·m on joint 2 of a UR5, of which nothing was learnt; the parent runs, or hangs (SIGSTOP). It lasted 8.6 s and 6.1 s before."""
    with simulated_arm(HOST) as host:
        stop_s, cause = collision(host, parent_stopped=parent_stopped, at_s=1.0)
    assert cause == "torque_band"
    assert stop_s is not None
    assert stop_s <= WITHIN_S


def test_a_motion_that_nobody_watches_comes_to_rest_within_a_second():
    """The parent hangs (SIGSTOP): it cannot ask for permits, local control and requests to stop. The arm played on until the end before."""
    with simulated_arm(HOST) as host:
        parent = replaying(host)
        try:
            assert parent.stdout is not None
            for line in parent.stdout:
                phase, elapsed = line.split()
                assert phase != "aborted", line
                if phase == "play" and float(elapsed) >= 0.5:
                    break
            with Remote(host) as remote:
                os.kill(parent.pid, signal.SIGSTOP)
                stopped_s = remote.truth()["clock_s"]
                truth = ended(remote)
            os.kill(parent.pid, signal.SIGCONT)
            printed = parent.communicate(timeout=10.0)[0].split()
        finally:
            parent.kill()
            parent.wait()
    assert truth["stops"][-1]["stood_at_s"] - stopped_s < 1.4  # 0.5 s of silence, 0.4 s of slowing down along the path, the program's end
    assert printed[-2:] == ["aborted", "late"]
