"""What people, other machines and mechanics do to an arm: other programs, changes at the pendant, a stuck joint, a dead watchdog."""

import numpy as np
import pytest
from sim_pendant import COMMAND, CONTROL, MOVE, Pendant

from monitor.errors import BadInput
from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.journal import ProgramRun
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire import dashboard
from monitor.simulate.wire.variables import output_variables


def read(pendant: Pendant, name: str) -> list[float]:
    return list(output_variables(pendant.controller)[name].read())


def programs(pendant: Pendant) -> list[ProgramRun]:
    return list(pendant.controller.journal.logbook.programs)


def test_somebody_elses_program_starts_after_ours_has_ended():
    """0.15 s after our end it begins, moves the arm for a second, and ends by itself."""
    pendant = Pendant()
    pendant.controller.inject("foreign_program", {"when": "after_ours", "delay": 0.15, "seconds": 1.0})
    pendant.run(0.5)
    assert len(programs(pendant)) == 1
    pendant.controller.write_inputs(COMMAND, [255])
    pendant.run(1.5)
    ours, theirs = programs(pendant)
    assert (ours.owner, theirs.owner) == ("client", "somebody else")
    assert theirs.began_s - ours.ended_s == pytest.approx(0.15, abs=0.01)
    assert (theirs.kind, theirs.stopped_by) == ("program_end", "itself")
    (motion,) = pendant.controller.journal.logbook.motions
    assert motion.program == theirs.number
    assert 0.05 < motion.fastest_rad_s < 0.25


def test_somebody_elses_program_waits_for_ours_and_not_for_one_of_before_a_restart():
    """The clock began again: a program that ended before the restart did so at a time that this clock has not reached yet."""
    before = Pendant()
    before.run(5.0)
    before.controller.write_inputs(COMMAND, [255])
    before.run(0.1)
    pendant = Pendant(before=before.controller)
    assert programs(pendant)[0].ended_s > pendant.controller.clock.now_s + 2.0
    pendant.controller.inject("foreign_program", {"when": "after_ours", "delay": 0.15, "seconds": 1.0})
    pendant.run(0.5)
    pendant.controller.write_inputs(COMMAND, [255])
    pendant.run(1.5)
    _, ours, theirs = programs(pendant)
    assert (ours.owner, theirs.owner) == ("client", "somebody else")
    assert theirs.began_s - ours.ended_s == pytest.approx(0.15, abs=0.01)


def test_a_stop_of_the_dashboard_stops_somebody_elses_program_and_the_logbook_tells_it():
    """Whoever sends `stop` without a look stops what is not theirs."""
    pendant = Pendant()
    pendant.controller.stop_program("the test")
    pendant.controller.inject("foreign_program", {"delay": 0.1, "moves": "off"})
    pendant.run(0.3)
    assert dashboard.reply(pendant.controller, "stop") == "Stopped"
    theirs = programs(pendant)[-1]
    assert (theirs.owner, theirs.stopped_by) == ("somebody else", "dashboard")
    assert not pendant.controller.journal.logbook.motions


def test_a_program_that_starts_while_ours_uploads_plays_until_ours_replaces_it():
    """Their program starts when our script arrives; ours starts 24 ms later and ends theirs."""
    pendant = Pendant()
    pendant.controller.stop_program("the test")
    pendant.controller.inject("foreign_program", {"when": "during_upload", "delay": 0.024})
    pendant.run(0.1)
    pendant.controller.run_script(CONTROL.rstrip())
    assert programs(pendant)[-1].owner == "somebody else"
    pendant.run(0.1)
    theirs, ours = programs(pendant)[-2:]
    assert (theirs.owner, theirs.stopped_by, ours.owner) == ("somebody else", "client", "client")
    assert theirs.ended_s - theirs.began_s == pytest.approx(0.024, abs=0.009)


def test_a_planned_program_is_forgotten_at_clear():
    """It never starts."""
    pendant = Pendant()
    pendant.controller.inject("foreign_program", {"when": "after_ours"})
    pendant.controller.inject("clear", {})
    pendant.controller.stop_program("the test")
    pendant.run(1.0)
    assert len(programs(pendant)) == 1


