"""Data that cannot be trusted refuse or end a motion: reported values that are no numbers, a moved slider, conditions that changed late."""

import math
import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from excitations import short
from processes import children
from simulated_arm import simulated_arm
from test_failures import SETTINGS, SOUND
from test_guard import NOON, SIMULATED, displaced, inputs, ready_state

from monitor.acquire.protocol import Event, Order, Phase, Program, State
from monitor.acquire.replay import replay
from monitor.acquire.safety.conditions import conditions
from monitor.acquire.safety.gate import Gate
from monitor.acquire.safety.inputs import ConditionInputs, ConditionResult
from monitor.acquire.state import arm_state
from monitor.acquire.ur import stream
from monitor.acquire.ur.failures import state_failure
from monitor.acquire.ur.receive import read_row
from monitor.acquire.ur.rtde import COLUMN, SIGNALS
from monitor.acquire.watch import Caller
from monitor.errors import BadInput, MotionRefused, ReplayAborted
from monitor.model.robot import load_robot
from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time


def by_name(known: ConditionInputs) -> dict[str, ConditionResult]:
    return {condition.name: condition for condition in conditions(known)}


class Controller:
    """A connection to a controller that reports every variable: 1.0 each, except the values that are given."""

    def __init__(self, **values: object) -> None:
        self._of = {signal.getter: values.get(signal.variable, 1.0 if signal.width == 1 else [1.0] * signal.width) for signal in SIGNALS}

    def __getattr__(self, getter: str):
        return lambda: self._of[getter]


@pytest.mark.parametrize(
    ("variable", "value", "condition"),
    [
        ("speed_scaling", math.nan, "speed_scaling"),
        ("target_speed_fraction", math.nan, "speed_scaling"),
        ("target_speed_fraction", 0.5, "speed_scaling"),  # the slider; the limiter's speed_scaling may stay at 1
        ("target_speed_fraction", -1.0, "speed_scaling"),
        ("speed_scaling", 1.5, "speed_scaling"),
        ("payload", math.nan, "payload"),
        ("payload", -1.0, "payload"),
        ("actual_tool_accelerometer", [math.nan] * 3, "gravity"),
        ("actual_tool_accelerometer", [math.nan, 0.0, 9.81], "gravity"),
    ],
)
def test_a_reported_value_that_is_no_number_does_not_count_as_not_reported(variable, value, condition):
    """The value passes through the child's reading and the parent's conditions; only an absent value is "not checked"."""
    row, _ = read_row(Controller(**{variable: value}))
    state = arm_state(row)
    state_read = replace(
        ready_state(), speed_scaling=state.speed_scaling, speed_fraction=state.speed_fraction, payload_kg=state.payload_kg
    )  # both speeds and the payload are 1 in `ready_state` too
    if condition == "gravity":
        state_read = replace(state_read, accelerometer_m_s2=state.accelerometer_m_s2)
    found = by_name(inputs(state_read))
    assert [name for name, each in found.items() if not each.holds] == [condition]
    without = tuple(signal for signal in SIGNALS if signal.variable != variable)
    absent, _ = read_row(Controller(), without)
    assert np.all(np.isnan(absent[COLUMN[variable]]))


@pytest.mark.parametrize("speeds", [{"speed_fraction": 0.5}, {"speed_scaling": 0.5, "speed_fraction": 1.0}, {"speed_scaling": math.inf}])
def test_a_slider_that_is_moved_during_a_replay_ends_it_whichever_variable_reports_it(speeds):
    """On a real controller target_speed_fraction is the slider, and speed_scaling is the trajectory limiter."""
    failure = state_failure(replace(SOUND, **speeds), SETTINGS)
    assert failure is not None
    assert failure.cause == "speed_scaling"


