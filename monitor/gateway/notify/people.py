"""A channel that tells people: mail, webhook and apprise differ only in how a message is sent. I/O."""

import hashlib
import logging
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, Protocol
from zoneinfo import ZoneInfo

from monitor.config.notify import NotifySettings, RecipientSettings
from monitor.errors import BadInput, MonitorError
from monitor.gateway.channel import Channel, Surroundings
from monitor.gateway.connection import Finding, NotReached, Refused
from monitor.gateway.notify.mail import MailWay
from monitor.gateway.notify.messages import Message, Periods, alert_message
from monitor.gateway.notify.routing import (
    ALERT,
    ESCALATION,
    REPORT,
    WEAR,
    Gathered,
    Group,
    Route,
    Sent,
    gathered,
    offered,
    routes,
)
from monitor.gateway.notify.services import AppriseWay, WebhookWay
from monitor.gateway.outbox import Owed
from monitor.gateway.values import Delivery, Transition, transition_of
from monitor.plant.arm import ArmName
from monitor.plant.settings import PlantConfiguration
from monitor.publish.shown import tier_gravity
from monitor.recording import DAY_S
from monitor.views.language.catalogue import language

log = logging.getLogger(__name__)

STEP_S = 5.0  # between two looks at what is owed
LONGEST_S = 60.0  # of sending, in one step: it must end in time
TEST = "test"  # kind of a message that a person has asked for
PATIENCE = 8  # attempts, some forty minutes: a message that is refused as often may be the only one that is


class Way(Protocol):
    """How a message is sent."""

    @property
    def name(self) -> str:
        """mail, webhook or apprise."""

    def addresses(self, recipient: RecipientSettings) -> Collection[str]:
        """Those of a recipient by this way; they stand in the outbox, so they hold no secret."""

    def ready(self) -> None:
        """Raises NotReached where no message would get through: then what is owed is gathered when one does."""

    def send(self, message: Message) -> Any:
        """Send it, within two minutes. Returns what is kept of the answer. Raises Refused, NotReached."""

    def check(self) -> Sequence[Finding]:
        """How far it gets, as `ready` and `send` would; no message is sent."""

    def rest(self) -> None:
        """A step ends: keep nothing open."""


