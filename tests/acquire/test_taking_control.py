"""From the upload to the first target: the streaming process on scripted rows, without ur-rtde."""

import math
from functools import partial

import pytest
from scripted_arm import PAUSED, PLAYING, STOPPED, STOPPING, TICK_S, cause_of, rows, scripted_arm, told

from monitor.acquire.ur.arm import SPEED_RISE_S, Arm
from monitor.acquire.ur.failures import StreamFailure
from monitor.acquire.ur.primary import OUR_NAME
from monitor.acquire.ur.rtde import COLUMN
from monitor.acquire.ur.upload import START_S


def start_program(arm):
    arm.taking.start_program(arm)


def prove_watchdog(arm):
    arm.taking.prove_watchdog(arm)


@pytest.fixture
def scripted(monkeypatch):
    """A function: rows → an arm whose control connection is `FakeControl`."""
    return scripted_arm(monkeypatch)


# --- the upload --------------------------------------------------------------------------------------------------


def test_the_program_is_sent_over_nothing_that_runs_and_awaited_on_both_connections(scripted):
    arm = scripted(rows((STOPPED, 10), (PLAYING, 40)))
    start_program(arm)
    assert arm.control.asked == ["upload"]
    assert arm.control.program_runs()


@pytest.mark.parametrize("ticks", [1, 2, 8, 13])
@pytest.mark.parametrize("pause", [STOPPING, STOPPED])
def test_a_program_that_ours_replaced_is_noticed_and_nothing_is_stopped(scripted, ticks, pause):
    """Somebody's program began after our last look and played for up to 0.1 s before ours replaced it; the replay went on over it."""
    arm = scripted(rows((STOPPED, 6), (PLAYING, ticks), (pause, 1), (PLAYING, 60)))
    with pytest.raises(StreamFailure) as failure:
        start_program(arm)
    assert (failure.value.cause, failure.value.ours) == ("no_control", False)


def test_a_program_that_moves_the_arm_before_our_first_target_is_not_ours(scripted):
    made = rows((STOPPED, 6), (PLAYING, 60))
    for each in made[9:12]:
        each[COLUMN["target_qd"]] = 0.2
    with pytest.raises(StreamFailure) as failure:
        start_program(scripted(made))
    assert (failure.value.cause, failure.value.ours) == ("no_control", False)


def test_a_program_that_ours_replaced_without_a_pause_is_noticed_by_its_name_and_ours_is_ended(scripted):
    """The rows show one program that plays from tick 6 on; it ends only because it is asked to."""
    arm = told(scripted, rows((STOPPED, 6), (PLAYING, 20), (STOPPED, 60)), (0.05, "welding"), (0.08, None), (0.08, OUR_NAME))
    with pytest.raises(StreamFailure, match="start 'welding' again") as failure:
        start_program(arm)
    assert (failure.value.cause, failure.value.ours) == ("program_replaced", True)
    assert arm.control.asked == ["upload", "end_program"]
    assert not arm.program_sent


def test_a_program_that_moves_the_arm_until_ours_replaces_it_is_named_too(scripted):
    """Its motion is seen before its name; ours is awaited, so that it does not begin after this process has gone."""
    made = rows((STOPPED, 6), (PLAYING, 20), (STOPPED, 60))
    for each in made[7:10]:
        each[COLUMN["target_qd"]] = 0.2
    arm = told(scripted, made, (0.09, "welding"), (0.1, None), (0.1, OUR_NAME))
    assert cause_of(partial(start_program, arm)) == "program_replaced"
    assert arm.control.asked == ["upload", "end_program"]


@pytest.mark.parametrize(
    "messages",
    [
        [(0.05, OUR_NAME), (0.09, None), (0.09, "welding")],  # it has taken the place of ours
        [(0.05, "welding")],  # ours never begins
        [(0.05, "welding"), (0.09, None)],
    ],
)
def test_a_program_that_ours_did_not_replace_is_named_and_gets_no_command(scripted, messages):
    """What plays may be somebody else's: this process sends nothing, tells the parent of nothing of ours, and ends."""
    arm = told(scripted, rows((STOPPED, 6), (PLAYING, 300)), *messages)
    with pytest.raises(StreamFailure, match="'welding'") as failure:
        start_program(arm)
    assert (failure.value.cause, failure.value.ours, arm.taking.in_doubt) == ("no_control", False, True)
    assert arm.control.asked == ["upload"]
    assert arm.program_sent == (messages[0][1] != OUR_NAME)  # of ours nothing is known, or that it has ended


def test_our_program_that_somebody_pauses_before_it_moves_is_known_for_ours(scripted):
    """It was told as somebody else's, stayed paused on the controller, and a person was asked."""
    arm = told(scripted, rows((STOPPED, 6), (PLAYING, 4), (PAUSED, 60)), (0.05, OUR_NAME))
    with pytest.raises(StreamFailure, match="the control program is paused") as failure:
        start_program(arm)
    assert (failure.value.cause, failure.value.ours, arm.taking.in_doubt) == ("program_stopped", True, False)


