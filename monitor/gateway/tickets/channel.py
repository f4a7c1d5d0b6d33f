"""Tickets as a channel: each alert opens one, and what happens to the alert afterwards happens to its ticket. I/O.

A request that may have arrived without its answer is repeated with the same Idempotency-Key. Where the maintenance system keeps no such
keys, `find_url` asks it first whether the ticket is there.
"""

import hashlib
import time
from collections.abc import Mapping, Sequence
from typing import Any
from zoneinfo import ZoneInfo

from monitor.errors import MonitorError
from monitor.gateway.channel import Surroundings
from monitor.gateway.notify.routing import document_of
from monitor.gateway.notify.texts import headline
from monitor.gateway.outbox import DELIVERED, OWED, Owed
from monitor.gateway.tickets.rest import Rest, TicketRefused
from monitor.gateway.tickets.settings import TicketSettings
from monitor.gateway.tickets.template import filled, filled_address, pointed
from monitor.gateway.values import CLEARED, GRAVER, Delivery, Transition, page_of
from monitor.plant.links import ArmName
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S
from monitor.views.language.catalogue import language

OPEN, UPDATE, CLOSE = "open", "update", "close"
STEP_S = 5.0
LONGEST_S = 60.0  # of requests, in one step: it must end in time, and a slow server takes half a minute for each
UTC = ZoneInfo("UTC")


