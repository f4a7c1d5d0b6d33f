"""Stops, pauses and the pendant interrupt a motion: nothing moves that must not, and nothing is done too early."""

import numpy as np
import pytest
from sim_pendant import CLEAR, MOVE, ONE, Pendant

from monitor.simulate.machine.registers import INPUT_TYPES, recipe
from monitor.simulate.machine.state import Runtime, SafetyMode
from monitor.simulate.wire import dashboard

SLIDER = recipe(["speed_slider_mask", "speed_slider_fraction"], INPUT_TYPES)
THERE = [1.0, -1.2, 0.5, -1.0, 0.3, 0.2]
THERE_IN_A_LINE = [1.3, -1.3, 0.9, -1.2, -1.3, 0.2]
BACK = [-1.0, *THERE[1:]]
SETTLING_RAD = 1e-3  # what the servo still makes of friction after a stop; a move goes a thousand times as far
PATH = "def two_moves():\n  movej([1.0,-1.2,0.5,-1.0,0.3,0.2],a=1,v=1)\n  movej([-1.0,-1.2,0.5,-1.0,0.3,0.2],a=1,v=1)\nend"


@pytest.fixture
def pendant() -> Pendant:
    return Pendant()


def begin_move(pendant: Pendant, q, *, seconds: float, straight: bool = False, asynchronous: bool = False) -> None:
    """Start a moveJ, or a moveL to joint positions, and let it run for the given time."""
    pendant.controller.write_inputs(MOVE, [4 if straight else 1, *q, 1.0, 1.4, int(asynchronous)])
    pendant.run(seconds)


def test_a_move_that_waits_for_the_stop_of_the_one_before_ends_with_its_program(pendant):
    """A second asynchronous moveJ waits while the arm brakes. When the program is stopped then, the arm must stand."""
    c = pendant.controller
    begin_move(pendant, THERE, seconds=0.7, asynchronous=True)
    c.write_inputs(*CLEAR)
    c.step()
    begin_move(pendant, BACK, seconds=0.1, asynchronous=True)
    assert c.reference.queued
    assert dashboard.reply(c, "stop") == "Stopped"
    pendant.run(1.0)
    stands = c.arm.q.copy()
    pendant.run(1.0)
    assert c.machine.standing
    assert np.allclose(c.arm.q, stands, atol=SETTLING_RAD)


@pytest.mark.parametrize("straight", [False, True])
def test_a_move_that_was_paused_goes_on_to_its_goal(pendant, straight):
    """The move is not done before the arm is at its goal."""
    c = pendant.controller
    pendant.do(MOVE, [1, *THERE[:1], -1.4, 1.0, -1.2, -1.3, 0.0, 2.0, 2.0, 0])  # away from the singular home
    begin_move(pendant, THERE_IN_A_LINE, seconds=0.3, straight=straight)
    assert dashboard.reply(c, "pause") == "Pausing program"
    pendant.run(1.0)
    assert c.machine.standing
    assert dashboard.reply(c, "play") == "Starting program"
    pendant.run(0.1)
    assert c.registers.output_ints[0] == 1
    pendant.run(6.0)
    assert c.registers.output_ints[0] == 2
    assert np.allclose(c.arm.q, THERE_IN_A_LINE, atol=2e-3)


def test_a_stopped_program_forgets_the_move_that_was_paused(pendant):
    """The arm stays at rest after the program was stopped in a pause."""
    c = pendant.controller
    begin_move(pendant, THERE, seconds=0.5)
    dashboard.reply(c, "pause")
    pendant.run(0.5)
    dashboard.reply(c, "stop")
    stands = c.arm.q.copy()
    pendant.run(1.0)
    assert np.allclose(c.arm.q, stands, atol=SETTLING_RAD)


@pytest.mark.parametrize("runtime", ["paused", "playing"])
def test_after_a_protective_stop_the_move_goes_on_when_the_program_does(runtime):
    """It continues at the unlock if the program has played on, or else at `play`."""
    pendant = Pendant(protective_runtime=runtime)
    c = pendant.controller
    begin_move(pendant, THERE, seconds=0.5)
    c.protective_stop("test")
    pendant.run(5.5)
    assert c.registers.output_ints[0] == 1
    assert c.safety.unlock()
    assert dashboard.reply(c, "play") == ("Starting program" if runtime == "paused" else "Failed to execute: play")
    pendant.run(6.0)
    assert c.registers.output_ints[0] == 2
    assert np.allclose(c.arm.q, THERE, atol=2e-3)


def test_no_move_begins_in_a_protective_stop_in_which_the_program_plays_on():
    """Neither the next move of a list nor a new one begins."""
    for begin in (lambda p: p.controller.run_script(PATH), lambda p: begin_move(p, THERE, seconds=0.1)):
        pendant = Pendant(protective_runtime="playing")
        c = pendant.controller
        begin(pendant)
        pendant.run(0.5)
        c.protective_stop("test")
        pendant.run(1.0)
        begin_move(pendant, BACK, seconds=0.1)
        stands = c.arm.q.copy()
        pendant.run(1.0)
        assert (c.modes.safety, c.modes.runtime) == (SafetyMode.PROTECTIVE_STOP, Runtime.PLAYING)
        assert np.allclose(c.arm.q, stands, atol=SETTLING_RAD)


def test_a_protective_stop_is_not_made_softer_by_the_program():
    """servoStop with 0.01 rad/s² would let the arm move on for minutes."""
    pendant = Pendant(protective_runtime="playing")
    pendant.stream(0.5)
    c = pendant.controller
    c.protective_stop("test")
    c.write_inputs(ONE, [16, 0.01])
    pendant.run(0.5)
    assert c.machine.standing


def test_a_brake_release_of_a_running_arm_disturbs_no_motion(pendant):
    """The brakes are open already."""
    c = pendant.controller
    begin_move(pendant, THERE, seconds=0.5)
    assert dashboard.reply(c, "brake release") == "Brake releasing"
    pendant.run(0.1)
    assert c.registers.output_ints[0] == 1
    pendant.run(3.0)
    assert np.allclose(c.arm.q, THERE, atol=2e-3)


def test_the_speed_slider_brings_no_jerk(pendant):
    """The slider goes from full speed to a twentieth. The arm slows down with a small acceleration and reaches its goal."""
    c = pendant.controller
    begin_move(pendant, THERE, seconds=0.5)
    fast = float(np.abs(c.reference.qd).max())
    c.write_inputs(SLIDER, [1, 0.05])
    largest = 0.0
    for _ in range(75):
        before = c.reference.qd
        c.step()
        largest = max(largest, float(np.abs(c.reference.qd - before).max()) / c.clock.tick_s)
    assert float(np.abs(c.reference.qd).max()) < 0.1 * fast
    assert largest < 4.0  # the move's own 1.4 and 1 rad/s in half a second
    c.write_inputs(SLIDER, [1, 1.0])
    pendant.run(4.0)
    assert np.allclose(c.arm.q, THERE, atol=2e-3)
