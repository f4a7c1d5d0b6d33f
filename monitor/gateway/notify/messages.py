"""What a message says: a subject that decides, a sentence for each transition, what to do, and a link. No I/O, no clock."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

from monitor import __version__
from monitor.config.notify import NotifySettings, RecipientSettings, time_of_day
from monitor.gateway.channel import Surroundings
from monitor.gateway.notify.routing import ALREADY, ESCALATION, FLEET, REPORT, Route
from monitor.gateway.outbox import Owed
from monitor.gateway.values import ACTIVE, CLEARED, GRAVER, MILDER, RAISED, Delivery, Transition, page_of
from monitor.plant.arm import HeardArm, worst_first
from monitor.publish.documents import Alert
from monitor.publish.shown import TIER_WORDS, Grade, Person, gravest_first, person, tier_gravity
from monitor.views.alert_sentence import JointPast, Sentences, deciding, sentences
from monitor.views.language.catalogue import Language, full_day, moment
from monitor.views.report.alerts import chip
from monitor.views.report.html import Markup, escaped, heading, page, paragraph, table

N_ = str  # marks a text for the catalogue
LISTED = 50  # transitions that a message tells in full; of each further one it has a line
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
    kind: str, transitions: Sequence[Transition], say: Language, zone: ZoneInfo, link: str, escalate_days: float = 0.0
) -> tuple[str, str]:
    """Subject and text about these transitions, the gravest first; what has come and gone meanwhile is over."""
    over = {each.alert_id for each in transitions if each.kind == CLEARED}
    ordered = sorted(transitions, key=lambda each: (each.alert_id in over, -tier_gravity(each.tier), each.arm))
    title = _title(ordered[0], say, len({each.alert_id for each in ordered}), over)
    arms = list(dict.fromkeys(each.arm for each in ordered))
    first = ordered[0]
    if kind == FLEET:
        subject = say.say("{count} arms, one cause? {condition}", count=len(arms), condition=say.word(first.condition))
        opening = say.say(
            "The same has come to {count} arms: look first for what they share (temperature, supply, a common change). "
            "Of this condition you get at most one message a day.",
            count=len(arms),
        )
    elif kind == ESCALATION:
        subject = say.say("Nobody has acknowledged: {what}", what=title)
        opening = say.say("Nobody has acknowledged this for {days} days.", days=f"{escalate_days:g}")
    elif kind == ALREADY:
        subject = say.say("Active already: {what}", what=title)
        opening = say.say(
            "This was raised before anybody could be told, and nobody has acknowledged it. From now on you are told of changes."
        )
    else:
        subject, opening = title, ""
    parts = [opening] if opening else []
    parts += ["\n".join(_paragraph(each, say, zone, link, over)) for each in ordered[:LISTED]]
    if len(ordered) > LISTED:  # nobody reads so many, and nothing may be missing
        parts.append("\n".join(_line(each, say, zone) for each in ordered[LISTED:]))
    if link and len(arms) > 1:
        parts.append(say.say("All arms: {link}", link=f"{link}/"))
    return one_line(subject), "\n\n".join(parts) + "\n"


def _title(first: Transition, say: Language, count: int, over: Collection[str]) -> str:
    mark = say.say("over") if first.alert_id in over else _tier(first.tier, say)
    title = f"[{mark}] {first.arm}: {_said(first, say).headline}"
    return title if count == 1 else say.say("{title} (and {count} more)", title=title, count=count - 1)


def _said(told: Transition, say: Language) -> Sentences:
    return sentences(told.alert, JointPast(), told.at_unix_s, say)


def _tier(tier: str, say: Language) -> str:
    return say.say(TIER_WORDS.get(tier, tier))


def _kind(told: Transition, say: Language) -> str:
    return say.say(KINDS.get(told.kind, told.kind))


def _paragraph(each: Transition, say: Language, zone: ZoneInfo, link: str, over: Collection[str]) -> Iterable[str]:
    said = _said(each, say)
    yield f"{each.arm}: {said.headline}"
    yield say.say("Tier {tier}, {kind}, {at}.", tier=_tier(each.tier, say), kind=_kind(each, say), at=local(each.at_unix_s, zone))
    text = say.at(each.alert, "text")
    if text and text != said.headline:
        yield text
    if said.due and each.alert_id not in over:
        yield say.say("To do: {action}", action=said.due)
    if page := page_of(link, each):
        yield page


def _line(each: Transition, say: Language, zone: ZoneInfo) -> str:
    about = f"{_tier(each.tier, say)}, {_kind(each, say)}, {local(each.at_unix_s, zone)}"
    return f"{each.arm}: {_said(each, say).headline} [{about}]"


def local(unix_s: float, zone: ZoneInfo) -> str:
    """A time as clocks of the time zone show it."""
    return f"{datetime.fromtimestamp(unix_s, zone):%Y-%m-%d %H:%M %Z}"


def one_line(text: str) -> str:
    """The text without line ends and control letters: it stands in a header."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())[:200]


