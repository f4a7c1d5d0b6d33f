"""Metrics of the plant for Prometheus, read from the database when somebody scrapes: some series an arm, and of joints only those in need.

A joint's figures are metrics of its arm's own daemon. Here a series of a joint exists only where an alert of it is active, so that the
count of series grows with the arms, and not with all that is well.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import sqlalchemy as sa
from prometheus_client.core import GaugeMetricFamily, Metric

from monitor.errors import BadInput, StoreError
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.inspection import MUST_BE_MADE
from monitor.plant.arm import HeardArm
from monitor.plant.database import Database
from monitor.plant.status import PlantStatus, plant_status
from monitor.plant.tables import arm, last_value
from monitor.publish.documents import Inspection, InspectionItem, read
from monitor.publish.shown import Grade, unacknowledged

log = logging.getLogger(__name__)

Row = tuple[HeardArm, list[str]]  # with its labels


def plant_families(database: Database) -> Iterator[Metric]:
    """Metric families of every arm. A database that does not answer is itself a figure: nothing is known then."""
    up = GaugeMetricFamily("joint_monitor_plant_database_up", "1 while the plant's database answers")
    try:
        status = plant_status(database)
        checks = _checks_due(database)
    except StoreError as error:
        log.warning("metrics: %s", error)
        up.add_metric([], 0.0)
        yield up
        return
    up.add_metric([], 1.0)
    yield up
    yield from _plant(status)
    rows = [(each, list(each.name)) for each in status.arms]
    yield from _arms(rows)
    yield from _alerts(rows)
    due = _family("joint_monitor_plant_inspections_due", "Checks of [inspection] that are due or were never recorded", "site", "robot")
    for name, count in checks.items():
        due.add_metric(name, float(count))
    yield due


def _family(name: str, text: str, *labels: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, text, labels=labels)


def _plant(status: PlantStatus) -> Iterator[Metric]:
    running = _family("joint_monitor_plant_running", "1 while the plant copies histories")
    running.add_metric([], float(status.not_running is None))
    copying = _family("joint_monitor_plant_copying", "Arms whose histories are being copied")
    copying.add_metric([], float(status.copying))
    ways = _family("joint_monitor_plant_way_up", "1 where somebody answers at an endpoint of [plant] connect", "endpoint")
    for endpoint, is_up in status.ways.items():
        ways.add_metric([endpoint], float(is_up))
    arms = _family("joint_monitor_plant_arms", "Arms by how they are", "grade")
    counts = Counter(each.grade for each in status.arms)
    for grade in Grade:
        arms.add_metric([grade.value], float(counts[grade]))
    yield from (running, copying, ways, arms)


def _arms(rows: list[Row]) -> Iterator[Metric]:
    """One series an arm and family."""
    about = _family("joint_monitor_plant_arm_info", "The arms, each with its model and version", "site", "robot", "model", "version")
    state = _family("joint_monitor_plant_arm_state", "1 for the NE 107 state that an arm said last", "site", "robot", "state")
    for each, who in rows:
        about.add_metric([*who, each.model or "", each.version or ""], 1.0)
        if each.shown.state is not None:
            state.add_metric([*who, each.shown.state], 1.0)
    yield from (about, state)
    figures: tuple[tuple[str, str, Callable[[HeardArm], float | None]], ...] = (
        (
            "joint_monitor_plant_arm_grade",
            "How the arm is: 0 sick, 1 unseen, 2 doubtful, 3 well",
            lambda each: float(each.grade.order),
        ),
        ("joint_monitor_plant_arm_silent", "1 while nobody hears the arm's monitor", lambda each: float(each.silent is not None)),
        (
            "joint_monitor_plant_arm_stale",
            "1 while nothing was learnt of the arm for too long",
            lambda each: float(each.stale),
        ),
        ("joint_monitor_plant_arm_not_copied", "1 while the arm's history cannot be copied", lambda each: float(each.problem is not None)),
        ("joint_monitor_plant_arm_troubles", "Problems of the arm's own monitor", lambda each: float(len(each.troubles))),
        ("joint_monitor_plant_alerts_active", "Active alerts of the arm", lambda each: float(len(each.alerts))),
        ("joint_monitor_plant_alerts_unacknowledged", "Of these, nobody has seen", lambda each: float(len(unacknowledged(each.alerts)))),
        ("joint_monitor_plant_last_replay_timestamp_seconds", "The arm's newest window", _last_replay),
    )
    for name, text, figure in figures:
        family = _family(name, text, "site", "robot")
        for each, who in rows:
            if (value := figure(each)) is not None:
                family.add_metric(who, value)
        yield family


def _alerts(rows: list[Row]) -> Iterator[Metric]:
    labels = ("site", "robot", "joint", "condition", "tier")
    active = _family("joint_monitor_plant_alert_active", "1 for each active alert", *labels)
    change = _family("joint_monitor_plant_alert_change_ratio", "Change of friction that an active alert tells", *labels)
    for each, who in rows:
        for alert in each.alerts:
            place = [*who, "arm" if alert.joint is None else str(alert.joint), alert.condition, alert.tier]
            active.add_metric(place, 1.0)
            if (known := CONDITIONS.get(alert.condition)) is None or known.change_probable is not None:
                change.add_metric(place, alert.change)
    yield from (active, change)


def _checks_due(database: Database) -> dict[tuple[str, str], int]:
    """How many checks are due, of each arm that has any. Raises StoreError."""
    with database.read() as connection:
        wanted = sa.select(arm.c.site, arm.c.robot, last_value.c.document).join(last_value, last_value.c.arm == arm.c.id)
        rows = connection.execute(wanted.where(last_value.c.key == "inspection")).all()
    return {(site, robot): sum(item.state in MUST_BE_MADE for item in _items(document)) for site, robot, document in rows}


def _items(document: Any) -> list[InspectionItem]:
    """The checks of a document, which came from elsewhere and may be none."""
    try:
        return read(Inspection, document).items
    except BadInput:
        return []


def _last_replay(each: HeardArm) -> float | None:
    return None if each.last_replay is None else each.last_replay.window.timestamp()
