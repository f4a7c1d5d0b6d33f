"""What people read, in their language.

Texts of the views themselves have their English as the key of a translation. Sentences of documents are reasons (`monitor.reason`): the
catalogue has their translations under their codes, with the same places, and the parameters are filled in here. What has no translation
stays English.
"""

import gettext
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import lru_cache
from importlib.resources import files
from typing import Any

from monitor.reason import JOINT_NAMES, OF_NO_LANGUAGE, Reason, Words, reason_at, reason_from

DOMAIN = "joint_monitor"
LANGUAGES = {"en": "English", "de": "Deutsch"}  # by their codes, in their own words; the first is that of the documents
CONTEXT = "\x04"  # gettext puts it between the context of a text and the text

N_ = str  # marks a text for the catalogue
NAMES = (  # how windows, alerts, causes and parts of the monitor are named in documents
    N_("assessed"), N_("skipped"), N_("rejected"), N_("aborted"), N_("started"), N_("recorded"), N_("scheduled"), N_("manual"),
    N_("import"), N_("raised"), N_("updated"), N_("cleared"), N_("acknowledged"), N_("shelved"), N_("advisory"), N_("wear"),
    N_("limit"), N_("wear tier"), N_("ground"), N_("wall"), N_("ceiling"), N_("store"), N_("disk"), N_("clock"), N_("backup"),
    N_("router"), N_("Base"), N_("Shoulder"), N_("Elbow"), N_("Wrist 1"), N_("Wrist 2"), N_("Wrist 3"), N_("The arm"),
    N_("Joint {number}"), N_("joint {number}"), N_("scheduler"), N_("bus"), N_("listener"), N_("maintenance"), N_("previous_stop"),
    N_("robot_model"), N_("no_other_program"), N_("finite"), N_("stationary"), N_("motion_allowed"), N_("address"), N_("time_window"),
    N_("trajectory"), N_("trajectory_clear"), N_("drive_gains"), N_("tcp_speed"), N_("safety_planes"), N_("software"), N_("serial"),
    N_("joint_limits"), N_("remote_control"), N_("safety_mode"), N_("robot_mode"), N_("joints_running"), N_("teach_button"),
    N_("speed_scaling"), N_("payload"), N_("payload_cog"), N_("tcp_offset"), N_("gravity"), N_("approach_clear"), N_("temperatures"),
    N_("permit"), N_("torque_band"), N_("following_error"), N_("violation"), N_("fault"), N_("blue lids"), N_("blue lid screws"),
    N_("flat rings"), N_("robot cable"), N_("robot cable connection"), N_("robot arm mounting bolts"), N_("tool mounting bolts"),
    N_("screws and bolts on joints"), N_("monitor_silent"), N_("plant_silent"), N_("unacknowledged"), N_("unshelved"), N_("serviced"),
    N_("protective_stop"), N_("approach_near"), N_("look"), N_("acknowledge"), N_("move"), N_("configure"), N_("cold start"),
    N_("evidence"), N_("learning"), N_("every"), N_("cron"), N_("asked for"), N_("no permission"), N_("missed"),
)  # fmt: skip


