"""The outbox: what is owed to whom, kept in the plant's database until it is delivered. Nothing is lost or owed twice over restarts. I/O.

A delivery is owed from the transaction in which its transition was taken. A channel gathers deliveries into a message, which has a name of
its own from then on; it sends the message, and notes that it has. A crash in between sends the same message again, with the same name:
whoever receives it can tell.
"""

import random
import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from monitor.errors import StoreUnavailable
from monitor.gateway.values import ACTIVE, ENDED, Delivery, Transition, document_of, transition_of
from monitor.plant.arm import ArmName
from monitor.plant.database import Database
from monitor.plant.lock import OnlyOne
from monitor.plant.tables import delivery
from monitor.publish.shown import tier_gravity
from monitor.recording import DAY_S

OWED, DELIVERED, DROPPED, DEAD = "owed", "delivered", "dropped", "dead"
FIRST_PAUSE_S, LONGEST_PAUSE_S = 10.0, 900.0  # between attempts; each is twice the one before
KEPT_S = 400 * DAY_S  # what has ended is kept so long
GATEWAY = "gateway"  # the channel of what the gateway notes for itself, for ever; kinds:
BEGAN = "began"  # that there is a gateway
KNOWN = "known"  # an arm: from now on everything that its log commits is new
TAKEN = "taken"  # a transition: it is told, or was there before; so a history that is copied anew owes nothing again
ALREADY = "already"  # an alert that is told from what its arm says, as its raising did not stand in the arm's log
LONGEST_ERROR = 500


class Owed(NamedTuple):
    """One delivery that is owed."""

    id: int
    key: str
    recipient: str
    kind: str
    robot: str | None
    document: Mapping[str, Any]
    made_at_unix_s: float
    due_at_unix_s: float
    message: str | None
    attempts: int
    error: str | None


class Past(NamedTuple):
    """One delivery that was made."""

    recipient: str
    kind: str
    robot: str | None
    document: Mapping[str, Any]
    message: str | None
    at_unix_s: float


class Answered(NamedTuple):
    """One delivery that was made, and what the other side said."""

    key: str
    robot: str | None
    document: Mapping[str, Any]
    answer: Any
    at_unix_s: float


@dataclass(frozen=True, slots=True)
class Noted:
    """What the gateway has noted of the arms, and what is told of the conditions of their joints (`Transition.place`)."""

    known: set[ArmName]
    tiers: dict[str, str]  # by place: the tier that was told last of an alert that is not over
    already: set[str]  # places whose alert is told, and was not raised in the arm's log

    def copy(self) -> "Noted":
        """Another one, to be changed."""
        return Noted(set(self.known), dict(self.tiers), set(self.already))

    def told(self, place: str, tier: str, *, already: bool) -> None:
        """Note what is told."""
        (self.already.add if already else self.already.discard)(place)
        self.tiers[place] = tier
        if tier == ENDED:
            del self.tiers[place]

    def new_to(self, place: str, tier: str) -> bool:
        """Whether nobody was told of this tier of an alert."""
        return tier_gravity(tier) > tier_gravity(self.tiers.get(place, ENDED))


