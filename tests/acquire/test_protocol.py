"""The replay's table of transitions: what holds in every state that a replay can be in."""

from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.acquire.protocol import KNOWN, MOTIONS, STREAMING, Event, Order, Phase, Program, State, Unexpected

ORDERS = (Event.GO, Event.BACK, Event.STOP)
TO_REST = (Event.SETTLE, Event.FINISH, Event.GIVING_BACK, Event.GIVEN_BACK, Event.STOPPED, Event.DONE)
AFTER = (Event.PLAYS, Event.PLAYS_NOT, Event.PROGRAM_ENDED, Event.NOT_SHOWN)  # what the parent finds once the session has ended


def next_states(state: State, events=tuple(Event)) -> list[State]:
    return [state.after(event) for event in events if state.allows(event)]


def reached(start: State, events=tuple(Event)) -> set[State]:
    """Every state that these events can lead to."""
    seen, waiting = {start}, deque([start])
    while waiting:
        for after in next_states(waiting.popleft(), events):
            if after not in seen:
                seen.add(after)
                waiting.append(after)
    return seen


STARTS = [State.at_start(lent=lent) for lent in (False, True)]
STATES = sorted({state for start in STARTS for state in reached(start)})


@settings(max_examples=200)
@given(st.sampled_from(STATES), st.sampled_from(Event))
def test_an_event_is_a_named_transition_or_is_refused(state, event):
    """Never a third thing, and a refused event changes nothing."""
    if state.allows(event):
        assert state.after(event) in STATES
    else:
        with pytest.raises(Unexpected, match=state.phase.value):
            state.after(event)


@settings(max_examples=200)
@given(st.sampled_from(STARTS), st.lists(st.sampled_from(Event), max_size=30))
def test_nothing_moves_that_was_not_told_to_go(state, events):
    """Whatever comes in whatever order, from either side."""
    gone = False
    for event in events:
        if state.allows(event):
            state = state.after(event)
            gone = gone or event is Event.GO
        assert gone or state.phase not in STREAMING
        assert state.gone == gone


@settings(max_examples=200)
@given(st.sampled_from([state for state in STATES if state.phase in STREAMING]))
def test_a_stop_leads_a_moving_arm_to_an_end_without_another_motion(state):
    """It settles, and its program ends or it is given back; a lent arm that is elsewhere ends with its session, and is looked at."""
    stopped = state.after(Event.STOP) if state.allows(Event.STOP) else state
    assert stopped.order is Order.STOP
    on_the_way = reached(stopped, (*TO_REST, *AFTER))
    assert not {each.phase for each in on_the_way if each is not stopped} & (MOTIONS - {stopped.phase})
    assert any(each.over for each in on_the_way)
    assert any(each.over for each in reached(stopped.after(Event.DIED), AFTER))


@settings(max_examples=200)
@given(st.sampled_from([state for state in STATES if state.order is Order.BACK]))
def test_an_arm_that_is_ordered_back_rests_before_it_goes_back_and_can_be_stopped_at_any_time(state):
    assert state.brings_back
    assert state.must_rest
    assert state.after(Event.STOP).order is Order.STOP
    for after in next_states(state, (Event.WAY_BACK,)):
        assert (after.order, after.must_rest) == (Order.COMING_BACK, False)


@settings(max_examples=200)
@given(st.sampled_from([state for state in STATES if state.phase is not Phase.ENDED]))
def test_a_session_may_die_in_every_state_and_there_is_no_end_before_it_is_known_what_became_of_the_program(state):
    """Our program has ended, another has its arm or has lost it, or it is unknown: then somebody looks."""
    dead = state.after(Event.DIED)
    for end in reached(dead, AFTER):
        if not next_states(end):
            assert end.over
    if state.gone and state.program is not Program.GOES_ON:
        assert not dead.over
        ends = [each for each in reached(dead, AFTER) if each.over]
        assert {each.program for each in ends} <= {Program.OVER, Program.UNKNOWN, Program.GOES_ON, Program.LOST, Program.LOST_UNSEEN}
        assert all(each.moved for each in ends)


@settings(max_examples=200)
@given(st.sampled_from([state for state in STATES if state.phase is Phase.ENDED and state.program not in KNOWN]))
def test_at_an_end_something_is_to_be_found_out_or_stopped_until_it_is_known(state):
    assert state.unanswered != state.may_run
    assert next_states(state, AFTER)


@settings(max_examples=200)
@given(st.sampled_from([state for state in STATES if state.moved and state.program in {Program.OURS, Program.LENDS}]))
def test_a_refusal_cannot_follow_a_command_to_the_arm(state):
    """It would say that nothing was moved."""
    if state.phase is not Phase.READY or state.program is Program.LENDS:
        assert not state.allows(Event.REFUSED)
        assert not state.allows(Event.UNREACHABLE)


@settings(max_examples=200)
@given(st.sampled_from(STATES))
def test_only_an_arm_that_a_program_lends_is_given_back(state):
    """And an own program never plays beside one that lends its arm."""
    theirs = {Program.THEIRS, Program.ASKED, Program.LENDS, Program.OFFERED, Program.GOES_ON, Program.LOST, Program.LOST_UNSEEN}
    assert (state.program in theirs) == (state in reached(STARTS[1]))
    if state.phase in {Phase.NODE, Phase.RETURNED}:
        assert state.program in theirs


def test_a_whole_replay_of_either_kind_is_a_way_through_the_table():
    own = "connect ready go control approach settle play return settle finish done"
    lent = (
        "connect node asking not_taken asking taken ready go control way_back settle play return settle finish giving_back given_back done"
    )
    back = "connect node asking taken ready go control approach settle play back settle way_back settle return settle finish giving_back"
    for words, start, program in (
        (own, STARTS[0], Program.OVER),
        (lent, STARTS[1], Program.GOES_ON),
        (f"{back} given_back stopped", STARTS[1], Program.GOES_ON),
    ):
        state = start
        for word in words.split():
            state = state.after(Event(word))
        assert state.over
        assert state.program is program
