"""A replay borrows the arm of a simulated cell in real time: at the program's node, with unmodified ur-rtde, and gives it back."""

import os
import signal
import time
from contextlib import ExitStack

import numpy as np
import pytest
from excitations import short
from lending_cell import AT_NODE, Cell, lending_cell
from processes import children

from monitor.acquire.replay import replay
from monitor.acquire.safety.inputs import Permit
from monitor.acquire.watch import Caller, ReplayProgress
from monitor.errors import MotionRefused, ReplayAborted
from monitor.model.robot import load_robot
from monitor.reason import reason_of
from monitor.recording import Context

pytestmark = pytest.mark.real_time

UR5 = load_robot("ur5")
STOP_WITHIN_S = 0.25  # of the arm's own clock


@pytest.fixture(scope="module")
def cells():
    """What ends the present cell, and all cells so far, the present one last."""
    with ExitStack() as stack:
        yield stack, []


@pytest.fixture
def cell(cells, tmp_path_factory):
    """One for all tests; a new one after a test that left its program standing, as one that other work of the machine disturbed may."""
    stack, started = cells
    if not started or started[-1].dashboard("programState") != "PLAYING cell.urp" or started[-1].astray:
        stack.close()
        started.append(stack.enter_context(lending_cell("127.0.2.61", tmp_path_factory.mktemp("cell"), "--robot", "ur5")))
    return started[-1]


def goes_on(cell: Cell, cycles: int = 1, within_s: float = 5.0) -> bool:
    """Whether the program goes on after its node so often, each time from where it came to it."""
    enough, until = cell.cycles + cycles, time.monotonic() + within_s
    while cell.cycles < enough and time.monotonic() < until:
        time.sleep(0.05)
    return cell.cycles >= enough and cell.astray == 0 and cell.dashboard("programState") == "PLAYING cell.urp"


def test_a_replay_is_played_at_the_programs_node_and_the_program_goes_on(cell):
    """Taken where the program brought the arm, played, back within 1 mrad; no stop, no watchdog and no upload."""
    stops, scripts = len(cell.truth["stops"]), cell.truth["scripts_started"]
    seen: list[ReplayProgress] = []
    recording = replay(short(), UR5, cell.settings(), caller=Caller(on_progress=seen.append))
    truth = cell.truth
    assert len(recording.t_s) >= 360
    assert "node" in {at.phase for at in seen}
    assert (len(truth["stops"]), truth["scripts_started"], truth["watchdog_s"]) == (stops, scripts, None)
    assert goes_on(cell)


def test_a_node_at_which_a_condition_does_not_hold_is_passed_by(cell):
    """The program is not delayed by a tick; the reason is shown, and is what the replay ends with when its time is over."""
    seen: list[ReplayProgress] = []
    before = cell.cycles
    with pytest.raises(MotionRefused, match=r"no node .* payload: the controller reckons with 0.000 kg"):
        replay(short(), UR5, cell.settings(hand_over_wait_h=0.001), context=Context(payload_kg=2.0), caller=Caller(on_progress=seen.append))
    assert any("payload" in str(at.passed_by) for at in seen)
    assert cell.cycles >= before + 2
    assert cell.astray == 0


def test_a_permit_that_is_refused_at_the_node_gives_the_arm_back(cell):
    """The arm has been taken by then; the program goes on, and nothing asks for a person."""
    with pytest.raises(MotionRefused, match="not now"):
        replay(short(), UR5, cell.settings(permit="zenoh"), caller=Caller(ask=lambda about, timeout_s: Permit(False, reason_of("not now"))))
    assert goes_on(cell)


def test_a_session_that_refuses_the_motion_after_it_was_told_to_go_gives_the_arm_back(cell):
    """The slider is moved just then. Nothing moved, the program goes on, and nobody is asked: it was taken for a failure of ours before."""
    with pytest.raises(MotionRefused, match="speed_scaling"):
        replay(short(), UR5, cell.settings(), caller=Caller(begin=lambda identity: cell.fault("speed_slider", fraction=0.5)))
    cell.fault("speed_slider", fraction=1.0)
    assert goes_on(cell)


