"""What the screen's list shows: every arm with its joints and alerts, and one joint among its peers. From the database. I/O."""

import gzip
import logging
import threading
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import orjson
import sqlalchemy as sa

from monitor import __version__
from monitor.errors import StoreError
from monitor.plant.arm import MOST_JOINTS, ArmName, HeardArm
from monitor.plant.database import Database
from monitor.plant.status import PlantStatus, Ticket, arm_document, open_tickets, plant_status
from monitor.plant.tables import friction
from monitor.publish.documents import Alert
from monitor.publish.shown import alert_pill, person
from monitor.publish.timestamps import rfc3339
from monitor.views.language.catalogue import ENGLISH, Language, language

log = logging.getLogger(__name__)

FRESH_S = 2.0  # so long an answer is given again: many browsers cost no more than one
OLD_S = 30.0  # an older answer is given to nobody: reading it anew is waited for
MOST_ALERTS = 100  # of one arm; eight joints cannot have as many
ALERT_FIELDS = ("joint", "condition", "tier", "raised_at", "acknowledged_at", "acknowledged_by", "shelved_until")
PEER_FIGURES = ("wear", "wear_std", "wear_rate_per_day", "reference_torque_nm")


Tickets = Mapping[tuple[str, int | None, str], Ticket]  # by arm, joint and condition


class _List(NamedTuple):
    """What was read at one moment."""

    status: PlantStatus | None  # None: nothing was read yet
    tickets: Tickets
    encoded: dict[str, tuple[bytes, bytes]]  # by language, plain and compressed; of those languages that somebody has asked for

    def encoded_in(self, code: str) -> tuple[bytes, bytes]:
        """The list in a language."""
        if code not in self.encoded:
            assert self.status is not None
            plain = orjson.dumps(listed(self.status, self.tickets, language(code)))
            self.encoded[code] = plain, gzip.compress(plain, 1)
        return self.encoded[code]


class Fleet:
    """The list of all arms. Who asks gets what was read last, and has it read anew. Several threads may use it."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._reading = threading.Lock()
        self._read_at = -OLD_S
        self._newest = _List(None, {}, {})

    def document(self, code: str, *, packed: bool = False) -> bytes:
        """The list as JSON in a language, at most half a minute old. Raises StoreError where the database does not answer.

        packed : compressed. A browser asks for it every three seconds, and 1000 arms are 600 kB.
        """
        return self._fresh().encoded_in(code)[packed]

    def read(self) -> tuple[PlantStatus, Tickets]:
        """The same before it is put into words. Raises StoreError."""
        newest = self._fresh()
        assert newest.status is not None
        return newest.status, newest.tickets

    def arm(self, name: ArmName) -> tuple[HeardArm, PlantStatus, Tickets]:
        """One arm of it. Raises StoreError, and KeyError for an unknown arm."""
        status, tickets = self.read()
        found = next((each for each in status.arms if each.name == name), None)
        if found is None:
            raise KeyError(str(name))
        return found, status, tickets

    def _fresh(self) -> _List:
        age_s = time.monotonic() - self._read_at
        if age_s >= OLD_S:
            with self._reading:
                if time.monotonic() - self._read_at >= FRESH_S:
                    self._keep()
        elif age_s >= FRESH_S and self._reading.acquire(blocking=False):
            threading.Thread(target=self._read_in_background, name="fleet", daemon=True).start()
        return self._newest

    def _read_in_background(self) -> None:
        try:
            self._keep()
        except StoreError as error:
            log.debug("the list of arms is not read: %s", error)  # whoever asks when it is old is told
        finally:
            self._reading.release()

    def _keep(self) -> None:
        status = plant_status(self._database)
        tickets = {(each.robot, each.joint, each.condition): each for each in open_tickets(self._database)}
        newest = _List(status, tickets, {})
        for code in self._newest.encoded:  # whoever asks in these languages need not wait for it
            newest.encoded_in(code)
        self._newest, self._read_at = newest, time.monotonic()

    def newest(self, of: HeardArm) -> dict[int, Any]:
        """The newest row of each joint of an arm. Raises StoreError."""
        with self._database.read() as connection:
            found = {joint: connection.execute(_newest(of, joint)).one_or_none() for joint in range(1, MOST_JOINTS + 1)}
        return {joint: row for joint, row in found.items() if row is not None}

    def peers(self, of: HeardArm, joint: int) -> dict[str, Any]:
        """The last figures of this joint and of the same joint of every arm of its model. Raises StoreError."""
        arms = [each for each in self.read()[0].arms if each.name == of.name or (of.model is not None and each.model == of.model)]
        found = []
        with self._database.read() as connection:
            for each in arms:
                figures = connection.execute(_newest(each, joint, "recorded_at", *PEER_FIGURES)).one_or_none()
                if figures is not None:
                    values = {figure: getattr(figures, figure) for figure in PEER_FIGURES}
                    about = {"this": each.name == of.name, "recorded_at": rfc3339(figures.recorded_at)}
                    found.append({**each.name._asdict(), **about, **values})
        return {"model": of.model, "joint": joint, "peers": found}


def _newest(of: HeardArm, joint: int, *names: str) -> sa.Select[Any]:
    """The newest row of a joint in an arm's present history: these columns, else all."""
    columns = [friction.c[name] for name in names] or list(friction.c)
    own = sa.select(*columns).where(friction.c.arm == of.number, friction.c.history == of.histories, friction.c.joint == joint)
    return own.order_by(friction.c.recorded_at.desc()).limit(1)


def listed(status: PlantStatus, tickets: Tickets, say: Language) -> dict[str, Any]:
    """The list in a language."""
    return {
        "not_running": None if status.not_running is None else say.say(status.not_running),
        "ways": status.ways,
        "version": __version__,
        "said_at": rfc3339(status.at_unix_s),
        "arms": [shown_arm(each, tickets, status.at_unix_s, say) for each in status.arms],
    }


def shown_arm(arm: HeardArm, tickets: Tickets, now_unix_s: float, say: Language = ENGLISH) -> dict[str, Any]:
    """What the list shows of an arm."""
    return {
        **arm_document(arm, now_unix_s, say),
        "joints": [each.shown.pill.value for each in arm.joints],
        "alerts": [
            shown_alert(each, tickets.get((str(arm.name), each.joint, each.condition)), arm.clock(now_unix_s), say)
            for each in arm.alerts[:MOST_ALERTS]
        ],
    }


def shown_alert(alert: Alert, ticket: Ticket | None, now_unix_s: float, say: Language) -> dict[str, Any]:
    """What the list shows of an alert. now_unix_s : by the arm's own clock."""
    return {
        **alert.model_dump(mode="json", include={*ALERT_FIELDS}),
        "pill": alert_pill(alert).value,
        "person": person(alert, now_unix_s).value,
        "text": say.at(alert, "text"),
        "ticket": None if ticket is None else {"number": ticket.number, "url": ticket.url},
    }
