"""The belief as a document: exact, checked when it is read, and carried over from older releases."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_arm import Arm, History, fresh, weather

from monitor.errors import BadInput
from monitor.judge.belief import belief_from_document
from monitor.judge.document import plain, typed
from monitor.recording import Array


def test_a_belief_read_from_json_gives_the_same_next_assessment():
    """Bit for bit, through JSON text and back."""

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
        ({"friction": {}}, "friction: is no state of the judge"),
        ({"friction": "AAAA"}, "friction: is no state of the judge"),
        ({"beside": {"slow": "nothing"}}, "beside: slow: is no state of the judge"),
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
    del document["usage"]["per_day"]
    with pytest.raises(BadInput, match="'per_day' is missing"):
        belief_from_document(document)


def test_a_belief_of_another_schema_is_refused_with_what_to_do():
    """It cannot be carried over; the message says how the history is kept."""
    with pytest.raises(BadInput, match=r"schema_version is 1; this release reads 7\. .*joint-monitor assess"):
        belief_from_document({**fresh().as_document(), "schema_version": 1})


class Course(NamedTuple):
    """Some friction over days."""

    nm: Annotated[Array, "N D"]
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Kept:
    """A value with every kind of field."""

    at: float
    count: int
    of_joint: Annotated[Array, "N"]
    course: Course
    state: Literal["sound", "worn"] = "sound"
    pairs: tuple[tuple[str, float], ...] = ()
    last: Course | None = None
    shares: Mapping[str, float] = field(default_factory=dict)


def kept(**changes):
    course = Course(np.array([[1.0, np.nan], [2.0, 3.0]]), ("a", "b"))
    values = {"at": 1.5, "count": 2, "of_joint": np.array([1.0, np.nan]), "course": course, "pairs": (("a", 1.0),), "shares": {"x": 0.5}}
    return Kept(**{**values, **changes})


@given(st.floats(allow_infinity=False), st.integers(-5, 5), st.lists(st.floats(allow_infinity=False, width=32), min_size=2, max_size=2))
def test_a_value_is_read_back_from_json_by_its_type(at, count, of_joint):
    """NaN goes as null; what is missing is refused, or has its default where a document need not be complete."""
    one = kept(at=at, count=count, of_joint=np.array(of_joint), last=Course(np.zeros((2, 2))))
    assert plain(typed(Kept, json.loads(json.dumps(plain(one))), where="kept")) == plain(one)
    document = plain(one)
    del document["shares"], document["state"]
    assert typed(Kept, document, where="kept", complete=False).state == "sound"
    with pytest.raises(BadInput, match="the key 'state' is missing"):
        typed(Kept, document, where="kept")


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        ({"of_joint": [1.0, 2.0, 3.0]}, r"kept: course: nm has shape \(2, 2\); expected \(N = 3, D\)"),
        ({"of_joint": 1.0}, r"kept: of_joint has shape \(\); expected \(N\)"),
        ({"of_joint": ["a", "b"]}, "kept: of_joint is not an array of numbers"),
        ({"course": {"names": []}}, "kept: course: the key 'nm' is missing"),
        ({"course": [1]}, "kept: course: expected a JSON object, not list"),
        ({"state": "broken"}, "kept: state is 'broken'; expected one of sound, worn"),
        ({"count": 1.5}, "kept: count is 1.5; expected int"),
        ({"count": True}, "kept: count is True; expected int"),
        ({"at": "soon"}, "kept: at is 'soon'; expected float"),
        ({"pairs": [["a"]]}, r"kept: pairs\[0\]: expected 2 entries, not 1"),
        ({"pairs": 3}, "kept: pairs: expected a list"),
        ({"shares": []}, "kept: shares: expected a JSON object"),
    ],
)
def test_what_is_wrong_in_a_document_is_named_with_its_place(spoil, says):
    """The key, what stands there, and what was expected."""
    with pytest.raises(BadInput, match=says):
        typed(Kept, {**plain(kept()), **spoil}, where="kept")