class Language(Words):
    """One language. `code` is that of the HTML attribute lang."""

    def __init__(self, code: str, catalogue: Mapping[str, str], sentences: Mapping[str, str]) -> None:
        """`catalogue` holds the translation of each English text, `sentences` that of each code."""
        self.code, self.catalogue, self.sentences = code, catalogue, sentences

    def say(self, said: str | Reason, /, **values: object) -> str:
        """A reason, or a text of the views with `values` in its places, in this language."""
        if isinstance(said, Reason):
            return super().say(said)
        text = self.catalogue.get(said, said)
        return text.format(**values) if values else text

    def sentence(self, reason: Reason) -> str | None:
        """The sentence of the reason's code; None where this language has none."""
        return super().sentence(reason) if self.code == "en" or reason.code in OF_NO_LANGUAGE else self.sentences.get(reason.code)

    def joint(self, joint: int) -> str:
        """A joint (from 1) with its number, e.g. Elbow (joint 3)."""
        number = self.say("joint {number}", number=joint)
        return f"{self.name(joint)} ({number})" if 1 <= joint <= len(JOINT_NAMES) else number

    def name(self, joint: int | None) -> str:
        """The name of a joint (from 1) as PolyScope shows it in this language; None is the arm."""
        if joint is None:
            return self.say("The arm")
        return self.say(JOINT_NAMES[joint - 1]) if joint <= len(JOINT_NAMES) else self.say("Joint {number}", number=joint)

    def word(self, text: str) -> str:
        """A name of documents (a state, a condition, a cause) in words."""
        return self.catalogue.get(text) or text.replace("_", " ")

    def number(self, text: str) -> str:
        """A number of a sentence, with the signs of this language."""
        return text.replace(".", ",").replace("%", "\u00a0%") if self.code == "de" else text

    def day(self, unix_s: float) -> str:
        """A UTC day."""
        return f"{datetime.fromtimestamp(unix_s, UTC):%d.%m.%Y}" if self.code == "de" else super().day(unix_s)

    def time(self, unix_s: float) -> str:
        """A UTC time to the minute."""
        return f"{datetime.fromtimestamp(unix_s, UTC):%d.%m.%Y, %H:%M} UTC" if self.code == "de" else super().time(unix_s)

    def figure(self, value: float, digits: int = 1, *, signed: bool = False) -> str:
        """A figure with the decimal sign of this language; zero has no sign."""
        text = f"{value:{'+' if signed else ''}z.{digits}f}"
        if signed and not text.strip("+-0."):
            text = text.lstrip("+-")
        return self.number(text.replace("-", "\u2212"))

    def percent(self, fraction: float, digits: int = 0, *, signed: bool = False) -> str:
        """A fraction in per cent, with a space that no line is broken at."""
        return f"{self.figure(100 * fraction, digits, signed=signed)}\u00a0%"

    def at(self, document: Mapping[str, Any], key: str) -> str:
        """The sentence under a key of a document; empty where there is none."""
        reason = reason_at(document, key)
        return "" if reason is None else self.say(reason)

    def of(self, document: Mapping[str, Any]) -> str:
        """The sentence of an object that is a reason, or holds one."""
        return self.say(reason_from(document))

    def document(self, document: Any) -> Any:
        """A document with every reason in words: `text` of an object with a code, and each key of `reasons`."""
        if isinstance(document, list):
            return [self.document(each) for each in document]
        if not isinstance(document, Mapping):
            return document
        words = {key: each if key in ("reasons", "parameters") else self.document(each) for key, each in document.items()}
        if "text" in document and isinstance(document.get("parameters"), Mapping) and isinstance(document.get("code"), str):
            words["text"] = self.of(document)
        if isinstance(reasons := document.get("reasons"), Mapping):
            words |= {key: self.at(document, key) for key in reasons if document.get(key) is not None}
        return words


@lru_cache
def language(code: str) -> Language:
    """The language of a code; English where there is no such catalogue."""
    if code not in LANGUAGES or code == "en":
        return Language("en", {}, {})
    with files("monitor.views.language").joinpath("locale", code, "LC_MESSAGES", f"{DOMAIN}.mo").open("rb") as file:
        catalogue = gettext.GNUTranslations(file)
    found: Mapping[Any, str] = catalogue._catalog  # type: ignore[attr-defined]  # gettext lists its texts nowhere else
    known = {key: text for key, text in found.items() if isinstance(key, str) and key and text}
    sentences = {key.partition(CONTEXT)[0]: text for key, text in known.items() if CONTEXT in key}
    return Language(code, {key: text for key, text in known.items() if CONTEXT not in key}, sentences)


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
