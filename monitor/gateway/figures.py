"""What is told of an arm in other languages: figures out of its last documents, each with the time that it is of. No I/O, no clock.

The documents came from elsewhere, so each of them may lack anything, or hold what it should not: that is unknown, and never invented.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from monitor.gateway.values import ArmState, time_said
from monitor.judge.alerts.health import STATES

MOST_JOINTS = 8
MANUFACTURER = "Universal Robots"  # of every arm that a monitor can drive
SIGN_OF_LIFE_S = 180.0  # the plant stores what an arm says at least once a minute: without three of these nobody has listened
YEAR_3000_UNIX_S = 32_503_680_000.0
LARGEST = 1e12  # a figure beyond is nobody's
LONGEST_TEXT = 2000  # letters
ALERT_TEXTS = (
    *("condition", "tier", "severity", "text", "action", "raised_at"),
    *("acknowledged_at", "acknowledged_by", "shelved_until"),
)
Alert = Mapping[str, Any]  # joint (None: of the arm) and ALERT_TEXTS


@dataclass(frozen=True, slots=True, kw_only=True)
class JointFigures:
    """One joint. None: not known."""

    joint: int
    state: str | None = None  # NE 107
    why: str | None = None
    since_unix_s: float | None = None
    learnt_unix_s: float | None = None  # of the last replay that taught something of it
    stale: bool = False  # nothing was learnt for a long time: the figures are of then
    measured_unix_s: float | None = None  # of the replay that the figures below are of
    wear: float | None = None  # fraction of friction torque since the beginning
    wear_std: float | None = None
    wear_rate_per_day: float | None = None
    temperature_c: float | None = None  # during that replay
    friction_nm: float | None = None  # at the reference speed and temperature
    trend_probability: float | None = None
    life_days: tuple[float | None, float | None, float | None] = (
        None,
        None,
        None,
    )  # P10, P50, P90; None: no trend, or not within foresight
    alerts: tuple[Alert, ...] = ()  # active ones

    @property
    def judged(self) -> bool:
        """Whether a replay has been judged."""
        return self.measured_unix_s is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmFigures:
    """One arm. None: not known."""

    site: str
    robot: str
    model: str | None = None
    serial: str | None = None
    firmware: str | None = None
    version: str | None = None  # of its monitor
    state: str | None = None
    why: str | None = None
    since_unix_s: float | None = None
    said_unix_s: float | None = None  # when its monitor said this
    stale: bool = False
    heard_unix_s: float | None = None  # when the plant last stored what it said
    silent_since_unix_s: float | None = None  # None: its monitor is heard, as far as the plant knows
    silent_why: str | None = None
    last_replay_unix_s: float | None = None
    next_replay_unix_s: float | None = None
    troubles: tuple[str, ...] = ()  # of its monitor
    joints: tuple[JointFigures, ...] = ()
    alerts: tuple[Alert, ...] = ()  # active ones, of joints and of the arm

    @property
    def name(self) -> str:
        """As the plant names it."""
        return f"{self.site}/{self.robot}"

    def silence(self, now_unix_s: float) -> tuple[float | None, str] | None:
        """Since when and why its monitor is not heard; None where it is. A plant that does not run hears nobody."""
        if self.silent_since_unix_s is not None:
            return self.silent_since_unix_s, self.silent_why or "its monitor is not heard"
        if self.heard_unix_s is None:
            return None, "nothing was heard of it yet"
        if now_unix_s - self.heard_unix_s > SIGN_OF_LIFE_S:
            return self.heard_unix_s, "nothing was stored of it since; does joint-monitor plant run?"
        return None


def unacknowledged(alerts: Iterable[Alert]) -> list[Alert]:
    """Those that wait for a person."""
    return [each for each in alerts if not each.get("acknowledged_at")]


def figures(arm: ArmState) -> ArmFigures:
    """The figures of an arm as it was heard last."""
    health, monitor, info = _table(arm.health), _table(arm.monitor), _table(arm.info)
    alerts = tuple(_alert(each) for each in _tables(health.get("alerts")) if each.get("active") is True and _text(each.get("condition")))
    said = {number: each for each in _tables(health.get("joints")) if (number := _joint(each.get("joint"))) is not None}
    numbers = sorted({*said, *(number for number in arm.joints if _joint(number))})
    return ArmFigures(
        site=arm.name.site,
        robot=arm.name.robot,
        model=_text(arm.model),
        serial=_text(info.get("serial")),
        firmware=_text(info.get("firmware")),
        version=_text(info.get("version")),
        state=_state(health.get("state")),
        why=_text(health.get("why")),
        since_unix_s=_time(health.get("since")),
        said_unix_s=_time(health.get("said_at")),
        stale=health.get("stale") is True,
        heard_unix_s=max(arm.heard_at_unix_s.values(), default=None),
        silent_since_unix_s=arm.silent_since_unix_s,
        silent_why=arm.silent_why,
        last_replay_unix_s=_time(_table(monitor.get("last_replay")).get("ended_at")),
        next_replay_unix_s=_time(health.get("next_replay_due")),
        troubles=tuple(name for each in _tables(monitor.get("troubles")) if (name := _text(each.get("name")))),
        joints=tuple(_joint_figures(number, said.get(number, {}), _table(arm.joints.get(number)), alerts) for number in numbers),
        alerts=alerts,
    )


def _joint_figures(joint: int, said: Mapping[str, Any], row: Mapping[str, Any], alerts: Iterable[Alert]) -> JointFigures:
    life = _table(row.get("remaining_life")) or row  # nested on the bus, in columns of their own in the plant's database
    p10, p50, p90 = (_number(life.get(f"{quantile}_days")) for quantile in ("p10", "p50", "p90"))
    return JointFigures(
        joint=joint,
        state=_state(said.get("state")),
        why=_text(said.get("why")),
        since_unix_s=_time(said.get("since")),
        learnt_unix_s=_time(said.get("learnt_at")),
        stale=said.get("stale") is True,
        measured_unix_s=_time(row.get("recorded_at")),
        wear=_number(row.get("wear")),
        wear_std=_number(row.get("wear_std")),
        wear_rate_per_day=_number(row.get("wear_rate_per_day")),
        temperature_c=_number(row.get("temperature_c")),
        friction_nm=_number(row.get("reference_torque_nm")),
        trend_probability=_number(life.get("trend_probability")),
        life_days=(p10, p50, p90),
        alerts=tuple(each for each in alerts if each.get("joint") == joint),
    )


def _alert(said: Mapping[str, Any]) -> Alert:
    return {"joint": _joint(said.get("joint")), **{key: _text(said.get(key)) for key in ALERT_TEXTS}}


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _tables(value: Any) -> list[Mapping[str, Any]]:
    return [each for each in value if isinstance(each, Mapping)] if isinstance(value, list | tuple) else []


def _joint(value: Any) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_JOINTS else None


def _text(value: Any) -> str | None:
    return value[:LONGEST_TEXT].encode("utf-8", "replace").decode() if isinstance(value, str) and value.strip() else None


def _state(value: Any) -> str | None:
    return value if isinstance(value, str) and value in STATES else None


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST else None  # NaN is not


def _time(value: Any) -> float | None:
    number = _number(time_said(value) if isinstance(value, str) else value)
    return number if number is not None and 0.0 <= number < YEAR_3000_UNIX_S else None