# --- the report of a plant: all arms, the worst first, and what has happened in a period; one page that can be printed

LISTED_IN_MAIL = 20  # arms and changes in the text of the mail; the page has all
ROWS = 2000  # changes on the page


class PlantPage(NamedTuple):
    """The page, and what the mail says in its text."""

    html: str
    lines: list[str]
    sick: int


def plant_page(
    arms: Sequence[HeardArm],
    changes: Sequence[Transition],
    begin_unix_s: float,
    end_unix_s: float,
    at_unix_s: float,
    say: Language,
    zone: ZoneInfo,
    link: str = "",
) -> PlantPage:
    """The report of these arms. changes : transitions of the period, the oldest first."""
    ordered = worst_first(arms, at_unix_s)
    sick = [arm for arm in ordered if arm.grade is Grade.SICK]
    subtitle = say.say(
        "{begin} to {end}; made on {made} by joint-monitor {version}. Times are {zone}.",
        begin=full_day(begin_unix_s, say),
        end=full_day(end_unix_s, say),
        made=moment(at_unix_s, say),
        version=__version__,
        zone=str(zone),
    )
    told = [each for each in changes if each.changes_tier]
    parts = [paragraph(_counts(arms, at_unix_s, say), "lead"), heading(say.say("Arms, the worst first"))]
    columns = [say.say(title) for title in ("Arm", "State", "Since", "Active alerts", "Heard")]
    parts.append(table(columns, [_arm_row(arm, at_unix_s, say, zone, link) for arm in ordered]))
    parts.append(heading(say.say("What has changed")))
    if told:
        columns = [say.say(title) for title in ("When", "Arm", "What", "Tier", "Change")]
        parts.append(table(columns, [_change_row(each, say, zone) for each in told[-ROWS:]]))
    else:
        parts.append(paragraph(say.say("Nothing: no alert was raised, changed or cleared.")))
    lines = [_counts(arms, at_unix_s, say)]
    shown = [f"  {arm.name}: {deciding(arm.shown, at_unix_s, say)}" for arm in sick[:LISTED_IN_MAIL]]
    lines += ["\n".join(shown)] if shown else []
    lines.append(say.say("{count} changes of alerts.", count=len(told)))
    return PlantPage(page(say.say("Report of the plant"), subtitle, parts, say.code), lines, len(sick))


def _counts(arms: Sequence[HeardArm], now_unix_s: float, say: Language) -> str:
    return say.say(
        "{arms} arms: {sick} need somebody, {silent} are silent; {waiting} alerts wait for a person.",
        arms=len(arms),
        sick=sum(arm.grade is Grade.SICK for arm in arms),
        silent=sum(arm.silent is not None for arm in arms),
        waiting=sum(len(arm.waiting(now_unix_s)) for arm in arms),
    )


def _arm_row(arm: HeardArm, now_unix_s: float, say: Language, zone: ZoneInfo, link: str) -> list[object]:
    alerts = "".join(f"<div>{escaped(_alert(alert, arm.clock(now_unix_s), say))}</div>" for alert in gravest_first(arm.alerts))
    name = escaped(arm.name)
    if arm.silent is not None:
        heard = say.say("silent since {at}", at=local(arm.silent.since_unix_s or 0.0, zone))
    else:
        heard = local(max(arm.heard_at_unix_s.values()), zone) if arm.heard_at_unix_s else "–"
    since = None if arm.health is None else arm.health.since
    return [
        Markup(f'<a href="{escaped(link)}/arms/{name}/">{name}</a>') if link else str(arm.name),
        chip(arm.shown.pill, say),
        "–" if since is None else f"{since:%Y-%m-%d}",
        Markup(alerts or "–"),
        heard,
    ]


