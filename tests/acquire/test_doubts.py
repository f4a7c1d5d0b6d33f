"""What is doubtful speaks against a motion: garbage in a reported value, a slider told elsewhere, words that came too late."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from test_arm import SETTINGS, WELL
from test_guard import SIMULATED, facts, well

from monitor.acquire.arm import unwell
from monitor.acquire.conditions import Condition, Facts, conditions
from monitor.acquire.rows import PLACE, SIGNALS, snapshot
from monitor.acquire.state import arm_state


def named(known: Facts) -> dict[str, Condition]:
    return {condition.name: condition for condition in conditions(known)}


class Told:
    """What `snapshot` reads of a controller that reports everything: ones, but for what is given."""

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
def test_a_value_that_is_reported_and_is_garbage_does_not_pass_for_one_that_is_not_reported(variable, value, condition):
    """As the child reads it and as the parent judges it; only what is absent is "not checked"."""
    row, _ = snapshot(Told(**{variable: value}))
    state = arm_state(row)
    heard = replace(
        well(), speed_scaling=state.speed_scaling, speed_fraction=state.speed_fraction, payload_kg=state.payload_kg
    )  # both speeds and the payload are 1 in `well` too
    if condition == "gravity":
        heard = replace(heard, accelerometer_m_s2=state.accelerometer_m_s2)
    found = named(facts(heard))
    assert [name for name, each in found.items() if not each.holds] == [condition]
    without = tuple(signal for signal in SIGNALS if signal.variable != variable)
    absent, _ = snapshot(Told(), without)
    assert np.all(np.isnan(absent[PLACE[variable]]))


@pytest.mark.parametrize("speeds", [{"speed_fraction": 0.5}, {"speed_scaling": 0.5, "speed_fraction": 1.0}, {"speed_scaling": math.inf}])
def test_a_slider_that_is_moved_during_a_replay_ends_it_whichever_variable_tells_it(speeds):
    """On a real controller the slider is target_speed_fraction, and speed_scaling the trajectory limiter's own."""
    failure = unwell(replace(WELL, **speeds), SETTINGS)
    assert failure is not None
    assert failure.cause == "speed_scaling"
