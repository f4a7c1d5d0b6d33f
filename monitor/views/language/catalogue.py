"""What people read, in their language. The English text is the key of a translation; a text without one stays English.

Documents of the bus and of the history are English. `retell` finds which known sentence a text of theirs is, and says it in another
language: so texts that an earlier version stored are translated too, and the judge knows of no language.
"""

import gettext
import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib.resources import files
from typing import Any

from monitor.reason import JOINT_NAMES

DOMAIN = "joint_monitor"
LANGUAGES = {"en": "English", "de": "Deutsch"}  # by their codes, in their own words; the first is that of the documents
LONGEST = 700  # letters of a sentence that may be a known one: the patterns take long for a longer text
_PLACE = re.compile(r"\{(\w+)\}")
_JOINT = re.compile(rf"\b({'|'.join(JOINT_NAMES)})\b(?: \(joint (\d)\))?")
_FIGURE = re.compile(r"(?<![\w.])([+-]?\d+)\.(\d+)(?![\w.]*\d)")
_DATE = re.compile(r"(?<!\d)(\d{4})-(\d\d)-(\d\d)(?!\d)(?:T(\d\d):(\d\d)(?::\d\d)?(?:\.\d+)?(?:Z|\+00:00)?)?")
_STATED = re.compile(r"([a-z]+(?:_[a-z0-9]+)*) \((\w+)\)(: .+)?", re.DOTALL)  # a condition, the tier of its alert, the change
_NAMED = re.compile(r"([a-z]+(?:_[a-z0-9]+)*): (.+)", re.DOTALL)  # a reason with the name of its cause
_SENTENCES = (re.compile(r"(?<=[.!?]) (?=[A-Z])"), re.compile(r"; "))
RETOLD = frozenset(  # keys of documents whose value is a sentence for people
    {"text", "why", "action", "stale_why", "assumption", "reason", "told", "next_replay_why", "verdict_text", "tries", "stops"}
)
NOT_RETOLD = frozenset({"acknowledged_why", "shelved_why"})  # what a person wrote stays as it is
WHOLE = frozenset({"who", "reason", "text"})  # places that may hold several sentences
SPOKEN = frozenset({"who", "reason"})  # places of a sentence with the words of a person


class Language:
    """One language. `code` is that of the HTML attribute lang."""

    def __init__(self, code: str, catalogue: Mapping[str, str]) -> None:
        """`catalogue` holds the translation of each English text."""
        self.code, self.catalogue = code, catalogue
        # the most specific sentence first: that with most letters of its own
        templates = sorted((text for text in catalogue if "{" in text), key=lambda text: -len(_PLACE.sub("", text)))
        self._patterns = [(_pattern(text), text) for text in templates if len(_PLACE.sub("", text).strip()) > 2]
        self.retell = lru_cache(4096)(self._retell)

    def say(self, text: str, /, **values: object) -> str:
        """The text in this language, with `values` in its places."""
        said = self.catalogue.get(text, text)
        return said.format(**values) if values else said

    def joint(self, joint: int | None) -> str:
        """The name of a joint (from 1) as PolyScope shows it in this language; None is the arm."""
        if joint is None:
            return self.say("The arm")
        return self.say(JOINT_NAMES[joint - 1]) if joint <= len(JOINT_NAMES) else self.say("Joint {number}", number=joint)

    def figure(self, value: float, digits: int = 1, *, signed: bool = False) -> str:
        """A figure with the decimal sign of this language; zero has no sign."""
        text = f"{value:{'+' if signed else ''}z.{digits}f}"
        if signed and not text.strip("+-0."):
            text = text.lstrip("+-")
        text = text.replace("-", "\u2212")
        return text.replace(".", ",") if self.code == "de" else text

    def percent(self, fraction: float, digits: int = 0, *, signed: bool = False) -> str:
        """A fraction in per cent, with a space that no line is broken at."""
        return f"{self.figure(100 * fraction, digits, signed=signed)}\u00a0%"

    def _retell(self, text: str) -> str:
        """A text of a document in this language; parts that are not known stay English."""
        if self.code == "en" or not text:
            return text.replace("_", " ") if _is_name(text) else text
        plain = text.strip()
        if plain in self.catalogue:
            return self.catalogue[plain]
        for pattern, template in self._patterns if len(plain) <= LONGEST else ():
            found = pattern.fullmatch(plain)
            if found is not None and not _runs_on(found.groupdict()):
                places = found.groupdict()
                said = {name: value if name in SPOKEN else self._retell(value) for name, value in places.items()}
                return self.catalogue[template].format(**said)
        stated = _STATED.fullmatch(plain)
        if stated is not None and stated[1] in self.catalogue:
            return f"{self._retell(stated[1])} ({self._retell(stated[2])}){self._retell(stated[3] or '')}"
        named = _NAMED.fullmatch(plain)
        if named is not None and ("_" in named[1] or named[1] in self.catalogue):
            return f"{self._retell(named[1])}: {self._retell(named[2])}"
        for splitter in _SENTENCES:
            parts = splitter.split(plain)
            if len(parts) > 1:
                joint = " " if splitter is _SENTENCES[0] else "; "
                return joint.join(map(self._retell, parts))
        return self._figures(_JOINT.sub(self._joint_text, plain))

    def _joint_text(self, found: re.Match[str]) -> str:
        """The name of a joint, with its number where the text has it."""
        name = self.say(found[1])
        return name if found[2] is None else f"{name} ({self.say('joint {number}', number=found[2])})"

    def _figures(self, text: str) -> str:
        """Decimal signs, dates and per cent signs as this language has them."""
        text = text.replace("_", " ") if _is_name(text) else text
        text = _DATE.sub(lambda at: f"{at[3]}.{at[2]}.{at[1]}{f', {at[4]}:{at[5]}' if at[4] else ''}", text)
        return re.sub(r"(?<=\d)%", "\u00a0%", _FIGURE.sub(r"\1,\2", text))

    def document(self, document: Any) -> Any:
        """A document with every sentence for people retold; what a person wrote stays."""
        if isinstance(document, Mapping):
            return {
                key: self._texts(value) if key in RETOLD and key not in NOT_RETOLD else self.document(value)
                for key, value in document.items()
            }
        return [self.document(each) for each in document] if isinstance(document, list) else document

    def _texts(self, value: Any) -> Any:
        if isinstance(value, str):
            return self.retell(value)
        return [self._texts(each) for each in value] if isinstance(value, list) else self.document(value)