def _alert(alert: Alert, now_unix_s: float, say: Language) -> str:
    waits = f" ({say.say('waits for a person')})" if person(alert, now_unix_s) is Person.WAITS else ""
    return f"{_tier(alert.tier, say)}: {say.at(alert, 'text') or say.word(alert.condition)}{waits}"


def _change_row(each: Transition, say: Language, zone: ZoneInfo) -> list[object]:
    return [local(each.at_unix_s, zone), str(each.arm), _said(each, say).headline, _tier(each.tier, say), _kind(each, say)]


# --- the weekly and the monthly report: when each is due, and its message; I/O through the outbox alone

TITLES = {
    "weekly": N_("Weekly report of {count} arms: {sick} need somebody"),
    "monthly": N_("Monthly report of {count} arms: {sick} need somebody"),
}


class Periods:
    """The reports of all recipients."""

    def __init__(self, settings: NotifySettings, ways: Sequence[Route], surroundings: Surroundings) -> None:
        self._settings, self._surroundings = settings, surroundings
        self._routes = [route for route in ways if route.recipient.reports]
        self._began_unix_s: float | None = None
        self._owed: set[str] = set()  # known to be in the outbox

    def owe(self, now_unix_s: float) -> None:
        """Owe the newest report of each period that has ended since there is a gateway. Raises StoreError."""
        if not self._routes:
            return
        outbox = self._surroundings.outbox
        if self._began_unix_s is None:
            self._began_unix_s = outbox.began_unix_s()
        new = []
        for address, recipient in self._routes:
            for period in recipient.reports:
                begin, end = last_period(period, self._settings, recipient, now_unix_s)
                key = f"{address}/report/{period}/{int(end)}"
                if end < self._began_unix_s or key in self._owed:
                    continue
                document = {"period": period, "from_unix_s": begin, "to_unix_s": end}
                new.append(Delivery(key=key, recipient=address, kind=REPORT, document=document, due_at_unix_s=end))
        outbox.owe("mail", new)
        self._owed |= {each.key for each in new}

    def message(self, name: str, owed: Owed, at_unix_s: float, say: Language, zone: ZoneInfo) -> Message:
        """The report as it is now: an arm's last words count, and the transitions of the period."""
        begin, end = float(owed.document["from_unix_s"]), float(owed.document["to_unix_s"])
        arms = list(self._surroundings.arms().values())
        changes = self._surroundings.transitions(begin, end)
        wishes = next(route.recipient for route in self._routes if route.address == owed.recipient)
        arms = [arm for arm in arms if _concerns(wishes, arm)]
        changes = [each for each in changes if wishes.concerns(each.arm.site, each.arm.robot, each.condition)]
        content = plant_page(arms, changes, begin, end, at_unix_s, say, zone, self._surroundings.link)
        subject = say.say(TITLES[str(owed.document["period"])], count=len(arms), sick=content.sick)
        period = f"{full_day(begin, say)} – {full_day(end, say)}"
        text = "\n\n".join([f"{subject}.", period, *content.lines, say.say("The page is attached; it can be printed.")]) + "\n"
        file_name = f"joint-monitor-{owed.document['period']}-{datetime.fromtimestamp(end, zone):%Y-%m-%d}.html"
        return Message(
            name=name,
            kind=REPORT,
            recipient=owed.recipient,
            subject=one_line(subject),
            text=text,
            made_at_unix_s=at_unix_s,
            attachments=((file_name, "html", content.html),),
        )


def last_period(period: str, settings: NotifySettings, recipient: RecipientSettings, now_unix_s: float) -> tuple[float, float]:
    """Begin and end of the newest week or month that has ended, in the recipient's time zone."""
    zone = settings.zone_of(recipient)
    at = time_of_day(settings.report_at, "report_at")
    today = datetime.fromtimestamp(now_unix_s, zone)
    day = today.date() - timedelta(days=today.weekday()) if period == "weekly" else today.date().replace(day=1)

    def before(each: Any) -> Any:
        return each - timedelta(days=7) if period == "weekly" else (each - timedelta(days=1)).replace(day=1)

    if datetime.combine(day, at, zone).timestamp() > now_unix_s:
        day = before(day)
    return datetime.combine(before(day), at, zone).timestamp(), datetime.combine(day, at, zone).timestamp()


def _concerns(recipient: RecipientSettings, arm: HeardArm) -> bool:
    return recipient.concerns(arm.name.site, arm.name.robot, "") or any(
        recipient.concerns(arm.name.site, arm.name.robot, alert.condition) for alert in arm.alerts
    )
