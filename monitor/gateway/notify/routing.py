"""Who is told of a transition, by which way and when, and what becomes one message: the section [notify], and its rules. No I/O, no clock.

Each person gets what concerns him once. What happens within a short time is one message; a cause that many arms share is one a day.
"""

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from datetime import time as TimeOfDay  # noqa: N812 - `time` is the module elsewhere
from email.utils import parseaddr
from fnmatch import fnmatchcase
from typing import Annotated, Literal, NamedTuple
from zoneinfo import ZoneInfo

from annotated_types import Interval

from monitor.acquire.schedule.times import time_zone
from monitor.errors import BadInput
from monitor.gateway.outbox import Owed
from monitor.gateway.values import ACTIVE, CLEARED, ENDED, GRAVER, PLANT_SILENT, RAISED, Delivery, Transition, document_of
from monitor.judge.alerts.health import TIERS
from monitor.publish.shown import tier_gravity
from monitor.recording import DAY_S
from monitor.views.language.catalogue import LANGUAGES
from monitor.views.web.settings import is_loopback

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
PERIODS = ("weekly", "monthly")
_ADDRESS = re.compile(r"[^@\s<>,;\"()]+@[^@\s<>,;\"()]+\Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecipientSettings:
    """One table [[notify.to]]: a person, or a role of several people."""

    name: str  # e.g. "maintenance"; it is named in the status
    mail: tuple[str, ...] = ()  # addresses; each is a person
    webhook: str = ""  # https://…: receives signed JSON
    webhook_secret: str = field(default="", repr=False)  # the key of its signatures: "credential:NAME"
    apprise: str = field(default="", repr=False)  # an address as apprise has them, e.g. of a chat: "credential:NAME"
    sites: tuple[str, ...] = ("*",)  # patterns: "hall-*"
    robots: tuple[str, ...] = ("*",)  # patterns of SITE/ROBOT
    tiers: tuple[str, ...] = TIERS  # advisory, wear, limit; empty: no alerts
    conditions: tuple[str, ...] = ("*",)  # patterns, e.g. "wear_rising"
    cleared: bool = True  # whether the end of an alert is told as well
    quiet: str = ""  # "22:00-06:00": nothing then; it comes afterwards
    quiet_days: tuple[str, ...] = ()  # e.g. "sat", "sun"
    pierce: tuple[str, ...] = ("limit",)  # tiers that wait neither for the end of quiet hours nor for the digest
    digest_at: str = ""  # "07:00": one message a day; empty: at once
    digest_tiers: tuple[str, ...] = ("advisory",)  # that wait for it
    time_zone: str = ""  # empty: that of [notify]
    language: str = ""  # en or de; empty: that of [gateway]
    escalation: bool = False  # is told of alerts of tier wear and limit that nobody has acknowledged for escalate_days
    reports: tuple[str, ...] = ()  # weekly, monthly; by mail, with the printed page attached

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        here = f"notify.to: {self.name!r}:"
        if not re.fullmatch(r"[\w.+ -]{1,60}", self.name):
            raise BadInput(f"notify.to: name = {self.name!r}; expected up to 60 letters and digits")
        if not (self.mail or self.webhook or self.apprise):
            raise BadInput(f"{here} expected mail, webhook or apprise: there is no way to reach it")
        for key in ("sites", "robots", "conditions"):
            if not getattr(self, key):
                raise BadInput(f"{here} {key} = []: nothing would ever be told; leave it out for all of them")
        for each in self.mail:
            if not _ADDRESS.match(each):
                raise BadInput(f'{here} mail: {each!r} is no address; expected e.g. "ada@plant.example"')
        if self.webhook and not re.match(r"https?://[^\s/]+", self.webhook):
            raise BadInput(f"{here} webhook: expected https://…")
        if self.webhook and not self.webhook_secret:
            raise BadInput(f'{here} webhook without webhook_secret: nobody could tell our messages; expected "credential:NAME"')
        for key, allowed in (("tiers", TIERS), ("pierce", TIERS), ("digest_tiers", TIERS), ("quiet_days", DAYS), ("reports", PERIODS)):
            for each in getattr(self, key):
                if each not in allowed:
                    raise BadInput(f"{here} {key}: {each!r}; expected of {', '.join(allowed)}")
        if not (self.tiers or self.escalation or self.reports):
            raise BadInput(f"{here} tiers = []: without escalation or reports nothing would ever be told; leave it out for all tiers")
        if len(set(self.quiet_days)) == len(DAYS):
            raise BadInput(f"{here} quiet_days: every day is quiet; nothing would ever be told")
        if self.reports and not self.mail:
            raise BadInput(f"{here} reports: go by mail; expected mail")
        if self.language and self.language not in LANGUAGES:
            raise BadInput(f"{here} language = {self.language!r}; expected {', '.join(LANGUAGES)}")
        self.quiet_hours()
        if self.digest_at:
            time_of_day(self.digest_at, f"{here} digest_at")
        if self.time_zone:
            time_zone(self.time_zone, f"{here} time_zone")

    def quiet_hours(self) -> tuple[TimeOfDay, TimeOfDay] | None:
        """Begin and end; None without any. Raises BadInput."""
        if not self.quiet:
            return None
        begin, sign, end = self.quiet.partition("-")
        here = f"notify.to: {self.name!r}: quiet"
        if not sign:
            raise BadInput(f'{here} = {self.quiet!r}; expected "22:00-06:00"')
        hours = time_of_day(begin.strip(), here), time_of_day(end.strip(), here)
        if hours[0] == hours[1]:
            raise BadInput(f"{here} = {self.quiet!r}: begins when it ends")
        return hours

    def concerns(self, site: str, robot: str, condition: str) -> bool:
        """Whether this arm and condition are theirs. The plant's own service is everybody's."""
        if condition == PLANT_SILENT:
            return any(fnmatchcase(condition, each) for each in self.conditions)
        return (
            any(fnmatchcase(site, each) for each in self.sites)
            and any(fnmatchcase(f"{site}/{robot}", each) for each in self.robots)
            and any(fnmatchcase(condition, each) for each in self.conditions)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class NotifySettings:
    """The section [notify]. Without a recipient nobody is told of anything."""

    smtp: str = ""  # HOST:PORT of the mail server, e.g. "smtp.plant.example:587"
    tls: Literal["starttls", "tls", "none"] = "starttls"  # starttls: from the first command on (587); tls: from the beginning (465)
    ca_file: str = ""  # PEM of an authority of yours, for mail server and webhooks; empty: those that the system believes
    user: str = ""
    password: str = field(default="", repr=False)  # "credential:NAME"
    sender: str = ""  # e.g. "joint-monitor@plant.example"
    time_zone: str = "UTC"  # of quiet hours, digests, reports and times in messages, e.g. "Europe/Berlin"
    gather_s: Annotated[float, Interval(ge=0.0, le=3600.0)] = 120.0  # what comes within this time is one message
    fleet_arms: Annotated[int, Interval(ge=2, le=1000)] = (
        3  # one condition in so many arms within fleet_hours has one cause: a message a day
    )
    fleet_hours: Annotated[float, Interval(ge=0.1, le=48.0)] = 6.0
    escalate_days: Annotated[float, Interval(ge=0.01, le=365.0)] = 3.0  # without an acknowledgement
    report_at: str = "07:00"  # of the weekly report on Mondays, of the monthly one on the first
    give_up_days: Annotated[float, Interval(ge=1.0, le=60.0)] = 14.0  # after which a message that nobody takes is given up
    to: tuple[RecipientSettings, ...] = ()

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        time_zone(self.time_zone, "notify: time_zone")
        time_of_day(self.report_at, "notify: report_at")
        names = [each.name for each in self.to]
        if len(set(names)) != len(names):
            raise BadInput("notify.to: a name stands there twice")
        mails = any(each.mail for each in self.to)
        if mails and not self.smtp:
            raise BadInput('notify: mail, but no mail server; expected smtp = "HOST:PORT"')
        if self.smtp:
            host, _ = self.server()
            if self.tls == "none" and self.password and not is_loopback(host):
                raise BadInput('notify: tls = "none" with a password, which everybody on the way could read; expected starttls or tls')
        if mails and not _ADDRESS.match(parseaddr(self.sender)[1]):
            raise BadInput(f'notify: sender = {self.sender!r}; expected an address, e.g. "joint-monitor@plant.example"')
        if bool(self.user) != bool(self.password):
            raise BadInput("notify: expected user and password together, or neither")
        if not (self.user + self.password).isascii():
            raise BadInput("notify: user or password hold letters that are not ASCII; mail servers are signed in to with ASCII alone")

    def server(self) -> tuple[str, int]:
        """Host and port of the mail server. Raises BadInput."""
        host, _, port = self.smtp.rpartition(":")
        if not host or not (port.isascii() and port.isdigit() and 0 < int(port) <= 65535):
            raise BadInput(f'notify: smtp = {self.smtp!r}; expected HOST:PORT, e.g. "smtp.plant.example:587"')
        return host.strip("[]"), int(port)

    def zone_of(self, recipient: RecipientSettings) -> ZoneInfo:
        """The time zone of a recipient."""
        return time_zone(recipient.time_zone or self.time_zone, "notify: time_zone")


def time_of_day(text: str, where: str) -> TimeOfDay:
    """Raises BadInput where it is none."""
    found = re.fullmatch(r"([01]\d|2[0-3]):([0-5]\d)", text)
    if found is None:
        raise BadInput(f'{where} = {text!r}; expected a time of day, e.g. "07:00"')
    return TimeOfDay(int(found[1]), int(found[2]))


# --- Who is told of a transition and when, and what becomes one message

ALERT, ALREADY, ESCALATION, REPORT = "alert", "already", "escalation", "report"  # kinds of deliveries
FLEET = "fleet"  # a message about a cause that many arms share; else the kind of its deliveries
ONE_CAUSE = "common_mode"  # friction of all joints: a cause outside of the arm from the first one on
NEVER_WAITS = "limit"  # the tier that a fleet-wide cause does not hold back
WEAR = tier_gravity("wear")
HOUR_S = 3600.0


class Route(NamedTuple):
    """How one recipient is reached: an address of his and his wishes."""

    address: str
    recipient: RecipientSettings


Addresses = Callable[[RecipientSettings], Collection[str]]  # of a recipient by one way: mail, webhook or apprise


def routes(settings: NotifySettings, addresses: Addresses) -> list[Route]:
    """Every address of one way, with whose it is."""
    return [Route(address, recipient) for recipient in settings.to for address in addresses(recipient)]


def offered(transition: Transition, ways: Iterable[Route], settings: NotifySettings, now_unix_s: float) -> list[Delivery]:
    """What is owed because of a transition. An address that several recipients share gets it once, at the earliest time."""
    if not transition.changes_tier and transition.kind != "unacknowledged":
        return []
    due: dict[str, float] = {}
    late: dict[str, float] = {}
    for address, recipient in ways:
        if not recipient.concerns(transition.arm.site, transition.arm.robot, transition.condition):
            continue
        told = transition.changes_tier and transition.tier in recipient.tiers and (recipient.cleared or transition.kind != CLEARED)
        if told:
            zone = settings.zone_of(recipient)
            together = transition.kind == ACTIVE  # they are one message: no tier comes before another, or with a later digest
            at = quiet_until(recipient, zone, now_unix_s) if together else ready_at(recipient, transition.tier, zone, now_unix_s)
            due[address] = min(at, due.get(address, at))
        waits = transition.kind in {RAISED, GRAVER, ACTIVE, "unacknowledged"} and tier_gravity(transition.after) >= WEAR
        if recipient.escalation and waits:
            late[address] = now_unix_s + settings.escalate_days * DAY_S
    document, robot = document_of(transition), str(transition.arm)
    kind = ALREADY if transition.kind == ACTIVE else ALERT
    found = [
        Delivery(key=f"{to}/{transition.id}", recipient=to, kind=kind, document=document, due_at_unix_s=at, robot=robot)
        for to, at in due.items()
    ]
    return found + [
        Delivery(key=f"{to}/escalation/{transition.id}", recipient=to, kind=ESCALATION, document=document, due_at_unix_s=at, robot=robot)
        for to, at in late.items()
    ]


def ready_at(recipient: RecipientSettings, tier: str, zone: ZoneInfo, now_unix_s: float) -> float:
    """From when on a recipient may be told of a tier: after his quiet hours, with his digest."""
    if tier in recipient.pierce:
        return now_unix_s
    at = now_unix_s
    if recipient.digest_at and tier in recipient.digest_tiers:
        hour, minute = recipient.digest_at.split(":")
        at = _next(datetime.fromtimestamp(now_unix_s, zone), TimeOfDay(int(hour), int(minute)), zone)
    return quiet_until(recipient, zone, at)


def quiet_until(recipient: RecipientSettings, zone: ZoneInfo, at_unix_s: float) -> float:
    """The end of the quiet hours and days that hold at a time; the time itself where none do."""
    hours = recipient.quiet_hours()
    for _ in range(2 * len(DAYS)):
        local = datetime.fromtimestamp(at_unix_s, zone)
        if DAYS[local.weekday()] in recipient.quiet_days:
            at_unix_s = _next(local, TimeOfDay(0, 0), zone)
            continue
        if hours is None:
            return at_unix_s
        begin, end = hours
        now = local.time().replace(tzinfo=None)
        quiet = begin <= now < end if begin < end else now >= begin or now < end
        if not quiet:
            return at_unix_s
        at_unix_s = _next(local, end, zone)
    return at_unix_s


def _next(local: datetime, at: TimeOfDay, zone: ZoneInfo) -> float:
    """The next time that clocks show this, after `local`; where they skip it, the moment at which they do."""
    for days in range(3):
        found = datetime.combine(local.date() + timedelta(days=days), at, zone)
        if found.timestamp() > local.timestamp():
            return found.astimezone(UTC).timestamp()
    return local.timestamp() + DAY_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Deliveries of one address that become one message."""

    kind: str  # FLEET, or the kind of the deliveries
    recipient: str
    deliveries: tuple[Owed, ...]
    condition: str = ""  # of a fleet-wide cause


class Sent(NamedTuple):
    """A delivery that was made lately."""

    recipient: str
    condition: str
    robot: str
    kind: str  # of its message: FLEET, ALERT, …
    at_unix_s: float


class Gathered(NamedTuple):
    """What to do now with what is owed."""

    groups: list[Group]
    postponed: dict[int, float]  # deliveries of a cause that was told today already: until when they wait


def gathered(
    owed: Sequence[Owed],
    sent: Sequence[Sent],
    wishes: Mapping[str, Sequence[RecipientSettings]],
    settings: NotifySettings,
    now_unix_s: float,
) -> Gathered:
    """Make messages of what is owed and has none yet.

    owed : everything of the channel, also what is not due. sent : of the last day. wishes : of each address.
    """
    groups: list[Group] = []
    postponed: dict[int, float] = {}
    for address in dict.fromkeys(each.recipient for each in owed):
        mine = [each for each in owed if each.recipient == address and each.message is None]
        due = [
            each for each in mine if each.due_at_unix_s <= now_unix_s and not _quiet(each, wishes.get(address, ()), settings, now_unix_s)
        ]
        alerts = [each for each in due if each.kind == ALERT]
        held: set[int] = set()
        for condition in dict.fromkeys(str(each.document["condition"]) for each in alerts):
            those = [each for each in alerts if each.document["condition"] == condition and each.document["tier"] != NEVER_WAITS]
            if not those or not _of_many(condition, address, mine, sent, settings, now_unix_s):
                continue
            held |= {each.id for each in those}
            last = max(
                (each.at_unix_s for each in sent if (each.recipient, each.condition, each.kind) == (address, condition, FLEET)),
                default=None,
            )
            if last is not None and now_unix_s - last < DAY_S:
                postponed |= {each.id: last + DAY_S for each in those}
            elif _settled(those, settings, now_unix_s):
                groups.append(Group(kind=FLEET, recipient=address, deliveries=tuple(those), condition=condition))
        single = [each for each in alerts if each.id not in held]
        if single and _settled(single, settings, now_unix_s):
            groups.append(Group(kind=ALERT, recipient=address, deliveries=tuple(single)))
        already = tuple(each for each in due if each.kind == ALREADY)
        if already and _settled(already, settings, now_unix_s):
            groups.append(Group(kind=ALREADY, recipient=address, deliveries=already))
        escalated = tuple(each for each in due if each.kind == ESCALATION)
        if escalated:
            groups.append(Group(kind=ESCALATION, recipient=address, deliveries=escalated))
        groups += [Group(kind=REPORT, recipient=address, deliveries=(each,)) for each in due if each.kind == REPORT]
    return Gathered(groups, postponed)


def _quiet(owed: Owed, wishes: Sequence[RecipientSettings], settings: NotifySettings, now_unix_s: float) -> bool:
    """Whether it came due in quiet hours, because it could not be delivered before."""
    tier = str(owed.document.get("tier", ENDED))
    return bool(wishes) and all(
        tier not in each.pierce and quiet_until(each, settings.zone_of(each), now_unix_s) > now_unix_s for each in wishes
    )


def _settled(owed: Sequence[Owed], settings: NotifySettings, now_unix_s: float) -> bool:
    """Whether nothing more is waited for: the oldest has waited long enough."""
    return now_unix_s - min(each.made_at_unix_s for each in owed) >= settings.gather_s


def _of_many(condition: str, address: str, mine: Sequence[Owed], sent: Sequence[Sent], settings: NotifySettings, now_unix_s: float) -> bool:
    """Whether a condition has come to so many arms within hours that they have one cause."""
    if condition == ONE_CAUSE:
        return True
    since = now_unix_s - settings.fleet_hours * HOUR_S
    arms = {each.robot for each in sent if (each.recipient, each.condition) == (address, condition) and each.at_unix_s >= since}
    arms |= {
        str(each.robot) for each in mine if each.kind == ALERT and each.document["condition"] == condition and each.made_at_unix_s >= since
    }
    waiting = {str(each.robot) for each in mine if each.kind == ALERT and each.document["condition"] == condition}
    return max(len(arms), len(waiting)) >= settings.fleet_arms
