"""The belief as a document: exact, checked when it is read, and carried over from older releases."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import Arm, History, fresh, weather

from monitor.errors import BadInput
from monitor.judge.belief import belief_from_document
from monitor.judge.drift.filter_state import (
    ORDINARY,
    remember_warming,
    saturating,
)
from monitor.judge.temperature.laws import TemperatureSettings

LAWS = TemperatureSettings()


def test_a_belief_read_from_json_gives_the_same_next_assessment():
    """Bit for bit, through JSON text and back."""
    import json

    history, rng = History(), np.random.default_rng(2)
    for day in range(8):
        history.add(day, Arm(seed=day).replay(weather(day, rng)))
    kept = history.last.belief
    history.last = replace(history.last, belief=belief_from_document(json.loads(json.dumps(kept.as_document(), allow_nan=False))))
    there = history.add(8, Arm(seed=8).replay(28.0)).belief
    history.last = replace(history.last, belief=kept)
    straight = history.add(8, Arm(seed=8).replay(28.0)).belief
    assert json.dumps(there.as_document()) == json.dumps(straight.as_document())


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        ({"schema_version": 99}, "schema_version is 99"),
        ({"track": {}}, "track: the key"),
        ({"temperature_c": "much"}, "temperature_c is not an array"),
        ({"viscous": {}}, "viscous: the key"),
        ({"replays": "many"}, "many"),
    ],
)
def test_a_damaged_belief_is_refused_with_the_name_of_its_key(spoil, says):
    """No state is read in part: the message says what is wrong."""
    document = {**fresh().as_document(), **spoil}
    with pytest.raises(BadInput, match=says):
        belief_from_document(document)


def test_a_belief_without_a_key_is_refused():
    """The message names the missing key."""
    document = fresh().as_document()
    del document["track"]["noise_weight"]
    with pytest.raises(BadInput, match="'noise_weight' is missing"):
        belief_from_document(document)


def test_a_belief_of_another_schema_is_refused_with_what_to_do():
    """It cannot be carried over; the message says how the history is kept."""
    with pytest.raises(BadInput, match=r"schema_version is 1; this release reads 4\. .*joint-monitor assess"):
        belief_from_document({**fresh().as_document(), "schema_version": 1})


def test_a_belief_without_the_square_of_the_warming_rate_is_as_certain_as_it_was():
    """Releases before assumed that all replays warm alike; where no rate was known, the first one is the usual one from the start."""
    history, rng = History(), np.random.default_rng(2)
    for day in range(8):
        history.add(day, Arm(seed=day).replay(weather(day, rng)))
    document = history.last.belief.as_document()
    usual = np.linspace(0.0, 0.05, 6)  # joint 1: unknown
    document["track"]["usual_warming"] = usual.tolist()
    del document["track"]["warming_square"]
    state = belief_from_document(document).filter_state
    assert np.array_equal(state.usual_warming, usual)
    assert np.allclose(state.extrapolated, 1.0)
    state = replace(state, event=np.full(6, float(ORDINARY)), replays=np.full(6, 100.0))
    for _ in range(5):
        state = remember_warming(state, np.full(6, 0.05))
    assert np.isclose(state.extrapolated[0], 1.0)
    assert np.isclose(state.usual_warming[0], saturating(np.full(1, 0.05))[0])
