"""Metrics for Prometheus: the bus's last values as numbers, collected when somebody scrapes.

Nothing is stored: a scrape reports what the bus would answer at that moment.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from monitor.errors import BusError
from monitor.judge.alerts.health import STATES
from monitor.judge.inspection import MUST_BE_MADE
from monitor.publish.session import MetricsSettings
from monitor.publish.timestamps import unix_s

log = logging.getLogger(__name__)

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
        """Serve what `collected` returns, e.g. the `families` of the bus's last values. Raises BusError where the port is taken."""
        registry = CollectorRegistry()
        registry.register(Families(collected))
        host, port = settings.address()
        try:
            self._server, self._thread = start_http_server(port, addr=host, registry=registry)
        except OSError as error:
            raise BusError(f"metrics: cannot listen on {settings.listen}: {error.strerror}") from None
        log.info("metrics on http://%s/metrics", settings.listen)

    def __enter__(self) -> "MetricsServer":
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=5.0)


def families(last: Mapping[str, Any]) -> Iterator[Metric]:
    """Documents by key (`health`, `joint/3/friction`, …, as published) → metric families with labels site, robot, joint."""
    info = last.get("info", {}).get("robot", {})
    who = [str(info.get("site", "")), str(info.get("id", ""))]

    def family(name: str, text: str, *labels: str) -> GaugeMetricFamily:
        return GaugeMetricFamily(name, text, labels=["site", "robot", *labels])

    version = family("joint_monitor_info", "The monitor of this robot", "model", "version")
    version.add_metric([*who, str(info.get("model", "")), str(last.get("info", {}).get("version", ""))], 1.0)
    yield version
    yield from _health(last.get("health", {}), who, family)
    yield from _alerts({key: document for key, document in last.items() if key.startswith("alert/")}, who, family)
    yield from _friction({key: document for key, document in last.items() if key.endswith("/friction")}, who, family)
    yield from _monitor(last.get("monitor", {}), who, family)
    if "from_production" in last:
        yield from _from_production(last["from_production"], who, family)
    if "inspection" in last:
        yield from inspection_families(last["inspection"], who)


def _monitor(monitor: Mapping[str, Any], who: list[str], family: Callable[..., GaugeMetricFamily]) -> Iterator[Metric]:
    """The condition of the monitor itself; nothing before its first document."""
    store, process, bus = monitor.get("store", {}), monitor.get("process", {}), monitor.get("bus", {})
    last = monitor.get("last_replay") or {}
    due, borrowed = monitor.get("due") or {}, last.get("borrowed") or {}
    figures = (
        ("joint_monitor_arm_heard", "1 while the arm can be heard", monitor.get("arm", {}).get("heard")),
        ("joint_monitor_replay_lag_seconds", "Of the last scheduled replay, from the opening of its window", monitor.get("lag_s")),
        ("joint_monitor_disk_free_bytes", "Where the history lives", store.get("free_bytes")),
        ("joint_monitor_history_bytes", "Size of the history, without recordings", store.get("history_bytes")),
        ("joint_monitor_archive_waiting", "Recordings that the archive does not have yet", store.get("archive", {}).get("waiting")),
        ("joint_monitor_last_backup_timestamp_seconds", "When the newest backup was made", _time(store.get("last_backup_at"))),
        ("joint_monitor_last_replay_timestamp_seconds", "When the last window's replay ended", _time(last.get("ended_at"))),
        ("joint_monitor_due_since_timestamp_seconds", "Since when a replay waits for the program's node", _time(due.get("since"))),
        (
            "joint_monitor_borrowed_seconds",
            "How long the program waited for the last replay",
            borrowed.get("waited_s"),
        ),
        ("joint_monitor_resident_bytes", "Memory of the daemon", process.get("resident_bytes")),
        ("joint_monitor_documents_waiting", "To be sent on the bus", bus.get("to_send")),
        ("joint_monitor_queries_waiting", "To be answered on the bus", bus.get("to_answer")),
        ("joint_monitor_documents_dropped", "On the bus since the start", bus.get("dropped")),
    )
    for name, text, value in figures:
        gauge = family(name, text)
        if value is not None:
            gauge.add_metric(who, float(value))
        yield gauge
    problems = family("joint_monitor_trouble", "1 while something is wrong with the monitor itself", "name")
    for each in monitor.get("troubles", []):
        problems.add_metric([*who, each["name"]], 1.0)
    yield problems
    ended = family("joint_monitor_last_replay", "1 for how the last window ended", "state")
    if last:
        ended.add_metric([*who, last["state"]], 1.0)
    yield ended


def _from_production(found: Mapping[str, Any], who: list[str], family: Callable[..., GaugeMetricFamily]) -> Iterator[Metric]:
    """What came from ordinary work, where it is judged."""
    share = family("joint_monitor_production_share", "Information that ordinary work holds of this joint, beside what is needed", "joint")
    learnt = family("joint_monitor_observations", "Of this joint that were learnt from, by their source", "joint", "source")
    for each in found["joints"]:
        joint = [*who, str(each["joint"])]
        if each["share"] is not None:
            share.add_metric(joint, float(each["share"]))
        for source, key in (("replay", "learnt_from_replays"), ("production", "learnt_from_production")):
            learnt.add_metric([*joint, source], float(each[key]))
    needed = family("joint_monitor_replay_needed_timestamp_seconds", "From when the next replay is needed; 0: now")
    needed.add_metric(who, _time(found["next_replay"]["needed_from"]) or 0.0)
    yield from (share, learnt, needed)