def test_a_payload_that_is_changed_during_a_replay_ends_it():
    """The condition must hold during the whole motion: the torque of another payload would be taken for friction."""
    heavier = replace(SOUND, payload_kg=2.0)
    assert state_failure(heavier, SETTINGS, 2.02) is None
    assert state_failure(heavier, SETTINGS) is None
    failure = state_failure(heavier, SETTINGS, 0.0)
    assert failure is not None
    assert failure.cause == "payload"
    assert ReplayAborted("…", failure.cause).needs_a_person


class AskedToStop:
    """An arm that was asked to stop; nothing else of it is looked at."""

    state, stop_cause = State(Phase.PLAY, Program.OURS, Order.STOP), "permit_withdrawn"


def test_nothing_begins_after_a_request_to_stop():
    """A request in the last 0.4 s of a phase lets that phase end as planned. The next does not begin, and the replay is no success."""
    with pytest.raises(stream.Stopped):
        stream.stream(AskedToStop(), Event.RETURN, 0.2, lambda _: ready_state().target_q)


def test_a_window_that_closes_during_the_announcement_or_the_wait_for_a_permit_closes():
    """Both may take ten minutes, so the conditions are checked again before the arm goes."""
    settings = replace(SIMULATED, windows_utc=("11:00-12:05",), announce_s=600.0)
    gate = Gate(inputs(settings=settings), ask=None, announce=None)
    clock = [NOON]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("monitor.acquire.safety.gate.time.time", lambda: clock[0])
        assert not gate.step(ready_state(), 0.0)
        clock[0] += 601.0
        with pytest.raises(MotionRefused, match="time_window: now is outside"):
            gate.step(ready_state(), 601.0)


def test_an_arm_that_is_driven_away_during_the_announcement_is_refused_before_it_goes():
    """The parent refuses it too, with the name of the condition."""
    gate = Gate(inputs(settings=replace(SIMULATED, announce_s=10.0)), ask=None, announce=None)
    assert not gate.step(ready_state(), 0.0)
    with pytest.raises(MotionRefused, match="no_other_program"):
        gate.step(ready_state(runtime_state=2), 10.0)


def test_the_way_to_the_start_and_back_must_fit_into_the_window_too():
    """2 rad each way at 0.5 rad/s, and 3 s of play: that is more than the 9 s that are left."""
    settings = replace(SIMULATED, windows_utc=("11:00-12:00",))
    late = {"settings": settings, "now_unix_s": NOON - 9.0}
    assert by_name(inputs(ready_state(), **late))["time_window"].holds
    far = ready_state(target_q=displaced(0, 2.0), q=displaced(0, 2.0))
    assert "the motion alone takes" in by_name(inputs(far, **late))["time_window"].text


def test_a_window_without_length_is_no_whole_day():
    """A window from 05:00 to 05:00 is refused by the settings."""
    with pytest.raises(BadInput, match=r"05:00-05:00.*00:00-24:00"):
        replace(SIMULATED, windows_utc=("05:00-05:00",))


@pytest.mark.parametrize("reason", ["stall", "kill"])
def test_a_protective_stop_that_the_child_did_not_see_is_the_cause_all_the_same(reason):
    """The child lost its data, or was killed, during a protective stop: those causes are harmless, but a person must check the arm."""
    host = "127.0.86.11"
    with simulated_arm(host), Remote(host) as remote:
        done = []

        def on_progress(progress):
            if progress.phase == "play" and progress.elapsed_s > 0.5 and not done:
                if reason == "stall":
                    remote.fault("stall", seconds=5)
                else:
                    os.kill(children()[0], signal.SIGKILL)
                remote.protective_stop()
                done.append(True)

        settings = replace(SIMULATED, host=host, approach_speed_rad_s=1.0)
        with pytest.raises(ReplayAborted) as aborted:
            replay(short(), load_robot("ur5"), settings, caller=Caller(on_progress=on_progress))
        assert done
        assert aborted.value.cause == "protective_stop"
        assert aborted.value.needs_a_person
        assert ("stalled" if reason == "stall" else "child_died") in str(aborted.value)
        assert remote.truth()["program"] is None
