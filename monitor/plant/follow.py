"""Following the arms: what the sessions hand over becomes rows, jobs for copying, and an arm's silence. One thread calls it. I/O."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import orjson
import sqlalchemy as sa
from pydantic import BaseModel

from monitor.errors import BadInput, StoreError
from monitor.plant.arm import DOUBLED, UNREADABLE, Arm, ArmName, readable_health, unreadable_health
from monitor.plant.database import Database, DataRefused
from monitor.plant.ingest import enter, keep_last_values, set_arms
from monitor.plant.links import MONITOR, Inbox, Link
from monitor.plant.pull import Copying, read_document
from monitor.plant.tables import arm as arm_table
from monitor.plant.tables import history
from monitor.publish.documents import Health, Monitor, as_json, read
from monitor.publish.registry import published_at
from monitor.publish.shown import Grade, arm_shown
from monitor.reason import Reason, Sentence

log = logging.getLogger(__name__)

NAMED = 3  # arms whose names are logged where many change at once: a router that is lost is one line, not a thousand
NOT_STORED = Sentence("health_not_stored", "its document health cannot be stored: {why}")
STANDBY_KEEPS_S = 60.0  # of last values; longer than it takes to take over
LARGEST = 1_000_000  # bytes of a last value; the largest of ours have 50 000


class Counts(NamedTuple):
    """The plant in figures."""

    arms: int
    sick: int
    silent: int
    problems: int
    copying: int


class Following:
    """All arms that were ever seen."""

    def __init__(
        self, database: Database, inbox: Inbox, links: Mapping[str, Link], copying: Copying, silent_s: float, now: Callable[[], float]
    ) -> None:
        self._database, self._inbox, self._links, self._copying = database, inbox, links, copying
        self._silent_s, self._now = silent_s, now
        self.arms: dict[ArmName, Arm] = {}
        self._unsaved: dict[tuple[ArmName, str], tuple[float, Any]] = {}
        self._to_copy: dict[ArmName, bool] = {}  # with last values?
        self._problems_changed: set[ArmName] = set()  # not in the database yet

    def counts(self) -> Counts:
        """For people."""
        arms = self.arms.values()
        return Counts(
            arms=len(arms),
            sick=sum(arm.sick for arm in arms),
            silent=sum(arm.silent is not None for arm in arms),
            problems=sum(arm.problem is not None for arm in arms),
            copying=self._copying.length + len(self._to_copy),
        )

    def receive(self) -> StoreError | None:
        """Take what has come, without the database. Returns the database's trouble that a copying thread met."""
        now = time.monotonic()
        for link in self._links.values():
            link.check()
        self._take_ways(now)
        received = self._inbox.take()
        for name, payloads in received.monitors.items():
            for payload in payloads:
                with suppress(BadInput):
                    if name in self.arms and isinstance(said := _read(MONITOR, payload, now).document, Monitor):
                        self.arms[name].hear_monitor(said, now)
        for (name, key), payload in received.newest.items():
            if (arm := self.arms.get(name)) is not None:
                self._document(name, arm, key, payload, now)
        for name in received.triggered:
            if name in self.arms:
                self._to_copy.setdefault(name, False)
        trouble = self._take_outcomes(now)
        for name, arm in self.arms.items():
            if arm.doubled(now):  # neither history is copied: nobody could tell them apart
                self._to_copy.pop(name, None)
                self._tell_problem(name, DOUBLED)
            elif arm.problem is not None and arm.ways and (now >= arm.due_again or arm.problem == DOUBLED):
                self._to_copy.setdefault(name, False)
        return trouble

    def write(self) -> None:
        """Bring the database up to date with what was received, and start copying. Raises StoreError; nothing is lost then."""
        new = [name for name, arm in self.arms.items() if arm.number is None]
        if new:
            for name, number in enter(self._database, new, self._now()).items():
                self.arms[ArmName(*name)].number = number
        self._write_silence()
        self._write_last_values()
        for name, last_values in list(self._to_copy.items()):
            ways = self.arms[name].ways
            if not ways or self._copying.ask(name, ways, last_values=last_values, doubtful=self.arms[name].failures > 0):
                del self._to_copy[name]  # one that is being copied now is asked once more afterwards

    def stand_by(self) -> None:
        """Keep what a plant needs that takes over: what is older, the one that leads has written."""
        oldest = self._now() - STANDBY_KEEPS_S
        self._unsaved = {at: value for at, value in self._unsaved.items() if value[0] >= oldest}

    def look_again(self) -> None:
        """Compare with the database's own list: after an outage, or when somebody emptied it, arms are copied from where it is.

        Raises StoreError.
        """
        with self._database.read() as connection:
            columns = (arm_table.c.site, arm_table.c.robot, arm_table.c.id, arm_table.c.silent_why, arm_table.c.problem)
            logs = (history.c.event_cursor, history.c.change_cursor, history.c.history_id)
            joined = (history.c.arm == arm_table.c.id) & (history.c.number == arm_table.c.history)
            rows = connection.execute(sa.select(*columns, *logs).join(history, joined)).all()
        now = time.monotonic()
        there = set()
        for site, robot, number, silent, problem, event, change, identity in rows:
            name = ArmName(site, robot)
            there.add(name)
            arm = self.arms.setdefault(name, Arm(since=now))
            if arm.ways and (arm.number != number or event < arm.event or change < arm.change):
                self._to_copy.setdefault(name, arm.number != number)
            arm.number, arm.silent, arm.problem = number, silent, problem
            arm.event, arm.change, arm.history_id = event, change, identity
        for name, arm in [*self.arms.items()]:
            if name not in there and arm.number is not None:
                if not arm.ways:  # somebody has forgotten it, and it is not there
                    del self.arms[name]
                    self._to_copy.pop(name, None)
                    self._unsaved = {at: value for at, value in self._unsaved.items() if at[0] != name}
                    continue
                arm.number, arm.event, arm.change, arm.silent, arm.problem = None, -1, -1, None, None
                self._to_copy[name] = True

    def _take_ways(self, now: float) -> None:
        while not self._inbox.ways.empty():
            endpoint, up = self._inbox.ways.get()
            for name, arm in self.arms.items():
                if up and endpoint in arm.ways:
                    self._to_copy[name] = True
        while not self._inbox.tokens.empty():
            endpoint, name, there = self._inbox.tokens.get()
            arm = self.arms.setdefault(name, Arm(since=now))
            if there:
                if not arm.ways:
                    arm.heard = now
                arm.ways.add(endpoint)
                arm.last_ways = set(arm.ways)
                self._to_copy[name] = True
            else:
                arm.ways.discard(endpoint)
                arm.gone = now

    def _document(self, name: ArmName, arm: Arm, key: str, payload: bytes, now: float) -> None:
        arm.heard = now
        try:
            said = _read(key, payload, self._now())
        except BadInput as error:
            if key != "health":
                return
            health = unreadable_health(UNREADABLE(why=error.reason), self._now())
            said = Heard(health, as_json(health))
        if isinstance(said.document, Health):
            arm.sick = arm_shown(said.document).grade is Grade.SICK
        elif isinstance(said.document, Monitor):
            arm.hear_monitor(said.document, now)
            if arm.behind(said.document):
                self._to_copy.setdefault(name, False)
        if arm.worth_saving(said.document, now):
            self._unsaved[name, key] = (self._now(), said.json)

    def _take_outcomes(self, now: float) -> StoreError | None:
        trouble = None
        changed: dict[str, list[ArmName]] = {}
        while not self._copying.done.empty():
            name, known, problem, database = self._copying.done.get()
            arm = self.arms.get(name)
            if arm is None:
                continue  # forgotten in the meantime
            if known is not None:
                arm.number, arm.history_id, arm.event, arm.change = known.arm, known.history_id, known.event.seq, known.change.seq
            if database is not None:
                trouble = database
                self._to_copy.setdefault(name, False)
                continue
            if known is None and problem is None:
                continue  # there was no way to it: nothing is known that was not known before
            arm.copied(problem, now)
            if arm.doubled(now):
                continue
            if arm.problem != problem:
                changed.setdefault(problem.text if problem else "", []).append(name)
                arm.problem = problem
                self._problems_changed.add(name)
        for why, names in changed.items():
            if why:
                log.warning("%s: not copied: %s", _listed(names), why)
            else:
                log.info("%s: copied again", _listed(names))
        return trouble

    def _tell_problem(self, name: ArmName, problem: Reason) -> None:
        arm = self.arms[name]
        if arm.problem != problem:
            log.warning("%s: not copied: %s", name, problem.text)
            arm.problem = problem
            self._problems_changed.add(name)

    def _write_last_values(self) -> None:
        """All at once; where that is refused, one by one, so that a single wrong document keeps no other out."""
        saved = dict(self._unsaved)
        try:
            self._keep(saved)
        except DataRefused:
            self.look_again()  # somebody may have forgotten an arm
            for (name, key), (at, document) in saved.items():
                try:
                    self._keep({(name, key): (at, document)})
                except DataRefused as refused:
                    log.warning("%s: its %s is not stored: %s", name, key, refused)
                    if key == "health":
                        self._keep({(name, key): (at, as_json(unreadable_health(NOT_STORED(why=str(refused)), at)))})
        for at, value in saved.items():
            if self._unsaved.get(at) is value:
                del self._unsaved[at]

    def _keep(self, values: Mapping[tuple[ArmName, str], tuple[float, Any]]) -> None:
        numbers = {name: arm.number for name, arm in self.arms.items()}
        rows = {(number, key): value for (name, key), value in values.items() if (number := numbers.get(name)) is not None}
        keep_last_values(self._database, rows)

    def _write_silence(self) -> None:
        now, wall = time.monotonic(), self._now()
        lost = [endpoint for endpoint, link in self._links.items() if not link.up]
        changed: list[dict[str, Any]] = []
        was: dict[ArmName, Reason | None] = {}
        for name, arm in self.arms.items():
            why = arm.silence(now, self._silent_s, lost)
            if why == arm.silent and name not in self._problems_changed:
                continue
            since = None if why is None else wall
            changed.append({"number": arm.number, "since": since, "why": why, "problem": arm.problem})
            was[name] = why
        set_arms(self._database, changed)
        news: dict[str, list[ArmName]] = {}
        for name, why in was.items():
            if self.arms[name].silent != why:
                news.setdefault(why.text if why else "", []).append(name)
            self.arms[name].silent = why
        for text, names in news.items():
            if text:
                log.warning("%s: not heard: %s", _listed(names), text)
            else:
                log.info("%s: heard again", _listed(names))
        self._problems_changed.clear()


class Heard(NamedTuple):
    """A last value: as a type, and as it came."""

    document: BaseModel
    json: Any


def _read(key: str, payload: bytes, at_unix_s: float) -> Heard:
    """A last value. Raises BadInput where it is none."""
    kind = published_at(key)
    if kind is None or len(payload) > LARGEST:
        raise BadInput(f"{len(payload)} bytes, and {LARGEST} are read at most")
    try:
        found = read_document(payload)
        orjson.dumps(found)  # it can be read in more levels than anybody can write
    except (ValueError, TypeError) as wrong:
        raise BadInput(str(wrong).splitlines()[0]) from None
    if not isinstance(found, dict):
        raise BadInput("it is no JSON object")
    if kind.model is Health:
        return Heard(readable_health(found, at_unix_s), found)
    return Heard(read(kind.model, found), found)


def _listed(names: Sequence[ArmName]) -> str:
    """Arms by name, or their number with the first ones."""
    few = ", ".join(str(name) for name in names[:NAMED])
    return few if len(names) <= NAMED else f"{len(names)} arms ({few}, …)"