class People:
    """A `Channel` of one way."""

    def __init__(self, settings: NotifySettings, way: Way, surroundings: Surroundings) -> None:
        self.name = way.name
        self._settings, self._way, self._surroundings = settings, way, surroundings
        self._routes: list[Route] = routes(settings, way.addresses)
        self._wishes: dict[str, list[RecipientSettings]] = {}
        for address, recipient in self._routes:
            self._wishes.setdefault(address, []).append(recipient)
        self._periods = Periods(settings, self._routes, surroundings) if way.name == "mail" else None
        self._owed = self._failing = 0

    def offer(self, transition: Transition) -> Sequence[Delivery]:
        """Whom it concerns."""
        return offered(transition, self._routes, self._settings, self._surroundings.now())

    def step(self, now_unix_s: float) -> float:
        """Make messages of what is due, and send them. Raises NotReached."""
        outbox = self._surroundings.outbox
        if self._periods is not None:
            self._periods.owe(now_unix_s)
        owed = self._still_needed(outbox.owed(self.name), now_unix_s)
        self._owed, self._failing = len(owed), sum(each.attempts > 0 for each in owed)
        try:
            self._gather(owed, now_unix_s)
            return self._send_waiting(now_unix_s)
        finally:
            self._way.rest()

    def _send_waiting(self, now_unix_s: float) -> float:
        owed = self._surroundings.outbox.owed(self.name)
        waiting: dict[str, list[Owed]] = {}
        for each in owed:
            if each.message is not None and each.due_at_unix_s <= now_unix_s:
                waiting.setdefault(each.message, []).append(each)
        until = time.monotonic() + LONGEST_S
        for name, deliveries in waiting.items():
            if time.monotonic() > until:
                return 0.0
            self._send(name, deliveries)
            self._owed -= len(deliveries)
        return STEP_S

    def status(self) -> str:
        """How many people, and what waits."""
        failing = f", {self._failing} after an attempt that failed" if self._failing else ""
        people = f"{len(self._wishes)} address{'' if len(self._wishes) == 1 else 'es'}"
        return f"{people}, {self._owed} {'delivery waits' if self._owed == 1 else 'deliveries wait'}{failing}"

    def close(self) -> None:
        """Nothing is open between two steps."""

    def _still_needed(self, owed: list[Owed], now_unix_s: float) -> list[Owed]:
        """Without escalations of alerts that somebody has acknowledged, and recipients who are in the file no more."""
        outbox, kept = self._surroundings.outbox, []
        for each in owed:
            if each.recipient not in self._wishes:
                outbox.dropped([each.id], "the file names this recipient no more")
            elif each.kind == ESCALATION and each.due_at_unix_s <= now_unix_s and each.message is None:
                until = self._waits_until(each.document, now_unix_s)
                if until is None:
                    outbox.dropped([each.id], "acknowledged, cleared or of a lower tier")
                elif until > now_unix_s:
                    outbox.postpone([each.id], until)
                else:
                    kept.append(each)
            else:
                kept.append(each)
        return kept

    def _waits_until(self, document: Mapping[str, Any], now_unix_s: float) -> float | None:
        """Until when an alert that nobody has acknowledged is shelved; now where it is not; None where nobody need be told."""
        arm = self._surroundings.arms().get(ArmName(document["site"], document["robot"]))
        alert = arm.alert(document["joint"], document["condition"]) if arm is not None else None
        if arm is None or alert is None or alert.acknowledged_at is not None or tier_gravity(alert.tier) < WEAR:
            return None
        shelved_s = 0.0 if alert.shelved_until is None else alert.shelved_until.timestamp() - arm.clock(now_unix_s)
        return now_unix_s + max(shelved_s, 0.0)

    def _gather(self, owed: list[Owed], now_unix_s: float) -> None:
        stuck = _stuck(owed)
        free = [each for each in owed if (each.recipient, each.kind == REPORT) not in stuck]
        if not any(each.due_at_unix_s <= now_unix_s for each in free):
            return
        self._way.ready()
        outbox = self._surroundings.outbox
        lately = outbox.delivered_since(self.name, now_unix_s - DAY_S)
        sent = [
            Sent(each.recipient, str(each.document.get("condition")), str(each.robot), kind_of(each.message), each.at_unix_s)
            for each in lately
            if each.kind == ALERT
        ]
        found: Gathered = gathered(free, sent, self._wishes, self._settings, now_unix_s)
        for group in found.groups:
            outbox.gather([each.id for each in group.deliveries], message_name(group, now_unix_s))
        for until in set(found.postponed.values()):
            outbox.postpone([number for number, at in found.postponed.items() if at == until], until)

    def _send(self, name: str, deliveries: list[Owed]) -> None:
        outbox, ids = self._surroundings.outbox, [each.id for each in deliveries]
        dead_after_s = self._settings.give_up_days * DAY_S
        try:
            answer = self._way.send(self._message(name, deliveries))
        except Refused as refused:
            outbox.failed(deliveries, self._surroundings.scrub(str(refused)), dead_after_s=dead_after_s, wait_s=refused.wait_s)
        except NotReached as error:
            oldest = min(each.made_at_unix_s for each in deliveries)
            if self._surroundings.now() - oldest > dead_after_s:
                outbox.failed(deliveries, self._surroundings.scrub(str(error)), dead_after_s=dead_after_s)
            raise
        except MonitorError:
            raise
        except Exception as error:
            # what an arm says may be beyond anything that was thought of, and the others shall get through
            log.exception("%s: a message to %s cannot be made", self.name, deliveries[0].recipient)
            outbox.failed(deliveries, f"{type(error).__name__}: a mistake of this program; the journal has more", dead_after_s=dead_after_s)
        else:
            outbox.delivered(ids, answer)

    def _message(self, name: str, deliveries: list[Owed]) -> Message:
        """The same message for the same deliveries: a crash may have it sent again."""
        kind, at, recipient = kind_of(name), made_at(name), deliveries[0].recipient
        wishes = self._wishes[recipient][0]
        say = language(wishes.language or self._surroundings.language)
        zone: ZoneInfo = self._settings.zone_of(wishes)
        if kind == REPORT and self._periods is not None:
            return self._periods.message(name, deliveries[0], at, say, zone)
        transitions = tuple(each.document for each in deliveries)
        told, link = [transition_of(each) for each in transitions], self._surroundings.link
        subject, text = alert_message(kind, told, say, zone, link, self._settings.escalate_days)
        return Message(name=name, kind=kind, recipient=recipient, subject=subject, text=text, made_at_unix_s=at, transitions=transitions)


