"""What a message says: a subject that decides, a sentence for each transition, what to do, and a link. No I/O, no clock."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any
from zoneinfo import ZoneInfo

from monitor.gateway.notify.routing import ALREADY, ESCALATION, FLEET
from monitor.gateway.values import ACTIVE, CLEARED, ENDED, GRAVER, MILDER, RAISED, gravity, page_of
from monitor.views.alert_sentence import JointPast, sentences
from monitor.views.language.catalogue import Language

N_ = str  # marks a text for the catalogue
LISTED = 50  # transitions that a message tells in full; of each further one it has a line
TIERS = {"advisory": N_("advisory"), "wear": N_("wear"), "limit": N_("limit")}
KINDS = {
    RAISED: N_("raised"),
    GRAVER: N_("graver than before"),
    MILDER: N_("milder than before"),
    CLEARED: N_("over"),
    ACTIVE: N_("active already"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """One message, for every way."""

    name: str  # the same one where it is sent again
    kind: str
    recipient: str
    subject: str
    text: str
    made_at_unix_s: float
    transitions: tuple[Mapping[str, Any], ...] = ()
    attachments: tuple[tuple[str, str, str], ...] = field(default=())  # name, subtype of text/, content


def alert_message(
    kind: str, transitions: Sequence[Mapping[str, Any]], say: Language, zone: ZoneInfo, link: str, escalate_days: float = 0.0
) -> tuple[str, str]:
    """Subject and text about these transitions, the gravest first."""
    ordered = sorted(transitions, key=lambda each: (each["kind"] == CLEARED, -gravity(str(each["tier"])), each["site"], each["robot"]))
    arms = list(dict.fromkeys(f"{each['site']}/{each['robot']}" for each in ordered))
    first = ordered[0]
    if kind == FLEET:
        condition = say.word(str(first["condition"]))
        subject = say.say("{count} arms, one cause? {condition}", count=len(arms), condition=condition)
        opening = say.say(
            "The same has come to {count} arms: look first for what they share (temperature, supply, a common change). "
            "Of this condition you get at most one message a day.",
            count=len(arms),
        )
    elif kind == ESCALATION:
        subject = say.say("Nobody has acknowledged: {what}", what=_title(first, say, len(ordered)))
        opening = say.say("Nobody has acknowledged this for {days} days.", days=f"{escalate_days:g}")
    elif kind == ALREADY:
        subject = say.say("Active already: {what}", what=_title(first, say, len(ordered)))
        opening = say.say(
            "This was raised before anybody could be told, and nobody has acknowledged it. From now on you are told of changes."
        )
    else:
        subject, opening = _title(first, say, len(ordered)), ""
    parts = [opening] if opening else []
    parts += ["\n".join(_paragraph(each, say, zone, link)) for each in ordered[:LISTED]]
    if len(ordered) > LISTED:  # nobody reads so many, and nothing may be missing
        parts.append("\n".join(_line(each, say, zone) for each in ordered[LISTED:]))
    if link and len(arms) > 1:
        parts.append(say.say("All arms: {link}", link=f"{link}/"))
    return one_line(subject), "\n\n".join(parts) + "\n"


def _title(first: Mapping[str, Any], say: Language, count: int) -> str:
    mark = say.say(TIERS.get(first["tier"], first["tier"])) if first["kind"] != CLEARED else say.say("over")
    title = f"[{mark}] {first['site']}/{first['robot']}: {headline(first, say)}"
    return title if count == 1 else say.say("{title} (and {count} more)", title=title, count=count - 1)


def headline(transition: Mapping[str, Any], say: Language) -> str:
    """The sentence that an alert leads with; the arm's own text where its document lacks what that needs."""
    return _sentences(transition, say)[0]


def _sentences(transition: Mapping[str, Any], say: Language) -> tuple[str, str]:
    """What is the case, and what to do."""
    event = {"active": transition["after"] != ENDED, "action": "", "text": "", **transition["event"]}
    try:
        found = sentences(event, JointPast(), float(transition["at_unix_s"]), say)
    except (KeyError, TypeError, ValueError):
        return say.at(event, "text") or say.word(str(transition["condition"])), say.at(event, "action")
    return found.headline, found.due


def _paragraph(each: Mapping[str, Any], say: Language, zone: ZoneInfo, link: str) -> Iterable[str]:
    what, action = _sentences(each, say)
    yield f"{each['site']}/{each['robot']}: {what}"
    tier = say.say(TIERS.get(each["tier"], each["tier"]))
    kind = say.say(KINDS.get(each["kind"], each["kind"]))
    yield say.say("Tier {tier}, {kind}, {at}.", tier=tier, kind=kind, at=local(float(each["at_unix_s"]), zone))
    text = say.at({"text": each["text"], **each["event"]}, "text")
    if text and text != what:
        yield text
    if action and each["kind"] != CLEARED:
        yield say.say("To do: {action}", action=action)
    if page := page_of(link, each["site"], each["robot"], each["condition"]):
        yield page


def _line(each: Mapping[str, Any], say: Language, zone: ZoneInfo) -> str:
    tier, kind = say.say(TIERS.get(each["tier"], each["tier"])), say.say(KINDS.get(each["kind"], each["kind"]))
    return f"{each['site']}/{each['robot']}: {_sentences(each, say)[0]} [{tier}, {kind}, {local(float(each['at_unix_s']), zone)}]"


def local(unix_s: float, zone: ZoneInfo) -> str:
    """A time as clocks of the time zone show it."""
    return f"{datetime.fromtimestamp(unix_s, zone):%Y-%m-%d %H:%M %Z}"


def one_line(text: str) -> str:
    """The text without line ends and control letters: it stands in a header."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())[:200]