def _pattern(text: str) -> re.Pattern[str]:
    """A pattern that a text matches where it is this sentence. A place that comes twice must hold the same both times."""
    seen: set[str] = set()

    def place(name: str) -> str:
        if name in seen:
            return f"(?P={name})"
        seen.add(name)
        return f"(?P<{name}>.+?)"

    parts = _PLACE.split(text)
    return re.compile("".join(place(part) if k % 2 else re.escape(part) for k, part in enumerate(parts)), re.DOTALL)


def _runs_on(places: Mapping[str, str]) -> bool:
    """Whether a place has swallowed the end of its sentence and the begin of the next one."""
    return any(name not in WHOLE and _SENTENCES[0].search(value) for name, value in places.items())


def _is_name(text: str) -> bool:
    """Whether the text is the name of a condition, a state or a cause."""
    return re.fullmatch(r"[a-z]+(_[a-z0-9]+)+", text) is not None


@lru_cache
def language(code: str) -> Language:
    """The language of a code; English where there is no such catalogue."""
    if code not in LANGUAGES or code == "en":
        return Language("en", {})
    with files("monitor.views.language").joinpath("locale", code, "LC_MESSAGES", f"{DOMAIN}.mo").open("rb") as file:
        catalogue = gettext.GNUTranslations(file)
    texts: Mapping[Any, str] = catalogue._catalog  # type: ignore[attr-defined]  # gettext lists its texts nowhere else
    return Language(code, {key: value for key, value in texts.items() if isinstance(key, str) and key and value})


ENGLISH = language("en")


def best_language(accepted: str, setting: str = "browser") -> str:
    """The code of the language to answer in. accepted : the header Accept-Language; setting : [page] language."""
    if setting in LANGUAGES:
        return setting
    return next((code for code in _by_preference(accepted) if code in LANGUAGES), "en")


def _by_preference(accepted: str) -> Iterable[str]:
    """The languages of the header, the best first, without their countries (RFC 9110, 12.5.4)."""
    rated: list[tuple[float, int, str]] = []
    for part in accepted.split(",")[:20]:
        name, _, quality = part.partition(";")
        try:
            weight = float(quality.strip().removeprefix("q=") or 1.0)
        except ValueError:
            weight = 0.0
        if weight > 0:
            rated.append((-weight, len(rated), name.strip().lower().partition("-")[0]))
    return (name for *_, name in sorted(rated))