def _stuck(owed: Sequence[Owed]) -> set[tuple[str, bool]]:
    """Who gets no further message now, alerts and reports apart: nobody gets a second one while the first is not through.

    After an outage the rest is one. But one that a server never takes, for its content perhaps, keeps no later one away.
    """
    held: dict[tuple[str, bool], dict[str, int]] = {}
    for each in owed:
        if each.message is not None:
            held.setdefault((each.recipient, each.kind == REPORT), {})[each.message] = each.attempts
    return {whom for whom, messages in held.items() if len(messages) > 1 or min(messages.values()) < PATIENCE}


def message_name(group: Group, now_unix_s: float) -> str:
    """A name that no other message has: its kind, its time, and what it is made of."""
    digest = hashlib.sha256("\n".join([group.recipient, *(each.key for each in group.deliveries)]).encode()).hexdigest()[:24]
    return f"{group.kind}.{int(now_unix_s)}.{digest}"


def kind_of(name: str | None) -> str:
    """The kind of a message."""
    return (name or "").partition(".")[0]


def made_at(name: str) -> float:
    """When a message got its name."""
    return float(name.split(".")[1])


# kind of way, and whether a recipient has it
WAYS: tuple[tuple[Callable[[NotifySettings, PlantConfiguration, Callable[[], float]], Way], Callable[[RecipientSettings], bool]], ...] = (
    (MailWay, lambda each: bool(each.mail)),
    (WebhookWay, lambda each: bool(each.webhook)),
    (AppriseWay, lambda each: bool(each.apprise)),
)


def ways(settings: NotifySettings, plant: PlantConfiguration, now: Callable[[], float]) -> Iterator[Way]:
    """The ways that recipients have. Raises BadInput, BadConfiguration where a library is absent."""
    return (made(settings, plant, now) for made, has in WAYS if any(has(each) for each in settings.to))


def channels(settings: NotifySettings, surroundings: Surroundings) -> Sequence[Channel]:
    """One channel for each way that a recipient has. Raises BadInput, BadConfiguration where a library is absent."""
    return [People(settings, way, surroundings) for way in ways(settings, surroundings.plant, surroundings.now)]


def check(settings: NotifySettings, plant: PlantConfiguration) -> Sequence[Finding]:
    """How far each way gets; no message is sent."""
    found: list[Finding] = []
    try:
        for way in ways(settings, plant, time.time):
            found += way.check()
    except BadInput as error:
        found.append(Finding("notify", "settings", False, str(error)))
    return found


def send_test(settings: NotifySettings, plant: PlantConfiguration, default_language: str, now: Callable[[], float]) -> Iterator[Finding]:
    """Send a test message to every recipient, by every way of his."""
    for way in ways(settings, plant, now):
        people = {address: each for each in settings.to for address in way.addresses(each)}
        for address, recipient in people.items():
            say = language(recipient.language or default_language)
            message = Message(
                name=f"{TEST}.{int(now())}.{abs(hash((address, now()))):x}",
                kind=TEST,
                recipient=address,
                subject=say.say("Test message of joint-monitor"),
                text=say.say("A person has asked for this message. Alerts will come in the same way.") + "\n",
                made_at_unix_s=now(),
            )
            try:
                way.send(message)
            except MonitorError as error:
                yield Finding(way.name, "message", False, str(error))
            else:
                yield Finding(way.name, "message", True, f"{address}: a test message is taken")
        way.rest()
