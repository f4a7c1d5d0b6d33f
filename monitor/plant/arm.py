"""An arm to the plant: as it was heard last, and how it is followed. No I/O, no clock.

Documents come from elsewhere: one that is none is left out whole, and of `health` it is said why.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel

from monitor.errors import BadInput
from monitor.plant.tables import FIGURES, LIFE_FIGURES
from monitor.publish.documents import Alert, Health, HistoryRow, Info, JointState, LastReplay, Monitor, mended_alerts, read, worded
from monitor.publish.session import ROOT
from monitor.publish.shown import Grade, Shown, arm_shown, joint_shown, waiting
from monitor.publish.timestamps import utc
from monitor.reason import Reason, Sentence

MOST_JOINTS = 8
MANUFACTURER = "Universal Robots"  # of every arm that a monitor can drive
CLOCK_S = 120.0  # two clocks that are kept differ by less, what a document takes on its way included
UNREADABLE = Sentence("health_unreadable", "its document health cannot be read: {why}")
DOUBLED = Sentence("doubled", "two monitors speak as this arm; give each a [robot] id of its own, or end one of them")()
SIGN_OF_LIFE_S = 180.0  # the plant stores what an arm says at least once a minute: without three of these nobody has listened
NEVER_HEARD = Sentence("never_heard", "nothing was heard of it yet")()
NOT_STORED = Sentence("nothing_stored", "nothing was stored of it since; does joint-monitor plant run?")()
UNKNOWN_SILENCE = Sentence("its_monitor_not_heard", "its monitor is not heard")()
Content = TypeVar("Content", bound=BaseModel)


class ArmName(NamedTuple):
    """Which arm."""

    site: str
    robot: str

    @property
    def prefix(self) -> str:
        """The key below which its keys lie."""
        return f"{ROOT}/{self.site}/{self.robot}"

    def __str__(self) -> str:
        return f"{self.site}/{self.robot}"


class Silence(NamedTuple):
    """That an arm's monitor is not heard."""

    since_unix_s: float | None  # None: it never was
    why: Reason


@dataclass(frozen=True, slots=True, kw_only=True)
class HeardJoint:
    """One joint. None: not known."""

    joint: int
    said: JointState | None
    friction: HistoryRow | None  # after the newest copied replay
    alerts: tuple[Alert, ...]  # active ones
    shown: Shown


@dataclass(frozen=True, slots=True, kw_only=True)
class HeardArm:
    """One arm. None: not known."""

    name: ArmName
    number: int = 0  # in the plant's database
    health: Health | None = None
    monitor: Monitor | None = None
    info: Info | None = None
    friction: Mapping[int, HistoryRow] = field(default_factory=dict)  # of each joint, after its newest replay
    heard_at_unix_s: Mapping[str, float] = field(default_factory=dict)  # when each document came
    silent_since_unix_s: float | None = None  # None: its monitor is heard, as far as the plant knows
    silent_why: Reason | None = None
    problem: Reason | None = None  # why its history cannot be copied; None: it can
    set_aside: Reason | None = None  # which rows of its history cannot be read; None: all can
    histories: int = 1  # and one more for each time that its history was restored or replaced
    same_history: tuple[str, ...] = ()  # other arms that have the very same one: it was renamed, or its disk was copied

    @property
    def alerts(self) -> tuple[Alert, ...]:
        """The active alerts."""
        return tuple(each for each in self.health.alerts if each.active) if self.health is not None else ()

    def alert(self, joint: int | None, condition: str) -> Alert | None:
        """The active alert of this joint (from 1; None: of the arm) and condition."""
        return next((each for each in self.alerts if (each.joint, each.condition) == (joint, condition)), None)

    @property
    def joints(self) -> tuple[HeardJoint, ...]:
        """Those that it has spoken of, or of which something is copied."""
        said = {each.joint: each for each in self.health.joints} if self.health is not None else {}
        return tuple(
            HeardJoint(
                joint=joint,
                said=said.get(joint),
                friction=self.friction.get(joint),
                alerts=tuple(each for each in self.alerts if each.joint == joint),
                shown=joint_shown(said.get(joint), self.silent.why if self.silent else None),
            )
            for joint in sorted({*said, *self.friction})
        )

    @property
    def model(self) -> str | None:
        """The arm's model."""
        model = self.info.robot.get("model") if self.info is not None else None
        return model if isinstance(model, str) else None

    @property
    def serial(self) -> str | None:
        """Its serial number."""
        return self.info.serial if self.info is not None else None

    @property
    def firmware(self) -> str | None:
        """Of its controller."""
        return self.info.firmware if self.info is not None else None

    @property
    def version(self) -> str | None:
        """Of its monitor."""
        return self.info.version if self.info is not None else None

    @property
    def stale(self) -> bool:
        """Whether nothing was learnt of it for too long, as it says."""
        return self.health is not None and self.health.stale

    @property
    def last_replay(self) -> LastReplay | None:
        """Its newest window, as its monitor says."""
        return None if self.monitor is None else self.monitor.last_replay

    @property
    def troubles(self) -> tuple[str, ...]:
        """Of its monitor, by name."""
        return tuple(each.name for each in self.monitor.troubles) if self.monitor is not None else ()

    @property
    def silent(self) -> Silence | None:
        """Since when and why its monitor is not heard, as the plant knows it."""
        return None if self.silent_since_unix_s is None else Silence(self.silent_since_unix_s, self.silent_why or UNKNOWN_SILENCE)

    def silence(self, now_unix_s: float) -> Silence | None:
        """The same for whoever does not know whether the plant runs: one that does not run hears nobody."""
        if self.silent is not None:
            return self.silent
        heard = max(self.heard_at_unix_s.values(), default=None)
        if heard is None:
            return Silence(None, NEVER_HEARD)
        return Silence(heard, NOT_STORED) if now_unix_s - heard > SIGN_OF_LIFE_S else None

    @property
    def shown(self) -> Shown:
        """The arm."""
        return arm_shown(self.health, self.silent.why if self.silent else None)

    @property
    def clock_ahead_s(self) -> float | None:
        """Of its monitor's clock before the plant's, when it was heard last; None where they agree, it is not known, or the word is old."""
        ahead = self.clock(0.0)
        return ahead if abs(ahead) > CLOCK_S and self.silent is None else None

    def clock(self, now_unix_s: float) -> float:
        """The time that the arm's own clock shows, as far as it is known: times that the arm has set are compared with this one."""
        heard = self.heard_at_unix_s.get("monitor")
        return now_unix_s if self.monitor is None or heard is None else now_unix_s + self.monitor.said_at.timestamp() - heard

    def waiting(self, now_unix_s: float) -> list[Alert]:
        """The active alerts that wait for a person: neither acknowledged nor shelved, by the arm's own clock."""
        return waiting(self.alerts, self.clock(now_unix_s))

    @property
    def grade(self) -> Grade:
        """How much it needs somebody: the worst that holds."""
        grade = self.shown.grade
        doubtful = self.problem is not None or bool(self.troubles) or self.clock_ahead_s is not None
        return Grade.DOUBTFUL if doubtful and grade is Grade.WELL else grade


