"""The logbook tells whose programs ran and who stopped them, when the arm moved, and what pressed against it."""

import numpy as np
import pytest
from sim_pendant import COMMAND, CONTROL, MOVE, Pendant

from monitor.simulate.commands import truth
from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.journal import Logbook
from monitor.simulate.settings import SimulateSettings


def logbook(pendant: Pendant) -> Logbook:
    return pendant.controller.journal.logbook


@pytest.mark.parametrize(
    ("act", "kind", "by"),
    [
        (lambda c: c.write_inputs(COMMAND, [255]), "program_end", "itself"),
        (lambda c: c.inject("program_stop", {}), "program_stop", "somebody else"),
        (lambda c: c.run_script("stop program"), "program_stop", "client"),
        (lambda c: c.run_script(CONTROL.rstrip()), "program_stop", "client"),
        (lambda c: c.inject("emergency_stop", {}), "emergency_stop", "safety"),
        (lambda c: c.inject("protective_stop", {"runtime": "stopped"}), "protective_stop", "safety"),
    ],
)
def test_every_end_of_a_program_names_its_kind_and_who_did_it(act, kind, by):
    """The program of a client runs from its upload to its end."""
    pendant = Pendant()
    pendant.run(0.1)
    run = logbook(pendant).running
    assert (run.number, run.owner, run.ended_s) == (1, "client", None)
    act(pendant.controller)
    pendant.run(0.02)
    assert (run.kind, run.stopped_by) == (kind, by)
    assert 0.09 <= run.ended_s - run.began_s <= 0.12


def test_the_watchdog_is_named_where_it_stopped_the_program():
    """A stream that ends without a word."""
    pendant = Pendant()
    pendant.controller.machine.watchdog.watch("input_int_register_0", 10.0)
    pendant.stream(0.5)
    pendant.run(0.3)
    (run,) = logbook(pendant).programs
    assert (run.kind, run.stopped_by) == ("watchdog", "watchdog")


def test_every_stretch_of_motion_has_its_begin_its_end_and_its_program():
    """Two moves with a rest between them are two stretches; the arm that stands again closes each."""
    pendant = Pendant()
    for goal in (-1.4, -1.6):
        pendant.do(MOVE, [1, 0, goal, 0, goal, 0, 0, 1.0, 2.0, 0])
        pendant.run(0.3)
    first, second = logbook(pendant).motions
    assert first.program == second.program == 1
    assert first.began_s < first.stood_s < second.began_s < second.stood_s
    assert first.fastest_rad_s == pytest.approx(0.58, abs=0.05)  # 0.17 rad at 2 rad/s²


def test_an_arm_that_does_not_move_has_no_stretch_of_motion():
    """Neither noise nor a program without motion counts."""
    pendant = Pendant(personality="recorded")
    pendant.run(2.0)
    assert not logbook(pendant).motions
    assert not logbook(pendant).touches


def test_a_contact_is_noted_with_its_largest_torque_and_its_joint():
    """A push of 40 N·m on joint 2 for half a second."""
    pendant = Pendant()
    pendant.controller.inject("obstacle", {"joint": 2, "torque": 40.0, "seconds": 0.5})
    pendant.run(1.0)
    (touch,) = logbook(pendant).touches
    assert (touch.joint, touch.largest_nm) == (2, pytest.approx(40.0))
    assert touch.ended_s - touch.began_s == pytest.approx(0.5, abs=0.02)


def test_a_controller_that_starts_again_goes_on_with_the_logbook():
    """The power ended the program and the motion; the boots are counted, the numbers of programs go on."""
    pendant = Pendant()
    pendant.stream(0.5)
    again = Controller(SimulateSettings(), before=pendant.controller)
    told = truth(again)
    assert told["boot"] == 2
    (run,), (motion,) = told["programs"], told["motions"]
    assert (run["boot"], run["stopped_by"]) == (1, "power")
    assert motion["stood_s"] == run["ended_s"]
    again.step()
    assert not np.any(again.arm.qd)
