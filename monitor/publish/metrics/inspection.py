"""Metrics of inspection duties, from the document `inspection`."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from monitor.judge.inspection import MUST_BE_MADE
from monitor.publish.timestamps import unix_s

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