def test_the_freedrive_button_shows_in_the_status_bits_and_nowhere_else():
    """Bit 2 while it is held."""
    pendant = Pendant()
    assert read(pendant, "robot_status_bits") == [0b011]
    pendant.controller.inject("teach_button", {})
    assert read(pendant, "robot_status_bits") == [0b111]
    pendant.controller.inject("teach_button", {"state": "off"})
    assert read(pendant, "robot_status_bits") == [0b011]


def test_the_slider_at_the_pendant_scales_moves_and_is_published():
    """At a half, a move takes about twice as long; `clear` sets it to full."""
    pendant = Pendant()
    pendant.controller.inject("speed_slider", {"fraction": 0.5})
    assert read(pendant, "speed_scaling") == read(pendant, "target_speed_fraction") == [0.5]
    pendant.do(MOVE, [1, 0, -1.2, 0, -1.6, 0, 0, 0.5, 5.0, 0])
    pendant.run(0.2)
    (motion,) = pendant.controller.journal.logbook.motions
    assert motion.stood_s - motion.began_s == pytest.approx(1.4, abs=0.2)  # 0.84 s at full speed
    pendant.controller.inject("clear", {})
    assert read(pendant, "target_speed_fraction") == [1.0]


def test_changes_at_the_pendant_are_published_and_undone_by_clear():
    """The tool centre point; mass and centre of the payload. The first value before several changes is restored."""
    pendant = Pendant(payload_kg=1.0, payload_com_m=(0.0, 0.0, 0.04))
    for height in (0.1, 0.2):
        pendant.controller.inject("tcp_changed", {"z": height})
    pendant.controller.inject("payload_changed", {"kg": 1.0, "x": 0.03, "z": 0.04})
    assert read(pendant, "tcp_offset") == [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]
    assert read(pendant, "payload") == [1.0]
    assert read(pendant, "payload_cog") == [0.03, 0.0, 0.04]
    assert pendant.controller.arm.payload_com_m == (0.0, 0.0, 0.04)
    pendant.controller.inject("clear", {})
    assert read(pendant, "tcp_offset") == [0.0] * 6
    assert read(pendant, "payload_cog") == [0.0, 0.0, 0.04]


def test_a_wrist_turned_by_a_turn_stands_where_it_stood_and_says_another_angle():
    """Two turns are within the range of a UR3e's wrist 3 alone."""
    small = Pendant(robot="ur3e")
    pose = read(small, "actual_TCP_pose")
    small.controller.inject("wrist_turned", {"turns": 2})
    small.run(0.2)
    assert read(small, "actual_q")[5] == pytest.approx(4.0 * np.pi, abs=1e-3)
    assert read(small, "target_q")[5] == pytest.approx(4.0 * np.pi)
    assert np.allclose(read(small, "actual_TCP_pose")[:3], pose[:3], atol=1e-3)
    assert small.controller.modes.safety == 1
    with pytest.raises(BadInput, match="joint 6"):
        Pendant().controller.inject("wrist_turned", {"turns": 2})


def test_in_the_reduced_safety_mode_the_arm_moves_on():
    """Safety mode 2 and bit 1; a protective stop is possible from there."""
    pendant = Pendant()
    pendant.controller.inject("reduced", {})
    assert read(pendant, "safety_mode") == [2]
    assert read(pendant, "safety_status_bits") == [0b10]
    pendant.stream(0.3, speed=0.3)
    assert pendant.controller.arm.qd.max() > 0.2
    assert dashboard.reply(pendant.controller, "safetymode") == "Safetymode: REDUCED"
    pendant.controller.inject("protective_stop", {})
    assert read(pendant, "safety_mode") == [3]


def test_when_the_guard_is_closed_again_the_program_plays_on_by_itself():
    """Open, the arm stands and its program is paused, with safety mode 5 and bits 4 and 10; closed, the move goes on to its end."""
    pendant = Pendant()
    pendant.controller.write_inputs(MOVE, [1, 0, -1.0, 0, -1.6, 0, 0, 0.5, 2.0, 0])
    pendant.run(0.6)
    pendant.controller.inject("safeguard_stop", {"seconds": 1.0})
    pendant.run(0.5)
    assert read(pendant, "safety_mode") == [5]
    assert read(pendant, "safety_status_bits") == [1 << 4 | 1 << 10]
    assert read(pendant, "runtime_state") == [4]
    assert pendant.standing
    pendant.run(2.5)
    assert pendant.controller.arm.q[1] == pytest.approx(-1.0, abs=2e-3)
    first, second = pendant.controller.journal.logbook.motions
    assert first.program == second.program == 1