def test_a_control_program_that_fails_is_told_with_what_the_controller_says_against_it(scripted):
    """It was told as somebody else's program. Of one that cannot be read nothing begins."""
    made = rows((STOPPED, 6), (PLAYING, 3), (STOPPED, int((START_S + 1.0) / TICK_S)))
    arm = told(scripted, made, (0.05, OUR_NAME), (0.08, None))
    arm.control.upload = lambda: setattr(arm.taking.messages, "mistake", "line 7, column 3: unknown variable x") or True
    with pytest.raises(StreamFailure, match="has ended; the controller says: line 7, column 3: unknown variable x") as failure:
        start_program(arm)
    assert (failure.value.cause, failure.value.ours) == ("no_control", False)
    arm = told(scripted, rows((STOPPED, int((START_S + 1.0) / TICK_S))))
    arm.control.upload = lambda: setattr(arm.taking.messages, "mistake", "line 7, column 3: syntax error") or True
    with pytest.raises(StreamFailure, match=r"refused the control program of ur-rtde [\d.]+: line 7, column 3: syntax error"):
        start_program(arm)


def test_the_name_of_our_program_is_awaited_and_a_controller_that_tells_none_is_believed_by_its_rows(scripted):
    """A name that comes 0.2 s after the start is not missed; after 0.3 s without one nothing is awaited any more."""
    made = rows((STOPPED, 6), (PLAYING, 120))
    arm = told(scripted, made, (0.3, OUR_NAME))
    start_program(arm)
    assert arm.receive.clock.now_s >= 1000.3
    assert arm.taking.messages.open
    arm = told(scripted, made)
    start_program(arm)
    assert not arm.taking.messages.open


def test_a_program_whose_name_came_before_ours_was_sent_keeps_ours_from_being_sent(scripted):
    """The primary port may tell it before a row does. One that has ended again, and ours of before, do not count."""
    arm = told(scripted, rows((STOPPED, 20)), (0.0, "welding"))
    assert cause_of(partial(start_program, arm)) == "no_control"
    assert arm.control.asked == []
    made = rows((STOPPED, 6), (PLAYING, 60))
    start_program(told(scripted, made, (0.0, "welding"), (0.01, None), (0.06, OUR_NAME)))
    start_program(told(scripted, made, (0.0, OUR_NAME), (0.06, OUR_NAME)))


def test_a_program_that_takes_the_place_of_ours_while_the_watchdog_is_tested_is_named_and_not_stopped(scripted):
    """Without a pause it looked like a program that its watchdog does not end, which the parent would stop."""
    arm = told(scripted, rows((PLAYING, 100)), (0.05, "welding"))
    with pytest.raises(StreamFailure, match="'welding'") as failure:
        prove_watchdog(arm)
    assert (failure.value.cause, failure.value.ours) == ("program_stopped", False)


def test_a_program_that_starts_as_the_watchdog_ends_ours_is_not_stopped(scripted):
    """It began in the tick after ours had ended; it was told as ours that goes on, which the parent would stop. Its name may come later."""
    for messages, cause in (((0.12, "welding"),), "program_stopped"), ((), "no_watchdog"):
        arm = told(scripted, rows((PLAYING, 14), (STOPPING, 1), (PLAYING, 60)), *messages)
        with pytest.raises(StreamFailure) as failure:
            prove_watchdog(arm)
        assert (failure.value.cause, failure.value.ours) == (cause, False)


@pytest.mark.parametrize("state", [PLAYING, PAUSED, STOPPING])
def test_nothing_is_sent_while_somebody_elses_program_is_there(scripted, state):
    """It began after the conditions were checked; before, ur-rtde stopped it. The parent hears that no program of ours runs."""
    arm = scripted(rows((STOPPED, 1), (state, 10)))
    assert cause_of(partial(start_program, arm)) == "no_control"
    assert arm.control.asked == []
    assert not arm.program_sent


def test_nothing_is_sent_while_only_the_control_connection_shows_a_program(scripted):
    """ur-rtde judges by that connection whether to stop a program."""
    arm = scripted(rows((STOPPED, 10)))
    arm.control.runs = True
    assert cause_of(partial(start_program, arm)) == "no_control"
    assert arm.control.asked == []


def test_nothing_is_sent_where_the_connection_for_programs_has_ended(scripted):
    """ur-rtde sent it to nobody, and after 5 s it was told as a program that does not start: `no_control`."""
    arm = scripted(rows((STOPPED, int((START_S + 1.0) / TICK_S))))
    arm.control.can_upload = False
    assert cause_of(partial(start_program, arm)) == "connection_lost"
    assert arm.control.asked == []
    assert not arm.program_sent


def test_a_program_that_does_not_start_is_given_up(scripted):
    arm = scripted(rows((STOPPED, int((START_S + 1.0) / TICK_S))))
    assert cause_of(partial(start_program, arm)) == "no_control"