@pytest.mark.soak
def test_a_monitor_that_hangs_while_it_has_the_arm_gives_it_back(cell):
    """Stopped before it said `go`: the arm stood there, and the program with it, for as long as nobody came."""
    hung: list[float] = []

    def hang(about) -> None:
        cycles = cell.cycles
        time.sleep(4.5)  # the session gives up after 3 s
        hung.append(cell.cycles - cycles)

    with pytest.raises(ReplayAborted) as ended:
        replay(short(), UR5, cell.settings(), caller=Caller(announce=hang))
    assert hung[0] >= 1  # the program went on while this process still hung
    assert (ended.value.cause, ended.value.borrowed, ended.value.needs_a_person) == ("late", False, False)
    assert "said nothing for 3 s" in str(ended.value)
    assert goes_on(cell)


def test_a_request_to_stop_while_the_node_is_awaited_leaves_the_program_alone(cell):
    """Nothing was taken, so there is nothing to give back."""
    begin = time.monotonic()
    with pytest.raises(ReplayAborted) as ended:
        replay(
            short(),
            UR5,
            cell.settings(),
            context=Context(payload_kg=2.0),
            caller=Caller(should_stop=lambda: time.monotonic() - begin > 1.0),
        )
    assert (ended.value.cause, ended.value.borrowed, ended.value.needs_a_person) == ("parent_asked_to_stop", False, False)
    assert goes_on(cell)


def test_a_request_to_stop_in_the_middle_brings_the_arm_back_over_its_way(cell):
    """Whoever restarts the monitor does not stop production."""
    seen: list[ReplayProgress] = []
    with pytest.raises(ReplayAborted) as ended:
        replay(
            short(), UR5, cell.settings(), caller=Caller(on_progress=seen.append, should_stop=lambda: bool(seen) and seen[-1].rows > 150)
        )
    assert (ended.value.cause, ended.value.borrowed, ended.value.needs_a_person) == ("parent_asked_to_stop", False, False)
    assert "has its arm back" in str(ended.value)
    assert "way_back" in {at.phase for at in seen}
    assert goes_on(cell)


def test_a_dead_child_in_local_control_stops_arm_and_program(cell):
    """The dashboard may stop nothing there. The node itself stops the arm, ends the program, and a person is asked for."""
    cell.fault("remote", state="on")  # a try that a busy machine disturbed has left the program ended, and remote control off
    cell.tell("play")
    cell.fault("remote", state="off")
    killed: list[float] = []

    def kill(at: ReplayProgress) -> None:
        if at.phase == "play" and at.elapsed_s > 0.6 and not killed:
            killed.append(cell.truth["clock_s"])
            os.kill(children(naming="monitor.acquire.ur")[0], signal.SIGKILL)

    with pytest.raises(ReplayAborted) as ended:
        replay(short(), UR5, cell.settings(), caller=Caller(on_progress=kill))
    time.sleep(0.3)
    truth = cell.truth
    cell.fault("remote", state="on")
    assert (ended.value.borrowed, ended.value.needs_a_person, ended.value.unknown) == (True, True, None)
    assert "does not go on" in str(ended.value)
    assert truth["standing"]
    assert cell.dashboard("programState") == "STOPPED cell.urp"
    assert truth["stops"][-1]["at_s"] - killed[0] <= STOP_WITHIN_S
    assert np.max(np.abs(np.array(truth["q"]) - AT_NODE)) > 0.02  # it stands where it was stopped


def test_a_node_whose_guard_repeats_no_beat_gets_its_arm_back_unmoved(cell):
    """As with the text of an earlier version, or where nothing would stop a lost arm: nothing moves, and the program goes on."""
    cell.server.close()
    cell.text = cell.text.replace("write_output_integer_register(17, jm_beat)", "jm_silent_s = 0.0")
    cell.serve()
    cell.tell("stop")
    cell.tell("play")
    with pytest.raises(MotionRefused, match="repeats no beat"):
        replay(short(), UR5, cell.settings())
    assert goes_on(cell)
