"""A reason is a code with parameters; its sentence is made at the edge."""

import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.reason import SENTENCES, Reason, Sentence, Words, parts_of, reason_at, reason_from, reason_of, together, with_reasons

HOT = Sentence("test_hot", "{joint:joint} is at {temperature_c:.1f} °C since {since_unix_s:day}")
BOTH = Sentence("test_both", "{first}; {others:each}")


class Comma(Words):
    """A language with another decimal sign and one sentence of its own."""

    def sentence(self, reason):
        return {"test_hot": "{since_unix_s:day}: Gelenk {joint:joint} {temperature_c:.1f} °C"}.get(reason.code)

    def number(self, text):
        return text.replace(".", ",")


def test_a_sentence_is_filled_with_its_parameters():
    """Numbers by Python's format, joints by name, times as days."""
    reason = HOT(joint=3, temperature_c=np.float64(61.25), since_unix_s=86_400)
    assert reason.text == str(reason) == "Elbow (joint 3) is at 61.2 °C since 1970-01-02"
    assert reason.parameters == {"joint": 3, "temperature_c": 61.25, "since_unix_s": 86_400}


def test_another_language_words_the_same_parameters():
    """A code that the language does not know stays in English, also inside of another reason."""
    hot = HOT(joint=3, temperature_c=61.2, since_unix_s=0)
    assert Comma().say(hot) == "1970-01-01: Gelenk Elbow (joint 3) 61,2 °C"
    assert Comma().say(BOTH(first=hot, others=["a", "b"])) == "Elbow (joint 3) is at 61.2 °C since 1970-01-01; a b"


def test_a_reason_survives_json_and_a_reader_that_does_not_know_its_code():
    """Nested reasons too; the English text goes with it."""
    told = BOTH(first=HOT(joint=1, temperature_c=1.0, since_unix_s=0), others=("x", "y")).document()
    back = reason_from(json.loads(json.dumps(told)))
    assert back.document() == told
    assert Reason("unknown_code", {}, "somebody said it").text == "somebody said it"
    assert reason_of("plain words").text == "plain words"


def test_a_reason_survives_pickling_and_a_process_that_did_not_import_its_module(monkeypatch):
    """As what a daemon's child has found, which alone loads what judges: with every figure, the parts of a sentence too."""
    reason = BOTH(first=HOT(joint=3, temperature_c=61.25, since_unix_s=0.0), others=["later"])
    data, text = pickle.dumps(reason), reason.text
    for code in ("test_both", "test_hot"):
        monkeypatch.delitem(SENTENCES, code)
    assert pickle.loads(data).text == text
    assert pickle.loads(data).parameters["first"].text == "Elbow (joint 3) is at 61.2 °C since 1970-01-01"
    assert pickle.loads(data) == reason


def test_what_is_missing_and_what_is_no_parameter_is_refused_where_the_reason_is_made():
    """Not later, where somebody reads it."""
    with pytest.raises(TypeError, match="test_hot needs joint, since_unix_s"):
        HOT(temperature_c=1.0)
    with pytest.raises(TypeError, match="no parameter"):
        BOTH(first=object(), others=())
    with pytest.raises(ValueError, match="has a sentence already"):
        Sentence("test_hot", "something else")


@given(st.text(), st.lists(st.text()))
def test_braces_in_parameters_are_words_and_no_places(first, others):
    """What a person wrote is never read as a format."""
    assert BOTH(first=first, others=others).text == f"{first}; {' '.join(others)}"


def test_sentences_stand_under_their_keys_with_codes_beside_and_come_back():
    """English where it always was, code and parameters under `reasons`; what is null stays null."""
    hot = HOT(joint=3, temperature_c=61.2, since_unix_s=0)
    document = json.loads(json.dumps(with_reasons({"tier": "wear"}, why=together(hot, None, reason_of("x")), action=None)))
    assert (document["tier"], document["action"], document["why"]) == ("wear", None, f"{hot.text} x")
    assert reason_at(document, "action") is reason_at(document, "nothing") is None
    back = reason_at(document, "why")
    assert back == together(hot, reason_of("x"))
    assert parts_of(back)[0] == hot
    assert reason_at({"why": "plain words"}, "why") == reason_of("plain words")
    assert together(None, hot) == hot
    assert parts_of(hot) == (hot,)
