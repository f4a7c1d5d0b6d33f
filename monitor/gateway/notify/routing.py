"""Who is told of a transition, by which way and when, and what becomes one message. No I/O, no clock.

Each person gets what concerns him once. What happens within a short time is one message; a cause that many arms share is one a day.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from datetime import time as TimeOfDay  # noqa: N812 - `time` is the module elsewhere
from typing import NamedTuple
from zoneinfo import ZoneInfo

from monitor.config.notify import DAYS, NotifySettings, RecipientSettings
from monitor.gateway.outbox import Owed
from monitor.gateway.values import ACTIVE, CLEARED, ENDED, GRAVER, RAISED, Delivery, Transition, document_of
from monitor.publish.shown import tier_gravity
from monitor.recording import DAY_S

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
