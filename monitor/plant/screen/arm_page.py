"""One arm's page, as its own daemon shows it: filled from the plant's database, and from the arm itself while somebody looks. I/O."""

import csv
import io
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import orjson
import sqlalchemy as sa

from monitor.errors import BadInput, BusError
from monitor.judge.settings import HealthSettings, PrognosisSettings
from monitor.model.robot import Mounting, load_robot
from monitor.plant.arm import ArmName, copied_friction
from monitor.plant.database import Database
from monitor.plant.links import Link, command_arm
from monitor.plant.screen.access import Audit
from monitor.plant.status import refuse_doubled
from monitor.plant.tables import FIGURES, arm, friction, last_value, transition
from monitor.publish.documents import Content, Info, LastReplay, Monitor
from monitor.publish.documents import encoded as as_bytes
from monitor.publish.registry import Delivery, published_at
from monitor.publish.timestamps import rfc3339, written, written_if
from monitor.reason import with_reasons
from monitor.views.history import mark_text
from monitor.views.web.page_content import EVENTS, MAX_REPLAYS, NEWEST_REPLAYS, SERIES, BusAccess, about_arm, columns, thinned

ROWS = 5000  # read at once
PAST_WINDOWS = 400  # newest replays that the page counts as one row
MOST_JOINTS = 8  # of an arm
UNWATCHED_S = 60.0  # without a look at an arm for so long, its live values are no longer received
TOLD = ("joint", "condition", "kind", "item", "hours", "why")  # keys of a command that its line in the audit repeats
ASSUMED_ROBOT = {"mounting": "ground", "payload_kg": 0.0, "tool": "?"}


Ways = Callable[[ArmName], Sequence[Link]]  # the routers that answer and behind which an arm is


def ask(ways: Ways, name: ArmName, key: str, about: Mapping[str, Any]) -> dict[str, Any]:
    """An arm's answer. Raises BadInput where it does not answer."""
    return command_arm(next(iter(ways(name)), None), name, key, about)


