"""Metrics for Prometheus: the bus's last values as numbers, collected when somebody scrapes.

Nothing is stored: a scrape reports what the bus would answer at that moment.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import TypeVar

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from monitor.errors import cannot_listen
from monitor.judge.alerts.health import STATES
from monitor.judge.inspection import MUST_BE_MADE
from monitor.publish.documents import Alert, Document, Friction, FromProduction, Health, Info, Inspection, Monitor
from monitor.publish.session import MetricsSettings

log = logging.getLogger(__name__)

HOUR_S = 3600.0

_FRICTION = (
    ("coulomb_nm", "joint_monitor_coulomb_friction_newton_metres", "Coulomb friction of the last replay"),
    ("coulomb_std_nm", "joint_monitor_coulomb_friction_std_newton_metres", "its standard deviation"),
    ("viscous_nm_s_per_rad", "joint_monitor_viscous_friction_newton_metre_seconds_per_radian", "Viscous friction of the last replay"),
    ("viscous_std_nm_s_per_rad", "joint_monitor_viscous_friction_std_newton_metre_seconds_per_radian", "its standard deviation"),
    ("temperature_c", "joint_monitor_joint_temperature_celsius", "Joint temperature during the last replay"),
    ("reference_torque_nm", "joint_monitor_reference_friction_newton_metres", "Friction at the reference speed and temperature"),
    ("wear", "joint_monitor_wear_ratio", "Rise of friction since the beginning, temperature taken out"),
    ("wear_std", "joint_monitor_wear_std_ratio", "its standard deviation"),
    ("wear_rate_per_day", "joint_monitor_wear_rate_per_day_ratio", "Present pace of wear"),
)


_MONITOR: tuple[tuple[str, str, Callable[[Monitor], float | None]], ...] = (
    ("joint_monitor_arm_heard", "1 while the arm can be heard", lambda of: of.arm.heard),
    ("joint_monitor_replay_lag_seconds", "Of the last scheduled replay, from the opening of its window", lambda of: of.lag_s),
    ("joint_monitor_disk_free_bytes", "Where the history lives", lambda of: of.store.free_bytes),
    ("joint_monitor_history_bytes", "Size of the history, without recordings", lambda of: of.store.history_bytes),
    (
        "joint_monitor_archive_waiting",
        "Recordings that the archive does not have yet",
        lambda of: None if of.store.archive is None else of.store.archive.waiting,
    ),
    ("joint_monitor_last_backup_timestamp_seconds", "When the newest backup was made", lambda of: _time(of.store.last_backup_at)),
    (
        "joint_monitor_last_replay_timestamp_seconds",
        "When the last window's replay ended",
        lambda of: None if of.last_replay is None else _time(of.last_replay.ended_at),
    ),
    (
        "joint_monitor_due_since_timestamp_seconds",
        "Since when a replay waits for the program's node",
        lambda of: None if of.due is None else _time(of.due.since),
    ),
    (
        "joint_monitor_borrowed_seconds",
        "How long the program waited for the last replay",
        lambda of: None if of.last_replay is None or of.last_replay.borrowed is None else of.last_replay.borrowed.waited_s,
    ),
    ("joint_monitor_resident_bytes", "Memory of the daemon", lambda of: of.process.resident_bytes),
    ("joint_monitor_documents_waiting", "To be sent on the bus", lambda of: of.bus.to_send),
    ("joint_monitor_queries_waiting", "To be answered on the bus", lambda of: of.bus.to_answer),
    ("joint_monitor_documents_dropped", "On the bus since the start", lambda of: of.bus.dropped),
)


class Families(Collector):
    """Collects metric families when somebody scrapes."""

    def __init__(self, collected: Callable[[], Iterable[Metric]]) -> None:
        self._collected = collected

    def collect(self) -> Iterable[Metric]:
        """For prometheus_client."""
        return self._collected()


class MetricsServer:
    """A small HTTP server in a thread of its own. A context manager."""

    def __init__(self, settings: MetricsSettings, collected: Callable[[], Iterable[Metric]]) -> None:
        """Serve what `collected` returns, e.g. the `families` of the bus's last values. Raises as `cannot_listen`."""
        registry = CollectorRegistry()
        registry.register(Families(collected))
        host, port = settings.address()
        try:
            self._server, self._thread = start_http_server(port, addr=host, registry=registry)
        except OSError as error:
            raise cannot_listen(f"metrics: {settings.listen}", error.errno, str(error.strerror)) from None
        log.info("metrics on http://%s/metrics", settings.listen)

    def __enter__(self) -> "MetricsServer":
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=5.0)