def test_an_open_guard_does_not_keep_the_watchdog_from_ending_the_program():
    """A client that is gone by then: the program does not play on when the guard is closed."""
    pendant = Pendant()
    pendant.controller.machine.watchdog.watch("input_int_register_0", 10.0)
    pendant.stream(0.4)
    pendant.controller.inject("safeguard_stop", {"seconds": 0.5})
    pendant.run(1.0)
    assert pendant.controller.modes.safety == 1
    assert programs(pendant)[-1].stopped_by == "watchdog"
    assert len(pendant.controller.journal.logbook.motions) == 1


def test_a_stuck_joint_stands_at_once_and_the_others_go_on_until_the_protective_stop():
    """No drive turns it: its following error grows with the target. After `clear` it turns again."""
    pendant = Pendant()
    pendant.stream(0.4, speed=0.4)
    pendant.controller.inject("stuck", {"joint": 2})
    pendant.run(0.008)
    q = pendant.controller.arm.q.copy()
    pendant.stream(0.15, speed=0.4)
    assert abs(pendant.controller.arm.q[1] - q[1]) < 1e-4
    assert abs(pendant.controller.arm.q[0] - q[0]) > 0.01
    pendant.stream(1.0, speed=0.4)
    assert pendant.controller.modes.safety == 3
    pendant.controller.inject("clear", {})
    pendant.run(6.0)
    assert pendant.controller.safety.unlock()
    pendant.controller.run_script(CONTROL.rstrip())
    pendant.stream(0.4, speed=0.4)
    assert pendant.controller.arm.qd.min() > 0.3


def test_a_closed_brake_shows_in_the_mode_of_its_joint():
    """255 on that joint, 253 on the others; the arm is running all the same."""
    pendant = Pendant()
    pendant.controller.inject("brake", {"joint": 3})
    assert read(pendant, "joint_mode") == [253, 253, 255, 253, 253, 253]
    assert read(pendant, "robot_mode") == [7]
    pendant.controller.inject("clear", {})
    assert read(pendant, "joint_mode") == [253] * 6


def test_a_dead_watchdog_lets_the_program_play_on_without_targets():
    """The controller acknowledged it. A living one stops the program after a tenth of a second."""
    for dead, ended in ((True, None), (False, "watchdog")):
        pendant = Pendant()
        if dead:
            pendant.controller.inject("watchdog_dead", {})
        pendant.controller.machine.watchdog.watch("input_int_register_0", 10.0)
        pendant.stream(0.3)
        pendant.run(0.5)
        assert (programs(pendant)[-1].stopped_by or None) == ended


def test_the_published_clock_jumps_and_the_arm_does_not():
    """Only the timestamp: the watchdog, the logbook and the motion keep their own time."""
    pendant = Pendant()
    for seconds in (5.0, -10.0):
        before = read(pendant, "timestamp")[0]
        pendant.controller.inject("clock_jump", {"seconds": seconds})
        pendant.run(0.008)
        assert read(pendant, "timestamp")[0] - before == pytest.approx(seconds + 0.008)
    assert pendant.controller.clock.now_s < 1.0


@pytest.mark.parametrize(("robot", "refused"), [("ur5e", True), ("ur5", False)])
def test_in_local_control_an_e_series_refuses_what_acts(robot, refused):
    """Commands of the dashboard that act, and scripts; questions are answered. A CB3 has no such mode."""
    controller = Controller(SimulateSettings(robot=robot))
    controller.inject("remote", {"state": "off"})
    for command in ("stop", "play", "pause", "load x.urp", "unlock protective stop"):
        assert ("switch robot to Remote Control mode" in dashboard.reply(controller, command)) == refused
    assert dashboard.reply(controller, "robotmode").startswith("Robotmode")
    controller.run_script("movej([0,-1.5,0,-1.5,0,0])")
    assert (controller.programs.current is None) == refused