def send(database: Database, ways: Ways, audit: Audit, name: ArmName, command: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """Send a command to an arm. What came of it stands in the audit. Raises BadInput where the arm refuses it."""
    who, robot = str(document.get("by") or "this machine"), str(name)
    about = ", ".join(f"{key} {document[key]}" for key in TOLD if document.get(key) is not None)
    try:
        refuse_doubled(database, name.site, name.robot)
        answer = ask(ways, name, f"cmd/{command}", document)
    except BadInput as error:
        audit(who, command, robot, f"{about}: refused by the arm: {error}")
        raise
    audit(who, command, robot, about or "done")
    return answer


class Row(NamedTuple):
    """An arm in the database."""

    number: int
    history: int


class Assessed(NamedTuple):
    """A replay that was judged."""

    replay: int
    at_unix_s: float


class LiveValues:
    """The last values of one arm: those of the database, and those that it says itself since somebody looks. It is a `BusAccess`."""

    def __init__(self, name: ArmName, ways: Ways, stored: Callable[[], dict[str, bytes]]) -> None:
        self._name, self._ways, self._stored = name, ways, stored
        self._watching = threading.Lock()  # while sessions are asked
        self._lock = threading.Lock()  # of the values; sessions' threads take it
        self._values: dict[str, bytes] = {}
        self._subscriber: Any = None
        self._looked_at = time.monotonic()
        self.dropped = 0

    def last_payloads(self) -> dict[str, bytes]:
        """The last value of every key. The first look asks the arm for all of them."""
        self._looked_at = time.monotonic()
        with self._watching:
            if self._subscriber is None:
                stored = self._stored()
                with self._lock:
                    self._values = stored
                self._subscriber = self._watch()
        with self._lock:
            return dict(self._values)

    def rest(self) -> bool:
        """Receive nothing more where nobody has looked for a while. Returns whether it still receives."""
        with self._watching:
            if self._subscriber is not None and time.monotonic() - self._looked_at > UNWATCHED_S:
                self._subscriber.undeclare()
                self._subscriber = None
            return self._subscriber is not None

    def _watch(self) -> Any:
        """None where no router answers: the next look tries again."""
        for link in self._ways(self._name):
            try:
                return link.watch(self._name, self._heard)
            except BusError:
                continue
        return None

    def _heard(self, key: str, payload: bytes) -> None:
        if _readable(key, payload):
            with self._lock:
                self._values[key] = payload

    def ask(self, key: str, about: Mapping[str, Any]) -> Mapping[str, Any]:
        """The arm's answer. Raises BadInput where it does not answer."""
        return ask(self._ways, self._name, key, about)


class ArmContent:
    """What the page of one arm shows: a `PageContent`."""

    report: Callable[[str], str] | None = None  # the report reads what only the arm's own store holds
    bus: BusAccess

    def __init__(self, name: ArmName, database: Database, ways: Ways, audit: Audit, language: str) -> None:
        """Raises KeyError where the plant knows no such arm, StoreError where the database does not answer."""
        self._name, self._database, self._ways, self._audit = name, database, ways, audit
        self.language = language
        self.file_name = f"{name.site}-{name.robot}"
        self._row()
        self.bus = self.live = LiveValues(name, ways, self._stored)
        self.about = self._about()
        self.table: Callable[[str], str] | None = self._table

    @property
    def now(self) -> Callable[[], float]:
        """The plant's clock."""
        return time.time

    def history(self) -> dict[str, Any]:
        """The history of every joint as columns: old replays thinned, the newest complete."""
        at = self._row()
        own = (friction.c.arm == at.number, friction.c.history == at.history)
        with self._database.read() as connection:
            numbers = connection.execute(sa.select(friction.c.replay).where(*own, friction.c.joint == 1).order_by(friction.c.recorded_at))
            ids = [replay for (replay,) in numbers]
            shown = thinned(ids, MAX_REPLAYS, NEWEST_REPLAYS)
            wanted = sa.select(friction.c.replay, friction.c.joint, friction.c.recorded_at, *(friction.c[name] for name in SERIES))
            rows = connection.execute(wanted.where(*own, friction.c.replay.in_(shown)).order_by(friction.c.recorded_at, friction.c.joint))
            documents = [(replay, joint, at, dict(zip(SERIES, figures, strict=True))) for replay, joint, at, *figures in rows]
        return columns(documents) | {"replays": len(ids), "shown": len(shown), "marks": []}

    def began_unix_s(self, joint: int | None = None) -> float | None:  # noqa: ARG002 - of PageContent: work is not copied
        """The first replay; None without one."""
        return self._time(sa.func.min)

    def newest_unix_s(self) -> float | None:
        """When the last replay was recorded; None without one."""
        return self._time(sa.func.max)

    def act(self, command: str, document: Mapping[str, Any]) -> Mapping[str, Any]:
        """Send a command to the arm. What came of it stands in the audit. Raises BadInput where the arm refuses it."""
        return send(self._database, self._ways, self._audit, self._name, command, document)

    def schedule(self) -> dict[str, Any]:
        """The next replay, the last windows as far as they are copied, and the last transitions of alerts, newest first."""
        at = self._row()
        monitor = self._said(Monitor, "monitor")
        due = None if monitor is None else written_if(monitor.next_replay_due)
        coming = [{"opens": due, "closes": due, "why": monitor.next_replay_why or ""}] if monitor is not None and due else []
        with self._database.read() as connection:
            newest = sa.select(transition).where(transition.c.arm == at.number, transition.c.history == at.history)
            rows = connection.execute(newest.order_by(transition.c.seq.desc()).limit(EVENTS)).all()
            of_first = (friction.c.arm == at.number, friction.c.history == at.history, friction.c.joint == 1)
            judged = sa.select(friction.c.replay, friction.c.recorded_at).where(*of_first)
            assessed = connection.execute(judged.order_by(friction.c.recorded_at.desc()).limit(PAST_WINDOWS)).all()
        windows = _windows([Assessed(*row) for row in assessed], None if monitor is None else monitor.last_replay)
        events = [
            {
                "seq": row.seq,
                "at": rfc3339(row.at),
                "kind": row.kind,
                "joint": row.joint,
                "condition": row.condition,
                "tier": row.tier,
                "text": mark_text(row.document),
            }
            for row in rows
        ]
        return {"coming": coming, "timezone": "UTC", "windows": windows, "events": events}

    def monitor(self) -> dict[str, Any]:
        """The state of the arm's own monitor, as it said it last."""
        said = self._said(Monitor, "monitor")
        return {
            "version": "?" if said is None else said.version,
            "now": None if said is None else written(said.said_at),
            "up_s": 0.0 if said is None else said.uptime_s,
            "resident_mb": None if said is None else _scaled(said.process.resident_bytes, 1e6),
            "disk_free_gb": None if said is None else _scaled(said.store.free_bytes, 1e9),
            "disk_free_share": None,
            "history_mb": None if said is None else _scaled(said.store.history_bytes, 1e6),
            "documents_dropped": 0 if said is None else said.bus.dropped,
            "last_windows": {},
            "stops": [],
        }

    def _about(self) -> dict[str, Any]:
        info = self._said(Info, "info")
        robot = {**ASSUMED_ROBOT, **({} if info is None else info.robot), "site": self._name.site, "id": self._name.robot}
        try:
            described = load_robot(str(robot.get("model")))
        except BadInput:  # the arm has not said its model yet, or it is one of a later version
            described = load_robot("ur5e")
            robot["model"] = str(robot.get("model") or "?")
        try:
            mounting = Mounting.parse(str(robot["mounting"]))
        except BadInput:
            mounting = Mounting.parse("ground")
        return about_arm(robot, self._name.prefix, described, mounting, HealthSettings(), PrognosisSettings())

    def _table(self, _code: str) -> str:
        """Friction of every replay as CSV."""
        at = self._row()
        out = io.StringIO()
        write = csv.writer(out)
        write.writerow(["recorded_at", "replay", "joint", *FIGURES])
        wanted = sa.select(friction).where(friction.c.arm == at.number, friction.c.history == at.history)
        with self._database.read() as connection:
            wanted = wanted.order_by(friction.c.recorded_at, friction.c.joint).execution_options(yield_per=ROWS)
            for row in connection.execute(wanted):
                write.writerow([rfc3339(row.recorded_at), row.replay, row.joint, *(getattr(row, name) for name in FIGURES)])
        return out.getvalue()

    def _row(self) -> Row:
        with self._database.read() as connection:
            wanted = sa.select(arm.c.id, arm.c.history).where(arm.c.site == self._name.site, arm.c.robot == self._name.robot)
            found = connection.execute(wanted).one_or_none()
        if found is None:
            raise KeyError(str(self._name))
        return Row(*found)

    def _stored(self) -> dict[str, bytes]:
        at = self._row()
        with self._database.read() as connection:
            rows = connection.execute(sa.select(last_value.c.key, last_value.c.document).where(last_value.c.arm == at.number)).all()
            own = (friction.c.arm == at.number, friction.c.history == at.history)
            newest = connection.execute(sa.select(friction).where(*own).order_by(friction.c.recorded_at.desc()).limit(MOST_JOINTS)).all()
        encoded = {key: orjson.dumps(document) for key, document in rows}
        for row in reversed(newest):  # of an arm that is not heard, the copied history knows what it said last
            if (copied := copied_friction(row)) is not None:
                encoded[f"joint/{row.joint}/friction"] = as_bytes(copied)
        return {key: payload for key, payload in encoded.items() if _readable(key, payload)}

    def _said(self, model: type[Content], key: str) -> Content | None:
        """What the arm said last on a key."""
        payload = self.bus.last_payloads().get(key)
        return None if payload is None else model.model_validate_json(payload)

    def _time(self, which: Callable[..., Any]) -> float | None:
        at = self._row()
        with self._database.read() as connection:
            wanted = sa.select(which(friction.c.recorded_at)).where(friction.c.arm == at.number, friction.c.history == at.history)
            found = connection.execute(wanted).scalar_one_or_none()
        return None if found is None else float(found)


def _readable(key: str, payload: bytes) -> bool:
    """Whether it is a last value of this key: an arm of another make may say anything."""
    kind = published_at(key)
    if kind is None or kind.delivery is Delivery.TRANSITION:
        return False
    try:
        kind.model.model_validate_json(payload)
    except ValueError:
        return False
    return True


def _windows(assessed: Sequence[Assessed], last: LastReplay | None) -> list[dict[str, Any]]:
    """Windows as the page lists them: the newest one, where it ended otherwise, above the replays that were judged.

    assessed : newest first.
    """
    nothing: dict[str, Any] = {"kind": "scheduled", "tries": [], "borrowed": None}
    found: list[dict[str, Any]] = []
    if last is not None and last.state != "assessed":
        at = written(last.window)
        window = {"replay": last.replay, "window": at, "from": at, "count": 1, "state": last.state}
        found.append({**with_reasons(window, reason=last.says("reason")), **nothing})
    if assessed:
        newest, oldest = assessed[0], assessed[-1]
        window = {"replay": newest.replay, "window": rfc3339(newest.at_unix_s), "from": rfc3339(oldest.at_unix_s), "count": len(assessed)}
        found.append({**window, "state": "assessed", "reason": None, **nothing})
    return found


def _scaled(value: float | None, unit: float) -> float | None:
    return None if value is None else round(value / unit, 2)