Family = Callable[..., GaugeMetricFamily]  # of a name, a text and labels beside site and robot
Last = TypeVar("Last", bound=Document)


def families(last: Mapping[str, Document]) -> Iterator[Metric]:
    """Documents by key (`health`, `joint/3/friction`, …, as published) → metric families with labels site, robot, joint."""
    info = _one(last, Info)
    robot = {} if info is None else info.robot
    who = [str(robot.get("site", "")), str(robot.get("id", ""))]

    def family(name: str, text: str, *labels: str) -> GaugeMetricFamily:
        return GaugeMetricFamily(name, text, labels=["site", "robot", *labels])

    version = family("joint_monitor_info", "The monitor of this robot", "model", "version")
    version.add_metric([*who, str(robot.get("model", "")), "" if info is None else info.version], 1.0)
    yield version
    yield from _health(_one(last, Health), who, family)
    yield from _alerts(_all(last, Alert), who, family)
    yield from _friction(_all(last, Friction), who, family)
    yield from _monitor(_one(last, Monitor), who, family)
    if (found := _one(last, FromProduction)) is not None:
        yield from _from_production(found, who, family)
    if (duties := _one(last, Inspection)) is not None:
        yield from _inspection(duties, who, family)


def _all(last: Mapping[str, Document], model: type[Last]) -> list[Last]:
    return [document for document in last.values() if type(document) is model]


def _one(last: Mapping[str, Document], model: type[Last]) -> Last | None:
    return next(iter(_all(last, model)), None)


def _monitor(monitor: Monitor | None, who: list[str], family: Family) -> Iterator[Metric]:
    """The condition of the monitor itself; nothing before its first document."""
    for name, text, figure in _MONITOR:
        gauge = family(name, text)
        value = None if monitor is None else figure(monitor)
        if value is not None:
            gauge.add_metric(who, float(value))
        yield gauge
    troubles = family("joint_monitor_trouble", "1 while something is wrong with the monitor itself", "name")
    for each in () if monitor is None else monitor.troubles:
        troubles.add_metric([*who, each.name], 1.0)
    yield troubles
    ended = family("joint_monitor_last_replay", "1 for how the last window ended", "state")
    if monitor is not None and monitor.last_replay is not None:
        ended.add_metric([*who, monitor.last_replay.state], 1.0)
    yield ended


def _from_production(found: FromProduction, who: list[str], family: Family) -> Iterator[Metric]:
    """What came from ordinary work, where it is judged."""
    share = family("joint_monitor_production_share", "Information that ordinary work holds of this joint, beside what is needed", "joint")
    learnt = family("joint_monitor_observations", "Of this joint that were learnt from, by their source", "joint", "source")
    for each in found.joints:
        joint = [*who, str(each.joint)]
        if each.share is not None:
            share.add_metric(joint, each.share)
        learnt.add_metric([*joint, "replay"], float(each.learnt_from_replays))
        learnt.add_metric([*joint, "production"], float(each.learnt_from_production))
    needed = family("joint_monitor_replay_needed_timestamp_seconds", "From when the next replay is needed; 0: now")
    needed.add_metric(who, _time(found.next_replay.needed_from) or 0.0)
    yield from (share, learnt, needed)


def _time(at: datetime | None) -> float | None:
    return None if at is None else at.timestamp()


