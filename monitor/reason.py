"""A condition, reason, refusal or warning as a value: a code with parameters. Its sentence is made at the edge, in the reader's words.

    HOT = Sentence("temperatures", "{joint:joint} is at {temperature_c:.1f} °C; allowed are {low_c:g} to {high_c:g} °C")
    HOT(joint=3, temperature_c=61.2, low_c=0, high_c=50).text  # Elbow (joint 3) is at 61.2 °C; allowed are 0 to 50 °C

A sentence stands beside the code that finds it, and each code has one. Documents carry `code`, `parameters` and the English `text`; views
look the code up in a catalogue and fill the same parameters into the sentence of another language. No code reads a sentence.

An object of a document that is one reason is `Reason.document()`. An object with sentences under keys of its own keeps the English there,
and has their codes and parameters under `reasons`: {"action": "Inspect it.", "reasons": {"action": {"code": "inspect", "parameters": {}}}}.
"""

import math
import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Union

JOINT_NAMES = ("Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3")  # as PolyScope shows joints 1 to 6; this table is the only one
Parameter = Union[str, int, float, bool, None, "Reason", tuple["Parameter", ...]]
SENTENCES: dict[str, str] = {}  # code → its English sentence, of every module that was imported
FREE = "free"  # the code of a text that has no code of its own: another program's words, a person's


def joint_name(joint: int) -> str:
    """The name of a joint (from 1), e.g. Elbow; "Joint 7" beyond the table."""
    return JOINT_NAMES[joint - 1] if 1 <= joint <= len(JOINT_NAMES) else f"Joint {joint}"


def joint_text(joint: int) -> str:
    """The name of a joint (from 1) with its number, by which commands address it, e.g. "Elbow (joint 3)"."""
    return f"{joint_name(joint)} (joint {joint})" if 1 <= joint <= len(JOINT_NAMES) else f"joint {joint}"


class Words:
    """How one language words the parts of a sentence; this one is English. A subclass is another language."""

    def sentence(self, reason: "Reason") -> str | None:
        """The sentence of the reason's code with its places; None where this language has none."""
        return SENTENCES.get(reason.code)

    def joint(self, joint: int) -> str:
        """A joint (from 1)."""
        return joint_text(joint)

    def name(self, joint: int) -> str:
        """A joint (from 1) without its number."""
        return joint_name(joint)

    def number(self, text: str) -> str:
        """A number, formatted as in English."""
        return text

    def word(self, text: str) -> str:
        """A word that is one of a few, such as the name of a state."""
        return text

    def day(self, unix_s: float) -> str:
        """A UTC day: 2026-11-21."""
        return _moment(unix_s, "D")

    def time(self, unix_s: float) -> str:
        """A UTC time to the minute: 2026-11-21 03:00 UTC."""
        return f"{_moment(unix_s, 'm').replace('T', ' ')} UTC"

    def say(self, reason: "Reason", /) -> str:
        """The whole sentence. A reason of a code that this language does not know stays in English."""
        template = self.sentence(reason)
        if template is None:
            return reason.text
        return _Filler(self).vformat(template, (), reason.parameters)


ENGLISH = Words()


@dataclass(frozen=True, slots=True)
class Reason:
    """A code with its parameters; `english` is the text where another process made it, which may know sentences that this one does not."""

    code: str
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    english: str | None = field(default=None, compare=False)

    @property
    def text(self) -> str:
        """The English sentence."""
        return self.english if self.english is not None else ENGLISH.say(self) if self.code in SENTENCES else self.code.replace("_", " ")

    def __str__(self) -> str:
        return self.text

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled with its English: the process that reads it may not have imported the module of its sentence."""
        return Reason, (self.code, self.parameters, self.text)

    def document(self) -> dict[str, Any]:
        """As JSON: code, parameters, and the English text for whoever knows no codes."""
        return {**self.coded(), "text": self.text}

    def coded(self) -> dict[str, Any]:
        """As JSON without the text, which stands beside it."""
        return {"code": self.code, "parameters": {name: _plain(value) for name, value in self.parameters.items()}}


@dataclass(frozen=True, slots=True)
class Sentence:
    """The one sentence of a code. A place takes a format of Python, or `joint`, `joints`, `day`, `time`, `word`, `each` (see `_Filler`)."""

    code: str
    text: str

    def __post_init__(self) -> None:
        if SENTENCES.setdefault(self.code, self.text) != self.text:
            raise ValueError(f"code {self.code!r} has a sentence already: {SENTENCES[self.code]!r}")

    def __call__(self, **parameters: Any) -> Reason:
        """The reason with these parameters. Raises TypeError unless they are the sentence's places."""
        places = {name for _, name, _, _ in string.Formatter().parse(self.text) if name}
        if not places <= parameters.keys():
            raise TypeError(f"{self.code} needs {', '.join(sorted(places - parameters.keys()))}")
        return Reason(self.code, {name: _parameter(value) for name, value in parameters.items()})


