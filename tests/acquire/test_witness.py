"""What the primary port tells of a gap: the states and programs of a controller, in their order, however late they come."""

import struct
import time
from contextlib import closing, suppress

import pytest
from cutting_proxy import cutting_proxy
from simulated_arm import simulated_arm

from monitor.acquire.ur.witness import HOLE_S, PrimaryWitness, Told, against, told
from monitor.simulate.remote import Remote

MOVING, RESTING = (0.5,) * 6, (0.0,) * 6


def state(at_s, **changes):
    return Told(at_s, at_s, stopped=False, robot_mode=7, runs=False, paused=False, teach=False, q=RESTING, qd=RESTING)._replace(**changes)


def found(*states, programs=True):
    return [each.code for each in against(list(states), programs=programs)]


def test_an_arm_whose_program_ends_and_that_comes_to_rest_is_explained():
    stop = [state(0.0, runs=True, qd=MOVING), state(0.1, qd=MOVING), state(0.3, qd=MOVING), state(0.5), state(2.0)]
    assert found(*stop) == []


@pytest.mark.parametrize(
    ("states", "codes"),
    [
        ([state(0.0, runs=True), state(0.1, stopped=True), state(0.2)], ["stopped_meanwhile"]),
        ([state(0.0, runs=True), state(0.1, robot_mode=5), state(0.2)], ["mode_meanwhile"]),
        ([state(0.0, runs=True), state(0.1), state(0.2, runs=True), state(0.3)], ["another_program_meanwhile"]),
        ([state(0.0, runs=True), state(0.1, teach=True), state(0.2)], ["taught_meanwhile"]),
        ([state(0.0, runs=True), state(0.1), state(0.3, qd=MOVING)], ["moved_meanwhile"]),
        ([state(0.0, runs=True), state(0.1), state(0.3, q=(0.02, *RESTING[1:]))], ["moved_meanwhile"]),
        ([state(0.0, runs=True), state(0.1, qd=MOVING), state(0.9, qd=MOVING)], ["moved_meanwhile"]),
    ],
    ids=["a stop", "no power", "a program", "freedrive", "a jog", "a small jog", "no rest"],
)
def test_whatever_else_the_robot_told_is_found(states, codes):
    assert found(*states) == codes


def test_a_program_may_run_after_an_arm_that_was_seen_at_rest_but_no_stop():
    assert found(state(0.0), state(0.1, runs=True, qd=MOVING), programs=False) == []
    assert found(state(0.0), state(0.1, runs=True, stopped=True), programs=False) == ["stopped_meanwhile"]


@pytest.mark.parametrize("junk", [b"", b"\0" * 40, struct.pack(">iB", 5, 0), struct.pack(">iB", 40, 0) + b"\0" * 35])
def test_a_state_without_modes_or_joints_tells_nothing(junk):
    """Also one with a package that is cut short."""
    with suppress(OSError):  # no head: the connection is given up
        assert told(junk) is None


@pytest.mark.real_time
def test_the_history_of_a_gap_comes_with_the_network_and_a_lost_connection_knows_nothing():
    """The network is away for a second, in it a protective stop; then the connection is cut."""
    with simulated_arm("127.0.2.66"), cutting_proxy("127.1.2.66", "127.0.2.66") as proxy, closing(PrimaryWitness("127.1.2.66")) as witness:
        assert not witness.history(0.0, 1.0).known  # it has not begun
        witness.begin()
        time.sleep(1.0)
        since_s = time.monotonic() - 0.3
        assert witness.history(since_s, since_s + 0.2) == (True, None)
        gap_s = time.monotonic()
        proxy.hold()
        with Remote("127.0.2.66") as remote:
            remote.fault("protective_stop", runtime="stopped")
        time.sleep(1.0)
        proxy.let_go()
        history = witness.history(gap_s, time.monotonic())
        assert history.known
        assert history.found.code == "stopped_meanwhile"
        proxy.cut("primary", reset=False)
        time.sleep(HOLE_S + 0.2)
        assert not witness.history(time.monotonic() - 0.1, time.monotonic()).known