def _time(text: str | None) -> float | None:
    return None if text is None else unix_s(text)


def _health(health: Mapping[str, Any], who: list[str], family: Callable[..., GaugeMetricFamily]) -> Iterator[Metric]:
    state = family("joint_monitor_health_state", "1 for the NE 107 state that joint or arm is in", "joint", "state")
    rows = [("arm", health.get("state"))] + [(str(joint["joint"]), joint["state"]) for joint in health.get("joints", [])]
    for joint, is_in in rows:
        for name in STATES:
            state.add_metric([*who, joint, name], float(name == is_in))
    yield state
    stale = family("joint_monitor_stale", "1 while nothing was learnt of joint or arm for too long: its state is of then", "joint")
    for joint, old in [("arm", health.get("stale"))] + [(str(each["joint"]), each.get("stale")) for each in health.get("joints", [])]:
        if old is not None:
            stale.add_metric([*who, joint], float(old))
    yield stale
    learnt = family("joint_monitor_learnt_timestamp_seconds", "When a replay last taught something of this joint", "joint")
    for each in health.get("joints", []):
        if each.get("learnt_at"):
            learnt.add_metric([*who, str(each["joint"])], unix_s(each["learnt_at"]))
    yield learnt
    due = family("joint_monitor_next_replay_due_timestamp_seconds", "When the schedule will replay next")
    if health.get("next_replay_due"):
        due.add_metric(who, unix_s(health["next_replay_due"]))
    yield due
    published = family("joint_monitor_said_timestamp_seconds", "When the monitor last said how the arm is")
    if health.get("said_at"):
        published.add_metric(who, unix_s(health["said_at"]))
    yield published


def _alerts(alerts: Mapping[str, Mapping[str, Any]], who: list[str], family: Callable[..., GaugeMetricFamily]) -> Iterator[Metric]:
    active = family("joint_monitor_alert_active", "1 while an alert is active", "joint", "condition", "tier")
    acknowledged = family("joint_monitor_alert_acknowledged", "1 once an active alert has been acknowledged", "joint", "condition")
    change = family("joint_monitor_alert_change_ratio", "Change of friction that an active alert tells", "joint", "condition")
    for alert in alerts.values():
        place = [*who, "arm" if alert["joint"] is None else str(alert["joint"]), alert["condition"]]
        active.add_metric([*place, alert["tier"]], float(alert["active"]))
        if alert["active"]:
            acknowledged.add_metric(place, float(alert["acknowledged_at"] is not None))
            change.add_metric(place, alert["change"])
    yield from (active, acknowledged, change)


def _friction(rows: Mapping[str, Mapping[str, Any]], who: list[str], family: Callable[..., GaugeMetricFamily]) -> Iterator[Metric]:
    for key, name, text in _FRICTION:
        gauge = family(name, text, "joint")
        for row in rows.values():
            if row.get(key) is not None:
                gauge.add_metric([*who, str(row["joint"])], float(row[key]))
        yield gauge
    life = family("joint_monitor_remaining_life_days", "Days until friction reaches its limit, by quantile", "joint", "quantile")
    for row in rows.values():
        for quantile in ("p10", "p50", "p90"):
            days = row["remaining_life"].get(f"{quantile}_days")
            if days is not None:
                life.add_metric([*who, str(row["joint"]), f"0.{quantile[1:]}"], float(days))
    yield life


# --- inspection duties -----------------------------------------------------------------------------

HOUR_S = 3600.0


def inspection_families(found: Mapping[str, Any], who: Sequence[str]) -> Iterator[Metric]:
    """Families with the labels site and robot (`who`). Seconds and counts only grow, unless a person declares other `hours_before`."""
    names = ["site", "robot"]
    for name, text, key in (
        ("joint_monitor_heard_seconds", "For how long the arm was heard", "heard_h"),
        ("joint_monitor_operating_seconds", "For how long the arm was on, with what was declared of the time before", "operating_h"),
        ("joint_monitor_moving_seconds", "For how long the arm moved, as far as it was heard", "moving_h"),
    ):
        counter = CounterMetricFamily(name, text, labels=names)
        counter.add_metric(who, HOUR_S * float(found[key]))
        yield counter
    stops = CounterMetricFamily("joint_monitor_safety_stops", "Stops that the arm's safety system made by itself", labels=names)
    stops.add_metric(who, float(found["stops"]))
    yield stops
    blamed = GaugeMetricFamily("joint_monitor_safety_stops_kept", "Of the stops that are kept, by the joint told", labels=[*names, "joint"])
    for each in found["stops_by_joint"]:
        blamed.add_metric([*who, str(each["joint"])], float(each["stops"]))
    yield blamed
    due = GaugeMetricFamily("joint_monitor_inspection_due_timestamp_seconds", "When a check is due", labels=[*names, "item"])
    state = GaugeMetricFamily("joint_monitor_inspection_due", "1 where a check is due, or nobody has recorded it", labels=[*names, "item"])
    for item in found["items"]:
        if item["due"] is not None:
            due.add_metric([*who, item["name"]], unix_s(item["due"]))
        state.add_metric([*who, item["name"]], float(item["state"] in MUST_BE_MADE))
    yield from (due, state)
