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
from typing import Any, Protocol

from monitor.reason import JOINT_NAMES, OF_NO_LANGUAGE, Reason, Words, reason_at, reason_from
from monitor.recording import DAY_S

DOMAIN = "joint_monitor"
LANGUAGES = {"en": "English", "de": "Deutsch"}  # by their codes, in their own words; the first is that of the documents
CONTEXT = "\x04"  # gettext puts it between the context of a text and the text

N_ = str  # marks a text for the catalogue
NAMES = (  # how windows, alerts, causes and parts of the monitor are named in documents
    N_("assessed"), N_("skipped"), N_("rejected"), N_("aborted"), N_("started"), N_("recorded"), N_("scheduled"), N_("requested"),
    N_("imported"), N_("raised"), N_("updated"), N_("cleared"), N_("acknowledged"), N_("shelved"), N_("advisory"), N_("wear"),
    N_("limit"), N_("wear tier"), N_("ground"), N_("wall"), N_("ceiling"), N_("store"), N_("disk"), N_("clock"), N_("backup"),
    N_("router"), N_("Base"), N_("Shoulder"), N_("Elbow"), N_("Wrist 1"), N_("Wrist 2"), N_("Wrist 3"), N_("The arm"),
    N_("Joint {number}"), N_("joint {number}"), N_("scheduler"), N_("bus"), N_("listener"), N_("maintenance"), N_("previous_stop"),
    N_("robot_model"), N_("no_other_program"), N_("finite"), N_("stationary"), N_("motion_allowed"), N_("address"), N_("time_window"),
    N_("trajectory"), N_("trajectory_clear"), N_("drive_gains"), N_("tcp_speed"), N_("safety_planes"), N_("software"), N_("serial"),
    N_("services"), N_("joint_limits"), N_("remote_control"), N_("safety_mode"), N_("robot_mode"), N_("joints_running"), N_("teach_button"),
    N_("speed_scaling"), N_("payload"), N_("payload_cog"), N_("tcp_offset"), N_("gravity"), N_("approach_clear"), N_("temperatures"),
    N_("permit"), N_("torque_band"), N_("following_error"), N_("violation"), N_("fault"), N_("blue lids"), N_("blue lid screws"),
    N_("flat rings"), N_("robot cable"), N_("robot cable connection"), N_("robot arm mounting bolts"), N_("tool mounting bolts"),
    N_("screws and bolts on joints"), N_("monitor_silent"), N_("plant_silent"), N_("unacknowledged"), N_("unshelved"), N_("serviced"),
    N_("protective_stop"), N_("approach_near"), N_("look"), N_("acknowledge"), N_("move"), N_("configure"), N_("cold start"),
    N_("evidence"), N_("learning"), N_("every"), N_("cron"), N_("asked for"), N_("no permission"), N_("missed"),
    N_("stopping"), N_("playing"), N_("pausing"), N_("paused"), N_("resuming"), N_("unknown"), N_("no controller"), N_("disconnected"),
    N_("confirm safety"), N_("booting"), N_("power off"), N_("power on"), N_("idle"), N_("backdrive"), N_("running"),
    N_("updating firmware"), N_("normal"), N_("reduced"), N_("protective stop"), N_("recovery"), N_("safeguard stop"),
    N_("system emergency stop"), N_("robot emergency stop"), N_("reset"), N_("shutting down"), N_("part D calibration"), N_("back-drive"),
    N_("ready for power off"), N_("not responding"), N_("motor initialisation"), N_("part D calibration error"), N_("bootloader"),
    N_("calibration"), N_("later"), N_("earlier"), N_("grows"), N_("falls"), N_("time is in milliseconds"),
    N_("time is in microseconds"), N_("time is in nanoseconds"), N_("time is in units of 100 ns"), N_("time is in days"),
    N_("time is in hours"), N_("time is in minutes"), N_("missing temperature"),
    N_("speeds are the change of the positions"), N_("accelerations are the change of the speeds"), N_("the current is taken"),
    N_("the torque is taken"), N_("positions are in degrees"), N_("speeds are in degrees a second"),
    N_("accelerations are in degrees a second squared"), N_("current"), N_("torque"), N_("position"), N_("speed"), N_("acceleration"),
    N_("speed at the start"), N_("acceleration at the start"), N_("elbow"), N_("flange"), N_("TCP"), N_("joint_serials"),
    N_("emergency_stop"), N_("safeguard_stop"), N_("safety"), N_("all at once"), N_("little by little"),
)  # fmt: skip