ANYTHING = Sentence(FREE, "{text}")
SEVERAL = Sentence("several", "{reasons:each}")
INTERNAL = Sentence("internal", "internal: {error}: {text}")  # a fault of this program
ONE_JOINT, SEVERAL_JOINTS = Sentence("joint_by_number", "joint {joint}"), Sentence("joints_by_number", "joints {joints}")
OF_NO_LANGUAGE = frozenset({FREE, SEVERAL.code})  # sentences without a word of their own: every language has them


def reason_of(said: "str | Reason") -> Reason:
    """A reason as it is; a text as a reason without a code of its own."""
    return said if isinstance(said, Reason) else ANYTHING(text=said)


def joints_by_number(joints: Sequence[int]) -> Reason:
    """Joints (from 1) by their numbers alone, as a part of a sentence."""
    return SEVERAL_JOINTS(joints=joints) if len(joints) > 1 else ONE_JOINT(joint=joints[0])


def together(*reasons: Reason | None) -> Reason:
    """Several sentences, one after the other; None is left out."""
    parts = [part for reason in reasons if reason is not None for part in parts_of(reason)]
    return parts[0] if len(parts) == 1 else SEVERAL(reasons=parts)


def parts_of(reason: Reason) -> tuple[Reason, ...]:
    """The sentences of `together`; the reason itself where it is a single one."""
    if reason.code != SEVERAL.code:
        return (reason,)
    parts = reason.parameters["reasons"]
    return tuple(part for part in parts if isinstance(part, Reason)) if isinstance(parts, tuple) else ()


def with_reasons(document: Mapping[str, Any], **reasons: Reason | None) -> dict[str, Any]:
    """The document with the English text of each reason under its key, and with its code and parameters under `reasons`."""
    texts = {key: None if reason is None else reason.text for key, reason in reasons.items()}
    coded = {key: reason.coded() for key, reason in reasons.items() if reason is not None}
    return {**document, **texts, "reasons": {**document.get("reasons", {}), **coded}}


def reason_at(document: Mapping[str, Any], key: str) -> Reason | None:
    """The reason under a key of a document of `with_reasons`; None where the text is null or not there."""
    text = document.get(key)
    coded = (document.get("reasons") or {}).get(key)
    if text is None or coded is None:
        return None if text is None else reason_of(text)
    return reason_from({**coded, "text": text})


def reason_from(document: Mapping[str, Any]) -> Reason:
    """The reason of a JSON document that `Reason.document` made, here or in another process."""
    parameters = {name: _back(value) for name, value in document["parameters"].items()}
    return Reason(document["code"], parameters, document.get("text"))


class _Filler(string.Formatter):
    """Fills the places of a sentence in a language.

    joint, joints : a joint (from 1) with its number; name : its name alone. day, time : of seconds since 1970. word : a word of a few that
    is translated. each : several reasons or texts, one after the other with a space; several of anything else have commas between. Else
    the format of Python.
    """

    def __init__(self, words: Words) -> None:
        self._words = words

    def format_field(self, value: Any, format_spec: str) -> str:
        words = self._words
        if isinstance(value, tuple | list) and format_spec != "each":
            return ", ".join(self.format_field(each, format_spec) for each in value)
        match format_spec:
            case "joint" | "joints":
                return words.joint(int(value))
            case "name":
                return words.name(int(value))
            case "day":
                return words.day(value)
            case "time":
                return words.time(value)
            case "word":
                return words.word(str(value))
            case "each":
                return " ".join(self.format_field(each, "") for each in value)
        if isinstance(value, Reason):
            return words.say(value)
        if isinstance(value, int | float) and not isinstance(value, bool):
            return words.number(format(value, format_spec))
        return format(str(value), format_spec)


def _moment(unix_s: float, unit: Literal["D", "m"]) -> str:
    """A UTC time as ISO 8601, to the day or the minute."""
    import numpy as np  # slow to import, and `--help` says no time

    return str(np.datetime64(math.floor(unix_s), "s").astype(f"datetime64[{unit}]"))


def _parameter(value: Any) -> Parameter:
    """A parameter as JSON can carry it: numpy's numbers and lists become Python's."""
    if hasattr(value, "tolist"):  # of numpy, which a command that only prints its help does not import
        value = value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_parameter(each) for each in value)
    if value is None or isinstance(value, str | int | float | Reason):
        return value
    raise TypeError(f"{value!r} is no parameter of a reason: text, numbers, reasons and lists of these are")


def _plain(value: Parameter) -> Any:
    if isinstance(value, Reason):
        return value.document()
    return [_plain(each) for each in value] if isinstance(value, tuple) else value


def _back(value: Any) -> Parameter:
    if isinstance(value, Mapping):
        return reason_from(value)
    return tuple(_back(each) for each in value) if isinstance(value, list) else value