def worst_first(arms: Sequence[HeardArm], now_unix_s: float) -> list[HeardArm]:
    """By grade, then by state, then the one with more alerts that wait for a person, then by name."""

    def rank(arm: HeardArm) -> tuple[int, int, int, ArmName]:
        return arm.grade.order, arm.shown.order, -len(arm.waiting(now_unix_s)), arm.name

    return sorted(arms, key=rank)


# --- from the rows of the plant's database


def documents_of(said: Mapping[str, Any], at_unix_s: float) -> dict[str, Any]:
    """The documents of an arm by key, as the fields of a HeardArm."""
    health = readable_health(said["health"], at_unix_s) if "health" in said else None
    return {"health": health, "monitor": _readable(Monitor, said.get("monitor")), "info": _readable(Info, said.get("info"))}


def readable_health(document: Any, at_unix_s: float) -> Health:
    """A health, without the joints and alerts that are none.

    One that says why in the place of a document that is none: what the arm said before would be shown as if it still held.
    """
    try:
        return read(Health, document)
    except BadInput:
        said = document if isinstance(document, dict) else {}
    kept: dict[str, Sequence[BaseModel]] = {"joints": _those(JointState, said["joints"])} if "joints" in said else {}
    kept |= {"alerts": mended_alerts(said["alerts"])} if "alerts" in said else {}
    try:
        return read(Health, {**said, **kept})
    except BadInput as error:
        return unreadable_health(UNREADABLE(why=str(error)), at_unix_s)


def _those(model: type[BaseModel], listed: Any) -> list[BaseModel]:
    return [found for each in listed if (found := _readable(model, each)) is not None] if isinstance(listed, list) else []


def unreadable_health(why: Reason, at_unix_s: float) -> Health:
    """One that knows nothing but why."""
    return Health(state=None, joints=[], alerts=[], next_replay_due=None, said_at=utc(at_unix_s), **worded(why=why))


def _readable(model: type[Content], document: Any) -> Content | None:
    try:
        return None if document is None else read(model, document)
    except BadInput:
        return None


def copied_friction(row: Any) -> HistoryRow | None:
    """The document of a joint after a replay, from its row; what lies between the columns is judged from them. None where it is none."""
    life = {name: getattr(row, name) for name in LIFE_FIGURES}
    verdict = "no_trend" if life["p50_days"] is None else "trend" if life["p50_days"] > 0.0 else "reached"
    remaining = {**life, "trend_probability": life["trend_probability"] or 0.0, "verdict": verdict}
    figures = {name: getattr(row, name) for name in FIGURES}
    known = {"joint": row.joint, "replay": row.replay, "recorded_at": utc(row.recorded_at), "remaining_life": remaining}
    return _readable(HistoryRow, {**figures, **known})


