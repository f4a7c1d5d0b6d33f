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
from monitor.plant.database import Database
from monitor.plant.links import ArmName, Link, command_arm
from monitor.plant.screen.access import Audit
from monitor.plant.status import refuse_doubled
from monitor.plant.tables import FIGURES, LIFE_FIGURES, arm, friction, last_value, transition
from monitor.publish.documents import Alert
from monitor.publish.timestamps import rfc3339
from monitor.views.history import mark_text
from monitor.views.web.page_content import EVENTS, MAX_REPLAYS, NEWEST_REPLAYS, SERIES, BusAccess, about_arm, columns, thinned

ROWS = 5000  # read at once
PAST_WINDOWS = 400  # newest replays that the page counts as one row
MOST_JOINTS = 8  # of an arm
UNWATCHED_S = 60.0  # without a look at an arm for so long, its live values are no longer received
TOLD = ("joint", "condition", "kind", "item", "hours", "why")  # keys of a command that its line in the audit repeats
ASSUMED_ROBOT = {"mounting": "ground", "payload_kg": 0.0, "tool": "?"}


Ways = Callable[[ArmName], Sequence[Link]]  # the routers that answer and behind which an arm is


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
        # a key of a query's answer or of a liveliness token is no document
        if not key.startswith(("alive/", "cmd/", "permit/", "event")) and _readable(key, payload):
            with self._lock:
                self._values[key] = payload

    def ask(self, key: str, about: Mapping[str, Any]) -> Mapping[str, Any]:
        """The arm's answer. Raises BadInput where it does not answer."""
        return command_arm(next(iter(self._ways(self._name)), None), self._name, key, about)


class ArmContent:
    """What the page of one arm shows: a `PageContent`."""

    report: Callable[[str], str] | None = None  # the report reads what only the arm's own store holds
    bus: BusAccess

    def __init__(self, name: ArmName, database: Database, ways: Ways, audit: Audit, language: str) -> None:
        """Raises KeyError where the plant knows no such arm, StoreError where the database does not answer."""
        self._name, self._database, self._audit = name, database, audit
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
        who, robot = str(document.get("by") or "this machine"), str(self._name)
        about = ", ".join(f"{key} {document[key]}" for key in TOLD if document.get(key) is not None)
        try:
            refuse_doubled(self._database, self._name.site, self._name.robot)
            answer = self.bus.ask(f"cmd/{command}", document)
        except BadInput as error:
            self._audit(who, command, robot, f"{about}: refused by the arm: {error}")
            raise
        self._audit(who, command, robot, about or "done")
        return answer

    def schedule(self) -> dict[str, Any]:
        """The next replay, the last windows as far as they are copied, and the last transitions of alerts, newest first."""
        at = self._row()
        monitor = self._last("monitor")
        due = monitor.get("next_replay_due")
        coming = [{"opens": due, "closes": due, "why": monitor.get("next_replay_why") or ""}] if due else []
        with self._database.read() as connection:
            newest = sa.select(transition).where(transition.c.arm == at.number, transition.c.history == at.history)
            rows = connection.execute(newest.order_by(transition.c.seq.desc()).limit(EVENTS)).all()
            of_first = (friction.c.arm == at.number, friction.c.history == at.history, friction.c.joint == 1)
            judged = sa.select(friction.c.replay, friction.c.recorded_at).where(*of_first)
            assessed = connection.execute(judged.order_by(friction.c.recorded_at.desc()).limit(PAST_WINDOWS)).all()
        windows = _windows([Assessed(*row) for row in assessed], _mapping(monitor, "last_replay"))
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
        said = self._last("monitor")
        store, process, bus = (_mapping(said, key) for key in ("store", "process", "bus"))
        return {
            "version": said.get("version") or "?",
            "now": said.get("said_at"),
            "up_s": said.get("uptime_s") or 0.0,
            "resident_mb": _scaled(process.get("resident_bytes"), 1e6),
            "disk_free_gb": _scaled(store.get("free_bytes"), 1e9),
            "disk_free_share": None,
            "history_mb": _scaled(store.get("history_bytes"), 1e6),
            "documents_dropped": bus.get("dropped", 0),
            "last_windows": {},
            "stops": [],
        }

    def _about(self) -> dict[str, Any]:
        info = self._last("info")
        robot = {**ASSUMED_ROBOT, **_mapping(info, "robot"), "site": self._name.site, "id": self._name.robot}
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
            encoded[f"joint/{row.joint}/friction"] = orjson.dumps(_friction(dict(row._mapping)))
        return {key: payload for key, payload in encoded.items() if _readable(key, payload)}

    def _last(self, key: str) -> dict[str, Any]:
        payload = self.bus.last_payloads().get(key)
        document = orjson.loads(payload) if payload else {}
        return document if isinstance(document, dict) else {}

    def _time(self, which: Callable[..., Any]) -> float | None:
        at = self._row()
        with self._database.read() as connection:
            wanted = sa.select(which(friction.c.recorded_at)).where(friction.c.arm == at.number, friction.c.history == at.history)
            found = connection.execute(wanted).scalar_one_or_none()
        return None if found is None else float(found)


def _readable(key: str, payload: bytes) -> bool:
    """Whether the page can say it: an arm of another make may say anything."""
    try:
        if key.startswith("alert/"):
            Alert.model_validate_json(payload)
        return isinstance(orjson.loads(payload), dict)
    except ValueError:
        return False


def _windows(assessed: Sequence[Assessed], last: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Windows as the page lists them: the newest one, where it ended otherwise, above the replays that were judged.

    assessed : newest first. last : of the arm's document `monitor`.
    """
    nothing: dict[str, Any] = {"kind": "scheduled", "tries": [], "borrowed": None}
    found: list[dict[str, Any]] = []
    if isinstance(last.get("window"), str) and last.get("state") not in (None, "assessed"):
        window = {"replay": last.get("replay"), "window": last["window"], "from": last["window"], "count": 1}
        found.append({**window, "state": str(last["state"]), "reason": last.get("reason"), **nothing})
    if assessed:
        newest, oldest = assessed[0], assessed[-1]
        window = {"replay": newest.replay, "window": rfc3339(newest.at_unix_s), "from": rfc3339(oldest.at_unix_s), "count": len(assessed)}
        found.append({**window, "state": "assessed", "reason": None, **nothing})
    return found


def _friction(row: Mapping[str, Any]) -> dict[str, Any]:
    """The document `friction` of a joint, from its copied row."""
    life = {name: row[name] for name in LIFE_FIGURES}
    life["trend_probability"] = life["trend_probability"] or 0.0
    verdict = "no_trend" if life["p50_days"] is None else "trend" if life["p50_days"] > 0.0 else "reached"
    return {"joint": row["joint"], **{name: row[name] for name in FIGURES}, "remaining_life": {**life, "verdict": verdict}}


def _mapping(document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = document.get(key)
    return value if isinstance(value, Mapping) else {}


def _scaled(value: Any, unit: float) -> float | None:
    return round(value / unit, 2) if isinstance(value, int | float) else None