class Says(Protocol):
    """A typed document with sentences."""

    def says(self, name: str) -> Reason | None:
        """The sentence under a key."""


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

    def at(self, document: Mapping[str, Any] | Says, key: str) -> str:
        """The sentence under a key of a document; empty where there is none."""
        reason = reason_at(document, key) if isinstance(document, Mapping) else document.says(key)
        return "" if reason is None else self.say(reason)

    def of(self, document: Mapping[str, Any]) -> str:
        """The sentence of an object that is a reason, or holds one."""
        return self.say(reason_from(document))

    def document(self, document: Any) -> Any:
        """A document with every reason in words: `text` of an object with a code, and each key of `reasons`; as it is in English."""
        if self.code == "en":
            return document
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


# --- Dates in words: the day, and the part of a month where a day would claim too much ------------------

# N_ marks a text for the catalogue
MONTHS = (
    N_("January"), N_("February"), N_("March"), N_("April"), N_("May"), N_("June"), N_("July"), N_("August"), N_("September"),
    N_("October"), N_("November"), N_("December"),
)  # fmt: skip
SOON_DAYS = 60.0  # a date that is nearer is given as a day
EARLY, MIDDLE = 10, 20  # the last days of the early and of the middle part of a month


def utc(unix_s: float) -> datetime:
    """The time in UTC."""
    return datetime.fromtimestamp(unix_s, UTC)


def day(unix_s: float, now_unix_s: float, say: Language) -> str:
    """A day, e.g. 7 June; with its year, unless that is the present one."""
    at = utc(unix_s)
    if at.year == utc(now_unix_s).year:
        return say.say("{day} {month}", day=at.day, month=say.say(MONTHS[at.month - 1]))
    return full_day(unix_s, say)


def full_day(unix_s: float, say: Language) -> str:
    """A day with its year, e.g. 7 June 2026."""
    at = utc(unix_s)
    return say.say("{day} {month} {year}", day=at.day, month=say.say(MONTHS[at.month - 1]), year=at.year)


def moment(unix_s: float, say: Language) -> str:
    """A day with its year and the time of day."""
    return f"{full_day(unix_s, say)}, {utc(unix_s):%H:%M}"


def month(unix_s: float, now_unix_s: float, say: Language) -> str:
    """A month, e.g. May; with its year, unless that is the present one."""
    at = utc(unix_s)
    name = say.say(MONTHS[at.month - 1])
    return name if at.year == utc(now_unix_s).year else f"{name} {at.year}"


def around(unix_s: float, now_unix_s: float, say: Language) -> str:
    """About when: a day where it is near, else the part of a month."""
    if abs(unix_s - now_unix_s) < SOON_DAYS * DAY_S:
        return say.say("around {day}", day=day(unix_s, now_unix_s, say))
    of, name = utc(unix_s).day, month(unix_s, now_unix_s, say)
    if of <= EARLY:
        return say.say("in early {month}", month=name)
    return say.say("in mid-{month}", month=name) if of <= MIDDLE else say.say("in late {month}", month=name)


def span(from_unix_s: float, to_unix_s: float | None, about_unix_s: float, now_unix_s: float, say: Language) -> str:
    """From when to when: days where they are near, else months; without an end it is open. Empty where both are the same month.

    about_unix_s : the date beside which it stands; a year is given where it is another one.
    """
    near = from_unix_s - now_unix_s < SOON_DAYS * DAY_S
    first = (day if near else month)(from_unix_s, about_unix_s, say)
    if to_unix_s is None:
        return say.say("{first} or later", first=first)
    last = (day if near and to_unix_s - now_unix_s < SOON_DAYS * DAY_S else month)(to_unix_s, about_unix_s, say)
    return "" if first == last else say.say("{first} to {last}", first=first, last=last)


def since(unix_s: float, now_unix_s: float, say: Language) -> str:
    """With what a change is compared: a day where it is near, else a month."""
    if now_unix_s - unix_s < SOON_DAYS * DAY_S:
        return say.say("on {day}", day=day(unix_s, now_unix_s, say))
    return say.say("in {month}", month=month(unix_s, now_unix_s, say))