# --- An arm that is followed: by which ways it is seen, when it was heard, how far it is copied. Times are those of a monotonic clock

SETTLED_S = 2.0  # after this a token that is gone is gone because its monitor is, not because the way to it is just being lost
AGAIN_S, SELDOM_S = 30.0, 900.0  # until an arm that could not be copied is asked again, at first and at last
MOST_SPEAKERS = 20  # monitors of one arm that are remembered
TWICE_S = 120.0  # within which the monitor before the present one speaks again, where there are two; a restart never does
SAVE_MONITOR_S = 60.0  # the document `monitor` comes every ten seconds and changes little: so often it is stored
NO_WAY = Sentence("no_way", "no way to it: {ways} does not answer")
GONE = Sentence("monitor_gone", "its monitor is gone")()
NOT_SEEN = Sentence("monitor_not_seen", "not seen since the plant was started")()
SAYS_NOTHING = Sentence("monitor_hangs", "its monitor is there, and has said nothing for more than {silent_s:.0f} s")


@dataclass(slots=True)
class Arm:
    """One arm."""

    since: float  # when the plant began to expect it
    number: int | None = None  # in the database; None: not entered yet
    ways: set[str] = field(default_factory=set)  # endpoints behind which its token is
    last_ways: set[str] = field(default_factory=set)  # behind which it was last
    gone: float = 0.0  # since when it is behind none
    heard: float | None = None
    sick: bool = False  # as it said last
    history_id: str | None = None  # as copied
    event: int = -1  # how far each log is copied; -1: not known
    change: int = -1
    problem: Reason | None = None
    failures: int = 0  # in a row
    due_again: float = 0.0  # after a failure: when the next attempt is
    silent: Reason | None = None  # why, as the database has it
    monitor_saved: float = -SAVE_MONITOR_S
    troubles: tuple[str, ...] = ()
    _speaker: tuple[object, object] | None = None  # which monitor said `monitor` last: its start, its history
    _before: dict[tuple[object, object], float] = field(default_factory=dict)  # monitors before it: when each was heard last
    _doubled_at: float | None = None  # when one of those before was heard again

    def silence(self, now: float, silent_s: float, lost_ways: Iterable[str]) -> Reason | None:
        """Why nobody hears this arm's monitor; None where it is heard."""
        ways = self.ways or self.last_ways
        lost = sorted(ways & set(lost_ways))
        if ways and lost == sorted(ways):
            return NO_WAY(ways=lost)
        if not self.ways:
            if now - self.gone < SETTLED_S or (self.heard is None and now - self.since < silent_s):
                return self.silent  # it may still come: the plant has just started, or the token is lost before its router is
            return GONE if self.heard is not None else NOT_SEEN
        if now - (self.since if self.heard is None else self.heard) > silent_s:
            return SAYS_NOTHING(silent_s=silent_s)
        return None

    def copied(self, problem: Reason | None, now: float) -> None:
        """Note how an attempt to copy its history ended: after failures the next ones come more and more seldom."""
        self.failures = 0 if problem is None else self.failures + 1
        self.due_again = now + min(AGAIN_S * 2.0 ** (self.failures - 1), SELDOM_S)

    def behind(self, monitor: Monitor) -> bool:
        """Whether its document `monitor` shows that its history goes further than it is copied."""
        store = monitor.store
        if store.last_event is None or store.last_change is None:
            return False  # it does not say it
        return (store.last_event, store.last_change, store.history_id) != (self.event, self.change, self.history_id)

    def hear_monitor(self, monitor: Monitor, now: float) -> None:
        """Note which monitor speaks: two of one name take turns, and a monitor that was started anew never speaks as the old one again."""
        speaker = (monitor.started_at, monitor.store.history_id)
        if speaker == self._speaker:
            return
        self._before = {each: at for each, at in self._before.items() if now - at < TWICE_S}
        if speaker in self._before:
            self._doubled_at = now
        if self._speaker is not None and len(self._before) < MOST_SPEAKERS:
            self._before[self._speaker] = now
        self._speaker = speaker

    def doubled(self, now: float) -> bool:
        """Whether two monitors speak as this arm."""
        return self._doubled_at is not None and now - self._doubled_at < TWICE_S

    def worth_saving(self, document: BaseModel, now: float) -> bool:
        """Whether a document must be stored now; the next one of its key comes soon where it need not."""
        if not isinstance(document, Monitor):
            return True
        troubles = tuple(each.name for each in document.troubles)
        if troubles == self.troubles and now - self.monitor_saved < SAVE_MONITOR_S:
            return False
        self.troubles, self.monitor_saved = troubles, now
        return True