class Outbox:
    """The deliveries of all channels. Several threads may use it; each channel touches its own alone."""

    def __init__(self, database: Database, now: Callable[[], float]) -> None:
        self._database, self._now = database, now
        self._lock = threading.Lock()
        self._unnoted: dict[tuple[int, ...], dict[str, Any]] = {}  # by deliveries: what is delivered, and could not be noted

    def began_unix_s(self) -> float:
        """Since when this plant has a gateway; now where it has none. Raises StoreError."""
        wanted = sa.select(delivery.c.made_at).where(delivery.c.key == _key(GATEWAY, BEGAN))
        with self._database.read() as connection:
            began = connection.execute(wanted).scalar_one_or_none()
        return self._now() if began is None else float(began)

    def noted(self) -> Noted | None:
        """What the gateway has noted for itself; None where there was none yet. Raises StoreError."""
        wanted = sa.select(delivery.c.kind, delivery.c.recipient, delivery.c.message, delivery.c.robot).where(delivery.c.channel == GATEWAY)
        wanted = wanted.where((delivery.c.recipient != "") | delivery.c.kind.in_((BEGAN, KNOWN))).order_by(delivery.c.id)
        with self._database.read() as connection:
            rows = connection.execute(wanted).all()
        noted = Noted({ArmName(*row.robot.split("/", 1)) for row in rows if row.kind == KNOWN}, {}, set())
        for row in rows:
            if row.recipient:
                noted.told(row.recipient, row.message, already=row.kind == ALREADY)
        return noted if any(row.kind == BEGAN for row in rows) else None

    def begin(self, connection: sa.Connection) -> None:
        """There is a gateway from now on, in this transaction."""
        self._note(connection, [Delivery(key=BEGAN, recipient="", kind=BEGAN, document={})])

    def note_known(self, connection: sa.Connection, arms: Iterable[ArmName]) -> None:
        """What these arms commit from now on is new, in this transaction."""
        self._note(connection, [Delivery(key=f"arm/{each}", recipient="", kind=KNOWN, document={}, robot=str(each)) for each in arms])

    def note_before(self, connection: sa.Connection, ids: Iterable[str]) -> None:
        """These transitions were there before anybody could be told, in this transaction."""
        self._note(connection, [Delivery(key=each, recipient="", kind=TAKEN, document={}) for each in ids])

    def note_taken(self, connection: sa.Connection, transitions: Iterable[Transition]) -> None:
        """These are told, in this transaction."""
        for each in transitions:
            kind, document = (ALREADY, {}) if each.kind == ACTIVE else (TAKEN, document_of(each))
            place, tier = (each.place, each.after) if each.changes_tier else ("", None)
            self._note(connection, [Delivery(key=each.id, recipient=place, kind=kind, document=document, robot=str(each.arm))], tier)

    def _note(self, connection: sa.Connection, noted: Iterable[Delivery], message: str | None = None) -> None:
        self.add(connection, GATEWAY, noted, state=DROPPED, message=message)

    def taken(self, ids: Collection[str]) -> set[str]:
        """Those of these transitions that are noted. Raises StoreError."""
        return set(self.found(GATEWAY, ids)) if ids else set()

    def told(self, begin_unix_s: float, end_unix_s: float) -> list[Transition]:
        """What was told between two times of this gateway's clock, in the order in which it came. Raises StoreError."""
        wanted = sa.select(delivery.c.document).where(delivery.c.channel == GATEWAY, delivery.c.kind == TAKEN)
        wanted = wanted.where(delivery.c.made_at >= begin_unix_s, delivery.c.made_at < end_unix_s).order_by(delivery.c.id)
        with self._database.read() as connection:
            return [transition_of(document) for document in connection.execute(wanted).scalars() if document]

    def add(
        self,
        connection: sa.Connection,
        channel: str,
        owed: Iterable[Delivery],
        *,
        state: str = OWED,
        answer: Any = None,
        message: str | None = None,
    ) -> None:
        """Owe these, in this transaction; what was owed before, by its key, is owed once."""
        now = self._now()
        rows = [
            {
                **{"key": _key(channel, each.key), "channel": channel, "recipient": each.recipient, "kind": each.kind, "robot": each.robot},
                **{"document": dict(each.document), "made_at": now, "due_at": max(each.due_at_unix_s, 0.0), "state": state, "attempts": 0},
                "message": message,
                **({"ended_at": now, "answer": answer} if state != OWED else {}),
            }
            for each in owed
        ]
        if rows:
            insert = (postgresql.insert if self._database.postgresql else sqlite.insert)(delivery)
            for row in rows:  # a row each: their columns may differ
                connection.execute(insert.on_conflict_do_nothing(index_elements=["key"]), row)

    def owe(self, channel: str, owed: Sequence[Delivery]) -> None:
        """Owe these, in a transaction of their own. Raises StoreError."""
        if owed:
            with self._database.write() as connection:
                self.add(connection, channel, owed)

    def owed(self, channel: str, *, due_by_unix_s: float | None = None, most: int = 10_000) -> list[Owed]:
        """What a channel owes, the oldest first. due_by_unix_s : only what is due until then. Raises StoreError.

        most : of more than these the ones that are due first, so that none waits behind others that are refused again and again.
        """
        self._note_again()
        wanted = _columns().where(delivery.c.channel == channel, delivery.c.state == OWED)
        if due_by_unix_s is not None:
            wanted = wanted.where(delivery.c.due_at <= due_by_unix_s)
        with self._database.read() as connection:
            found = connection.execute(wanted.order_by(delivery.c.due_at, delivery.c.id).limit(most))
            return sorted((Owed(*row) for row in found), key=lambda each: each.id)

    def found(self, channel: str, keys: Collection[str]) -> dict[str, tuple[str, Any]]:
        """State and answer of deliveries, by key; those that are not there are left out. Raises StoreError."""
        named = {_key(channel, key): key for key in keys}
        wanted = sa.select(delivery.c.key, delivery.c.state, delivery.c.answer).where(delivery.c.key.in_(list(named)))
        with self._database.read() as connection:
            return {named[key]: (state, answer) for key, state, answer in connection.execute(wanted)}

    def delivered_since(self, channel: str, unix_s: float) -> list[Past]:
        """What was delivered since then, the oldest first. Raises StoreError."""
        names = ("recipient", "kind", "robot", "document", "message", "ended_at")
        wanted = sa.select(*(delivery.c[name] for name in names))
        wanted = wanted.where(delivery.c.channel == channel, delivery.c.state == DELIVERED, delivery.c.ended_at >= unix_s)
        with self._database.read() as connection:
            return [Past(*row) for row in connection.execute(wanted.order_by(delivery.c.id))]

    def answered(self, channel: str, kind: str) -> list[Answered]:
        """What was delivered, with its answer, the newest first. Raises StoreError."""
        wanted = sa.select(delivery.c.key, delivery.c.robot, delivery.c.document, delivery.c.answer, delivery.c.ended_at)
        wanted = wanted.where(delivery.c.channel == channel, delivery.c.kind == kind, delivery.c.state == DELIVERED)
        with self._database.read() as connection:
            return [Answered(*row) for row in connection.execute(wanted.order_by(delivery.c.id.desc()))]

    def note(self, channel: str, about: Delivery, state: str, answer: Any = None) -> None:
        """Note something that is done already, so that it is not done again. Raises StoreError."""
        with self._database.write() as connection:
            self.add(connection, channel, [about], state=state, answer=answer)

    def gather(self, ids: Sequence[int], message: str) -> None:
        """Make these one message, before it is sent for the first time. Raises StoreError."""
        self._set(ids, message=message)

    def postpone(self, ids: Sequence[int], until_unix_s: float) -> None:
        """Not before this time. Raises StoreError."""
        self._set(ids, due_at=until_unix_s)

    def delivered(self, ids: Sequence[int], answer: Any = None) -> None:
        """These have arrived. Where the database is away, that is noted before anything else is asked of it. Raises StoreError."""
        values = {"state": DELIVERED, "ended_at": self._now(), "error": None, "answer": answer}
        with self._lock:
            self._unnoted[tuple(ids)] = values
        self._note_again()

    def dropped(self, ids: Sequence[int], why: str) -> None:
        """These are no longer needed. Raises StoreError."""
        self._set(ids, state=DROPPED, ended_at=self._now(), error=why)

    def failed(self, owed: Sequence[Owed], why: str, *, dead_after_s: float, wait_s: float | None = None) -> bool:
        """An attempt has failed: another one comes later, and later each time. Returns whether they are given up. Raises StoreError.

        dead_after_s : after this time since it was due a delivery is given up. wait_s : what the other side asked for.
        """
        now = self._now()
        attempts = max(each.attempts for each in owed)
        pause_s = min(FIRST_PAUSE_S * 2.0 ** min(attempts, 20), LONGEST_PAUSE_S) * random.uniform(0.8, 1.2)
        dead = all(now - each.made_at_unix_s > dead_after_s for each in owed) and attempts > 0
        values: dict[str, Any] = {"attempts": attempts + 1, "error": why[:LONGEST_ERROR]}
        values |= {"state": DEAD, "ended_at": now} if dead else {"due_at": now + max(pause_s, wait_s or 0.0)}
        self._set([each.id for each in owed], **values)
        return dead

    def refused(self, ids: Sequence[int], why: str) -> None:
        """The other side will never take these. Raises StoreError."""
        self._set(ids, state=DEAD, ended_at=self._now(), error=why[:LONGEST_ERROR])

    def end(self, connection: sa.Connection, ids: Sequence[int]) -> None:
        """These hold no longer, in this transaction."""
        if ids:
            ended = {"state": DROPPED, "ended_at": self._now()}
            connection.execute(sa.update(delivery).where(delivery.c.id.in_(list(ids))).values(**ended))

    def prune(self) -> None:
        """Forget what has ended long ago. Raises StoreError."""
        old, own = (delivery.c.state != OWED) & (delivery.c.ended_at < self._now() - KEPT_S), delivery.c.channel == GATEWAY
        with self._database.write() as connection:
            connection.execute(sa.delete(delivery).where(old, ~own))
            connection.execute(sa.update(delivery).where(old, own).values(document={}, ended_at=None))

    def _note_again(self) -> None:
        with self._lock:
            for ids, values in list(self._unnoted.items()):
                self._set(ids, **values)  # in one transaction: a part of a message would be sent again as another one
                del self._unnoted[ids]

    def _set(self, ids: Sequence[int], **values: Any) -> None:
        if ids:
            with self._database.write() as connection:
                connection.execute(sa.update(delivery).where(delivery.c.id.in_(list(ids)), delivery.c.state == OWED).values(**values))


def _columns() -> Any:
    names = ("id", "key", "recipient", "kind", "robot", "document", "made_at", "due_at", "message", "attempts", "error")
    return sa.select(*(delivery.c[name] for name in names))


def _key(channel: str, key: str) -> str:
    return f"{channel}:{key}"


# --- One gateway alone works with a database: two of them would send everything twice

KEY = 7_447_027  # of the advisory lock


class AnotherGateway(StoreUnavailable):
    """Another gateway works with this database: this one waits for its end."""


class GatewayLock:
    """The lock. `take` again and again is cheap."""

    def __init__(self, database: Database) -> None:
        self._lock, self._name = OnlyOne(database, "gateway", KEY), database.name

    def take(self) -> None:
        """Take the lock, or see that it is still ours. Raises AnotherGateway, StoreUnavailable."""
        if not self._lock.take():
            raise AnotherGateway(f"another gateway works with {self._name}; nothing is sent here until it ends")

    def release(self) -> None:
        """Give it back."""
        self._lock.release()