class Tickets:
    """A `Channel`."""

    name = "tickets"

    def __init__(self, settings: TicketSettings, surroundings: Surroundings) -> None:
        """Raises BadInput where ca_file is no certificate."""
        self._settings, self._surroundings = settings, surroundings
        self._rest = Rest(settings, surroundings.plant.folder)
        self._say = language(settings.language or surroundings.language)
        self._owed = 0
        self._failing: str | None = None

    def offer(self, transition: Transition) -> Sequence[Delivery]:
        """The first transition into a tier that opens tickets opens one; the end of the alert closes it, if it was opened."""
        settings = self._settings
        if not transition.changes_tier or not settings.concerns(*transition.arm, transition.condition):
            return []
        document = {**document_of(transition), "key": key_of(transition.alert_id)}
        if transition.kind == CLEARED:
            kind, key = CLOSE, f"{CLOSE}/{transition.alert_id}"
        elif transition.after in settings.tiers and transition.before not in settings.tiers:
            kind, key = OPEN, f"{OPEN}/{transition.alert_id}"
        elif transition.kind == GRAVER and transition.after in settings.tiers:
            kind, key = UPDATE, f"{UPDATE}/{transition.id}"
        else:
            return []
        return [Delivery(key=key, recipient="tickets", kind=kind, document=document, robot=str(transition.arm))]

    def step(self, now_unix_s: float) -> float:
        """Send what is due. Raises MonitorError where the maintenance system does not answer."""
        owed = sorted(self._surroundings.outbox.owed(self.name), key=lambda each: each.kind != OPEN)  # what follows waits for the ticket
        self._owed, self._failing = len(owed), next((each.error for each in owed if each.error), None)
        stuck: set[str] = set()  # alerts whose earlier request is not through
        until = time.monotonic() + LONGEST_S
        try:
            for each in owed:
                alert = str(each.document["alert_id"])
                if alert in stuck:
                    continue
                if each.due_at_unix_s > now_unix_s:
                    stuck.add(alert)
                    continue
                if time.monotonic() > until:
                    return 0.0
                if not self._done(each):
                    stuck.add(alert)
        finally:
            self._rest.close()
        return STEP_S

    def status(self) -> str:
        """What waits."""
        return f"{self._owed} requests wait" + (f"; the last answer: {self._failing}" if self._failing else "")

    def close(self) -> None:
        """Nothing is open between two steps."""

    def _done(self, owed: Owed) -> bool:
        """Carry one request out. Returns whether the next one of its alert may follow. Raises MonitorError where nobody answers."""
        outbox = self._surroundings.outbox
        try:
            if owed.kind == OPEN:
                outbox.delivered([owed.id], self._open(owed))
                return True
            opening, closing = (f"{kind}/{owed.document['alert_id']}" for kind in (OPEN, CLOSE))
            found = outbox.found(self.name, [opening, closing])
            state, answer = found.get(opening, ("", None))
            if state == OWED:
                return False
            if owed.kind == UPDATE and closing in found and found[closing][0] != OWED:
                outbox.dropped([owed.id], "the ticket is closed")
                return True
            if owed.kind == UPDATE and not state:  # its first tier was told to nobody: before the gateway, or by other settings
                about = Delivery(key=opening, recipient="tickets", kind=OPEN, document=owed.document, robot=owed.robot)
                outbox.owe(self.name, [about])
                outbox.dropped([owed.id], "a ticket is opened instead")
                return True
            number = answer.get("number") if state == DELIVERED and isinstance(answer, Mapping) else None
            url, method, fields = self._request(owed.kind)
            if number is None or not url:
                why = "no ticket of this alert is known" if number is None else f"{owed.kind}_url is not configured"
                outbox.dropped([owed.id], why)
                return True
            values = self._values(owed) | {"number": number}
            self._rest.send(method, filled_address(url, values), filled(fields, values), f"{owed.document['key']}-{owed.id}")
            outbox.delivered([owed.id], {"number": number})
        except TicketRefused as refused:
            why = self._surroundings.scrub(str(refused))
            self._failing = why
            outbox.failed([owed], why, dead_after_s=self._settings.give_up_days * DAY_S, wait_s=refused.wait_s)
            return False
        except MonitorError as error:
            if self._surroundings.now() - owed.made_at_unix_s > self._settings.give_up_days * DAY_S:
                outbox.failed([owed], self._surroundings.scrub(str(error)), dead_after_s=self._settings.give_up_days * DAY_S)
            raise
        return True

    def _request(self, kind: str) -> tuple[str, str, dict[str, Any]]:
        settings = self._settings
        if kind == CLOSE:
            return settings.close_url, settings.close_method, settings.close_fields
        return settings.update_url, settings.update_method, settings.update_fields

    def _open(self, owed: Owed) -> dict[str, Any]:
        """Open the ticket, unless it is there. Returns its number and address."""
        settings, values = self._settings, self._values(owed)
        number = None
        if owed.message is None:
            self._surroundings.outbox.gather([owed.id], str(values["key"]))  # from now on it may be there
        elif settings.find_url:
            number = _number(pointed(self._rest.ask(filled_address(settings.find_url, values)), settings.find_number))
        if number is None:
            url = filled_address(settings.open_url, values)
            answer, location = self._rest.send(settings.open_method, url, filled(settings.fields, values), str(values["key"]))
            number = _number(pointed(answer, settings.number)) or (location.rstrip("/").rpartition("/")[2] or None)
        web = filled_address(settings.web, {**values, "number": number}) if settings.web and number else None
        return {"number": number, "url": web}

    def _values(self, owed: Owed) -> dict[str, Any]:
        """What the places of a template become."""
        said, event = owed.document, owed.document["event"]
        arm = self._surroundings.arms().get(ArmName(said["site"], said["robot"]))
        change = event.get("change")
        return {
            "key": said["key"],
            "site": said["site"],
            "robot": said["robot"],
            "model": arm.model if arm is not None else None,
            "serial": arm.info.get("serial") if arm is not None else None,
            "joint": said["joint"],
            "joint_name": self._say.name(said["joint"]),
            "condition": said["condition"],
            "tier": said["tier"],
            "priority": self._settings.priority.get(str(said["tier"])),
            "headline": headline(said, self._say),
            "text": self._say.at({"text": said["text"], **event}, "text"),
            "action": self._say.at(event, "action"),
            "change_percent": round(100.0 * change, 1) if isinstance(change, int | float) else None,
            "raised_at": rfc3339(float(said["raised_at_unix_s"])),
            "at": rfc3339(float(said["at_unix_s"])),
            "link": page_of(self._surroundings.link, said["site"], said["robot"], said["condition"]),
        }


def key_of(alert_id: str) -> str:
    """A name of an alert for other systems: letters and digits alone, the same one for ever."""
    return f"joint-monitor-{hashlib.sha256(alert_id.encode()).hexdigest()[:32]}"


def _number(found: Any) -> str | None:
    """A ticket's number as text."""
    return str(found) if isinstance(found, str | int) and not isinstance(found, bool) and str(found) else None