def _health(health: Health | None, who: list[str], family: Family) -> Iterator[Metric]:
    joints = [] if health is None else health.joints
    state = family("joint_monitor_health_state", "1 for the NE 107 state that joint or arm is in", "joint", "state")
    for joint, is_in in [("arm", health and health.state), *((str(each.joint), each.state) for each in joints)]:
        for name in STATES:
            state.add_metric([*who, joint, name], float(name == is_in))
    yield state
    stale = family("joint_monitor_stale", "1 while nothing was learnt of joint or arm for too long: its state is of then", "joint")
    if health is not None and health.state is not None:
        stale.add_metric([*who, "arm"], float(health.stale))
    for each in joints:
        stale.add_metric([*who, str(each.joint)], float(each.stale))
    yield stale
    learnt = family("joint_monitor_learnt_timestamp_seconds", "When a replay last taught something of this joint", "joint")
    for each in joints:
        if each.learnt_at is not None:
            learnt.add_metric([*who, str(each.joint)], each.learnt_at.timestamp())
    yield learnt
    due = family("joint_monitor_next_replay_due_timestamp_seconds", "When the schedule will replay next")
    if health is not None and health.next_replay_due is not None:
        due.add_metric(who, health.next_replay_due.timestamp())
    yield due
    published = family("joint_monitor_said_timestamp_seconds", "When the monitor last said how the arm is")
    if health is not None:
        published.add_metric(who, health.said_at.timestamp())
    yield published


def _alerts(alerts: Sequence[Alert], who: list[str], family: Family) -> Iterator[Metric]:
    active = family("joint_monitor_alert_active", "1 while an alert is active", "joint", "condition", "tier")
    acknowledged = family("joint_monitor_alert_acknowledged", "1 once an active alert has been acknowledged", "joint", "condition")
    change = family("joint_monitor_alert_change_ratio", "Change of friction that an active alert tells", "joint", "condition")
    for alert in alerts:
        place = [*who, "arm" if alert.joint is None else str(alert.joint), alert.condition]
        active.add_metric([*place, alert.tier], float(alert.active))
        if alert.active:
            acknowledged.add_metric(place, float(alert.acknowledged_at is not None))
            change.add_metric(place, alert.change)
    yield from (active, acknowledged, change)


def _friction(rows: Sequence[Friction], who: list[str], family: Family) -> Iterator[Metric]:
    for key, name, text in _FRICTION:
        gauge = family(name, text, "joint")
        for row in rows:
            if (value := getattr(row, key)) is not None:
                gauge.add_metric([*who, str(row.joint)], float(value))
        yield gauge
    life = family("joint_monitor_remaining_life_days", "Days until friction reaches its limit, by quantile", "joint", "quantile")
    for row in rows:
        for quantile in ("p10", "p50", "p90"):
            if (days := getattr(row.remaining_life, f"{quantile}_days")) is not None:
                life.add_metric([*who, str(row.joint), f"0.{quantile[1:]}"], float(days))
    yield life


def _inspection(found: Inspection, who: Sequence[str], family: Family) -> Iterator[Metric]:
    """Seconds and counts only grow, unless a person declares other `hours_before`."""
    for name, text, hours in (
        ("joint_monitor_heard_seconds", "For how long the arm was heard", found.heard_h),
        ("joint_monitor_operating_seconds", "For how long the arm was on, with what was declared of the time before", found.operating_h),
        ("joint_monitor_moving_seconds", "For how long the arm moved, as far as it was heard", found.moving_h),
    ):
        counter = CounterMetricFamily(name, text, labels=["site", "robot"])
        counter.add_metric(who, HOUR_S * hours)
        yield counter
    stops = CounterMetricFamily("joint_monitor_safety_stops", "Stops that the arm's safety system made by itself", labels=["site", "robot"])
    stops.add_metric(who, float(found.stops))
    yield stops
    of_joint = family("joint_monitor_safety_stops_kept", "Of the stops that are kept, by the joint that the controller named", "joint")
    for each in found.stops_by_joint:
        of_joint.add_metric([*who, str(each.joint)], float(each.stops))
    yield of_joint
    due = family("joint_monitor_inspection_due_timestamp_seconds", "When a check is due", "item")
    state = family("joint_monitor_inspection_due", "1 where a check is due, or nobody has recorded it", "item")
    for item in found.items:
        if item.due is not None:
            due.add_metric([*who, item.name], item.due.timestamp())
        state.add_metric([*who, item.name], float(item.state in MUST_BE_MADE))
    yield from (due, state)