def test_a_safety_stop_before_the_program_starts_is_named(scripted):
    made = rows((STOPPED, 20))
    for each in made[8:]:
        each[COLUMN["safety_mode"]] = 3
    assert cause_of(partial(start_program, scripted(made))) == "protective_stop"


def test_the_parent_hears_from_the_process_while_it_takes_control(scripted):
    """What runs just after a sign of life is ours to stop, and nothing else is."""
    arm = scripted(rows((STOPPED, 10), (PLAYING, 38), (STOPPED, 10)))
    start_program(arm)
    assert arm.program_sent
    signs = arm.outbox.signs
    prove_watchdog(arm)
    assert not arm.program_sent  # it was seen to end; what runs now is somebody else's
    assert signs >= 3
    assert arm.outbox.signs - signs >= 3


# --- the watchdog ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spans", "cause"),
    [
        ([(PLAYING, 16), (STOPPED, 10)], None),
        ([(PLAYING, 16), (STOPPING, 3), (STOPPED, 10)], None),
        ([(PLAYING, 100)], "no_watchdog"),  # acknowledged, and not there
        ([(PLAYING, 5), (STOPPED, 10)], "program_stopped"),  # somebody else stopped it: that proves nothing
        ([(PLAYING, 14), (PAUSED, 10)], "no_watchdog"),  # a paused program may go on
    ],
)
def test_the_watchdog_must_end_a_program_without_targets_in_time(scripted, spans, cause):
    """Its acknowledgement alone was believed before. The arm stands meanwhile, and gets no target."""
    arm = scripted(rows(*spans))
    if cause is None:
        prove_watchdog(arm)
    else:
        assert cause_of(partial(prove_watchdog, arm)) == cause
    assert arm.control.asked == ["watchdog"]


def test_a_program_that_somebody_ended_before_any_target_was_due_is_not_explained_by_a_busy_host(scripted):
    """This process slept for 60 ms, as a busy host lets it. Ours has ended: what plays next is another's."""
    arm = scripted(rows((PLAYING, 5), (STOPPING, 2), (STOPPED, 10)))
    arm.program_sent = True
    with pytest.raises(StreamFailure) as failure:
        prove_watchdog(arm)
    arm.gaps.add(arm.receive.clock.now_s, 0.06)
    assert arm.explained(failure.value).cause == "program_stopped"
    assert not arm.program_sent


def test_a_program_that_answers_late_was_not_alone(scripted):
    """Somebody else's began while ours was on its way; ours replaced it, and the arm moved for 17 s before."""
    for act in (prove_watchdog, Arm.begin):
        arm = scripted(rows((PLAYING, 100)))
        arm.control.answers_after_s = 0.15
        assert cause_of(partial(act, arm)) == "no_control"
        assert "servo" not in arm.control.asked


def test_a_watchdog_that_nobody_took_because_another_program_came_is_named_so_and_that_one_is_not_stopped(scripted):
    """It came in the tick of the command, and was told as a refusal of ours, which the parent stopped 16 ms after its start."""
    arm = scripted(rows((PLAYING, 3), (STOPPING, 40)))
    arm.control.takes, arm.program_sent = False, True
    assert cause_of(partial(prove_watchdog, arm)) == "program_stopped"
    assert not arm.program_sent
    arm = told(scripted, rows((PLAYING, 100)), (0.02, "welding"))
    arm.control.takes = False
    with pytest.raises(StreamFailure, match="'welding'") as failure:
        prove_watchdog(arm)
    assert (failure.value.cause, failure.value.ours) == ("program_stopped", False)


def test_a_watchdog_that_is_refused_is_named(scripted):
    arm = scripted(rows((PLAYING, 100)))
    arm.control.takes = False
    assert cause_of(partial(prove_watchdog, arm)) == "no_watchdog"


# --- the trajectory limiter ----------------------------------------------------------------------------------------


def limited(shares):
    made = rows((PLAYING, len(shares)), target_speed_fraction=1.0)
    for each, share in zip(made, shares, strict=True):
        each[COLUMN["speed_scaling"]] = share
    return made


def test_a_limiter_that_stands_at_zero_for_some_ticks_after_the_start_is_awaited(scripted):
    """As recorded from real arms: it aborted every approach before."""
    arm = scripted(limited([0.0, 0.0, 0.3, 1.0, 1.0]))
    arm.wait_for_full_speed()
    assert arm.receive.present[COLUMN["speed_scaling"]][0] == 1.0
    assert arm.control.asked == []


def test_a_limiter_that_stays_below_full_speed_ends_the_motion_before_it_begins(scripted):
    arm = scripted(limited([0.5] * int((SPEED_RISE_S + 1.0) / TICK_S)))
    assert cause_of(arm.wait_for_full_speed) == "speed_scaling"


def test_a_limiter_that_is_not_reported_is_not_awaited(scripted):
    made = limited([math.nan] * 5)
    for each in made:
        each[COLUMN["target_speed_fraction"]] = math.nan
    scripted(made).wait_for_full_speed()
