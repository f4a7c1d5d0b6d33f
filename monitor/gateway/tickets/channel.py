"""Tickets as a channel: each alert opens one, and what happens to the alert afterwards happens to its ticket. JSON over HTTP. I/O.

A request that may have arrived without its answer is repeated with the same Idempotency-Key. Where the maintenance system keeps no such
keys, `find_url` asks it first whether the ticket is there.
"""

import hashlib
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from zoneinfo import ZoneInfo

import orjson

from monitor.errors import MonitorError
from monitor.gateway.channel import Surroundings
from monitor.gateway.connection import (
    LARGEST,
    Answer,
    HttpClient,
    NotReached,
    Refused,
    Steps,
    believed,
    dial,
    http_reason,
    retry_after_s,
)
from monitor.gateway.outbox import DELIVERED, OWED, Owed
from monitor.gateway.tickets.settings import TicketSettings, filled, filled_address, pointed
from monitor.gateway.values import CLEARED, GRAVER, Delivery, Transition, document_of, page_of, transition_of
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S
from monitor.views.alert_sentence import JointPast, sentences
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
        except Refused as refused:
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
        told = transition_of(owed.document)
        arm = self._surroundings.arms().get(told.arm)
        return {
            "key": owed.document["key"],
            **told.arm._asdict(),
            "model": arm.model if arm is not None else None,
            "serial": arm.serial if arm is not None else None,
            "joint": told.joint,
            "joint_name": self._say.name(told.joint),
            "condition": told.condition,
            "tier": told.tier,
            "priority": self._settings.priority.get(told.tier),
            "headline": sentences(told.alert, JointPast(), told.at_unix_s, self._say).headline,
            "text": self._say.at(told.alert, "text"),
            "action": self._say.at(told.alert, "action"),
            "change_percent": round(100.0 * told.alert.change, 1),
            "raised_at": rfc3339(told.raised_at_unix_s),
            "at": rfc3339(told.at_unix_s),
            "link": page_of(self._surroundings.link, told),
        }


def key_of(alert_id: str) -> str:
    """A name of an alert for other systems: letters and digits alone, the same one for ever."""
    return f"joint-monitor-{hashlib.sha256(alert_id.encode()).hexdigest()[:32]}"


def _number(found: Any) -> str | None:
    """A ticket's number as text."""
    return str(found) if isinstance(found, str | int) and not isinstance(found, bool) and str(found) else None


REFUSED_WAIT_S = 300.0  # until a request that was refused is repeated: a person has to change something


class NotAllowed(Refused):
    """The maintenance system answers with a status that says no."""

    def __init__(self, text: str, status: int, wait_s: float) -> None:
        super().__init__(text, wait_s)
        self.step = "authentication" if status == 401 else "authorisation"


class Rest:
    """One maintenance system; its connection lasts a step."""

    def __init__(self, settings: TicketSettings, folder: Path) -> None:
        """Raises BadInput where ca_file is no certificate."""
        self._context = believed(settings.ca_file, folder, "tickets")
        self._headers = {"User-Agent": "joint-monitor", "Accept": "application/json", **settings.headers}
        if settings.authorization:
            self._headers["Authorization"] = settings.authorization
        self._client: HttpClient | None = None

    def send(self, method: str, url: str, body: Any, key: str) -> tuple[Any, str]:
        """The answer, and the address that it names. Raises Refused, MonitorError where nobody answers."""
        content = orjson.dumps(body)
        answer = self._request(method, url, {"Content-Type": "application/json", "Idempotency-Key": key}, content)
        return _json(answer), answer.headers.get("location", "")

    def ask(self, url: str) -> Any:
        """The answer to a question; None where there is nothing. Raises Refused, MonitorError where nobody answers."""
        answer = self._request("GET", url, {}, None, nothing=(404, 410))
        return _json(answer) if answer.is_success else None

    def try_it(self, settings: TicketSettings, steps: Steps) -> None:
        """Up to whether the maintenance system lets us in; nothing is opened there. Raises NotReached."""
        where = urlsplit(settings.open_url)
        safe = where.scheme == "https"
        dial(where.hostname or "", where.port or (443 if safe else 80), steps, self._context if safe else None).close()
        if not safe:
            steps.say("tls", "none, as open_url says: everybody on the way can read requests and authorization")
        if not settings.check_url:
            steps.say("authorisation", "not asked: check_url names an address that may be read, e.g. that of one ticket")
            return
        try:
            self.ask(settings.check_url)
        except NotAllowed as refused:
            raise NotReached(refused.step, f"{refused}: look at authorization, and at what it may do") from None
        except MonitorError as error:
            raise NotReached("http", str(error)) from None
        steps.say("authorisation", "check_url is answered")

    def close(self) -> None:
        """Close the connection."""
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def _request(self, method: str, url: str, headers: dict[str, str], content: bytes | None, nothing: tuple[int, ...] = ()) -> Answer:
        import httpx

        if self._client is None:
            self._client = HttpClient(self._context, self._headers)
        try:
            answer = self._client.request(method, url, headers, content)
        except (httpx.ConnectError, httpx.ConnectTimeout) as error:
            raise MonitorError(f"the maintenance system: {http_reason(error)}") from None
        except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
            # it may be this request that it does not survive, and the others shall get through
            raise Refused(f"the maintenance system: {http_reason(error)}", 0.0) from None
        if answer.is_success or answer.status in nothing:
            return answer
        said = " ".join(answer.text[:300].split())
        text = f"the maintenance system answers {answer}: {said}".rstrip(": ")
        wait_s = max(retry_after_s(answer.headers.get("retry-after")), REFUSED_WAIT_S if answer.status < 500 else 0.0)
        raise NotAllowed(text, answer.status, wait_s)


def _json(answer: Answer) -> Any:
    """The document of an answer; None where it is none: the ticket is there all the same."""
    try:
        return orjson.loads(answer.content) if 0 < len(answer.content) <= LARGEST else None
    except orjson.JSONDecodeError:
        return None
