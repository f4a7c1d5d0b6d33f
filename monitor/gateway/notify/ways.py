"""The ways of [notify] that are configured, each with what it needs, and their channels. I/O."""

from collections.abc import Callable, Iterator, Sequence

from monitor.errors import MonitorError
from monitor.gateway.channel import Channel, Finding, Surroundings, needs
from monitor.gateway.notify.mail import MailWay
from monitor.gateway.notify.people import People, Way
from monitor.gateway.notify.settings import NotifySettings
from monitor.gateway.notify.texts import Message
from monitor.gateway.reach import believed
from monitor.plant.settings import PlantConfiguration
from monitor.views.language.catalogue import language

TEST = "test"  # kind of a message that a person has asked for


def channels(settings: NotifySettings, surroundings: Surroundings) -> Sequence[Channel]:
    """One channel for each way that a recipient has. Raises BadInput, BadConfiguration where a library is absent."""
    return [People(settings, way, surroundings) for way in ways(settings, surroundings.plant, surroundings.now)]


def ways(settings: NotifySettings, plant: PlantConfiguration, now: Callable[[], float]) -> list[Way]:
    """The ways that recipients have. Raises BadInput, BadConfiguration where a library is absent."""
    found: list[Way] = []
    if any(each.mail for each in settings.to):
        found.append(MailWay(settings, plant.folder))
    if any(each.webhook for each in settings.to):
        needs("httpx", "notify: webhooks")
        from monitor.gateway.notify.webhook import WebhookWay

        found.append(WebhookWay(settings, believed(settings.ca_file, plant.folder, "notify"), now))
    if any(each.apprise for each in settings.to):
        needs("apprise", "notify: apprise")
        from monitor.gateway.notify.by_apprise import AppriseWay

        found.append(AppriseWay(settings))
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
                text=say.say("A person has asked for this message. Alerts of the plant will come in the same way.") + "\n",
                made_at_unix_s=now(),
            )
            try:
                way.send(message)
            except MonitorError as error:
                yield Finding(way.name, "message", False, str(error))
            else:
                yield Finding(way.name, "message", True, f"{address}: a test message is taken")
        way.rest()
