"""The report on one robot over a period, from its history: findings, their evidence, and gaps in the monitoring."""

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from monitor import __version__
from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.judge.alerts.health import TIERS
from monitor.publish.documents import as_json
from monitor.publish.timestamps import outside, rfc3339
from monitor.reason import Sentence, with_reasons
from monitor.recording import DAY_S
from monitor.service.history.inspection import inspection_document, stop_document
from monitor.service.history.maintenance import row_document
from monitor.service.history.needed import stored_from_production
from monitor.store.history.events import AlertEvent
from monitor.store.history.motions import Stop
from monitor.store.store import Store

GAP = 2.5  # times the usual interval between replays: a longer pause is a gap in the monitoring
FACTS = ("serial", "firmware", "mounting_rad", "payload_kg", "tool", "trajectory_digest")
STOPS_SHOWN = 40  # newest stops of the safety system in the period
FAILED = ("skipped", "rejected", "aborted")
LIMITS = (
    Sentence(
        "limit_breaks", "Friction does not see everything: a flexspline or a bearing can break with little change of friction before it."
    )(),
    Sentence(
        "limit_changes",
        "Wear that begins together with a change of tool, payload, mounting or trajectory never seen before is taken for the change.",
    )(),
    Sentence(
        "limit_life",
        "Remaining life is the time until friction meets its configured limit, not until a joint fails.",
    )(),
    Sentence(
        "limit_common", "All joints rising together is taken for what they share (temperature, supply, payload), not for wear of each."
    )(),
)


def report(
    configuration: Configuration, store: Store, from_unix_s: float | None, to_unix_s: float | None, now_unix_s: float
) -> dict[str, Any]:
    """The content of the printed page as one JSON document, for the period [from, to).

    Raises BadInput where the period ends before it begins, or lies before the first window or in the future.
    """
    begin, end = _period(configuration.robot.id, store, from_unix_s, to_unix_s, now_unix_s)
    rows = _rows(store, begin, end)
    windows = [row for row in store.ledger.rows() if begin <= row.window_unix_s < end]
    until = [event for event in store.events.rows() if event.at_unix_s < end]
    events = [event for event in until if begin <= event.at_unix_s]
    contexts, warnings, last = _facts(store, begin, end)
    state = store.assessments.state()
    document: Any = outside(
        {
            "robot": _robot(configuration),
            "from_unix_s": begin,
            "to_unix_s": end,
            "made_at_unix_s": now_unix_s,
            "version": __version__,
            "thresholds": _thresholds(configuration),
            "verdict": None if last is None else _verdict(last),
            "joints": _newest(rows),
            "stale": _stale(rows, begin, min(end, now_unix_s), configuration),
            "alerts": _alerts(until, state.health if state else None, begin, end),
            "maintenance": _maintenance(store, begin, end),
            **_from_production(configuration, store),
            **_inspection(configuration, store, begin, end, now_unix_s),
            "events": [{"seq": event.seq, "at_unix_s": event.at_unix_s, **_short(event.document)} for event in events],
            "contexts": contexts,
            "unwatched": _unwatched(windows, rows, begin, min(end, now_unix_s), configuration.robot_description.joints),
            "stops": [_stop(stop, end) for stop in store.stops.rows() if begin <= stop.at_unix_s < end],
            "warnings": warnings,
            "limits": [limit.document() for limit in LIMITS],
            "history": rows,
        }
    )
    assert isinstance(document, dict)
    return document


def _robot(configuration: Configuration) -> dict[str, Any]:
    """The arm as it is configured."""
    names = ("site", "id", "model", "serial", "mounting", "payload_kg", "tool")
    return {name: getattr(configuration.robot, name) for name in names} | {"trajectory": configuration.excitation.digest}


def _verdict(last: Mapping[str, Any]) -> dict[str, Any]:
    """The last assessment of the period, in short."""
    return {"at_unix_s": last["recorded_at_unix_s"], **{name: last[name] for name in ("health", "why", "temperature")}}


def _period(robot: str, store: Store, from_unix_s: float | None, to_unix_s: float | None, now_unix_s: float) -> tuple[float, float]:
    windows = [row.window_unix_s for row in store.ledger.rows()]
    if not windows:
        raise BadInput(f"{robot}: no replay was attempted yet: there is nothing to report")
    begin = from_unix_s if from_unix_s is not None else min(windows)
    end = to_unix_s if to_unix_s is not None else max(now_unix_s, windows[-1] + 1.0)
    if not begin < end:
        raise BadInput(f"the period ends at {rfc3339(end)}, before it begins at {rfc3339(begin)}; expected --from before --to")
    if end <= min(windows) or begin > max(now_unix_s, windows[-1]):
        raise BadInput(
            f"{robot}: nothing was attempted from {rfc3339(begin)} to {rfc3339(end)}; expected a period after {rfc3339(min(windows))}, "
            f"when the first window was, and not in the future"
        )
    return begin, end


def _rows(store: Store, begin: float, end: float) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    after: int | None = 0
    while after is not None:
        page, after = store.assessments.history(from_unix_s=begin, to_unix_s=end, after=after, limit=10_000)
        rows += page
    return rows


def _facts(store: Store, begin: float, end: float) -> tuple[list[dict[str, Any]], list[dict[str, Any]], dict[str, Any] | None]:
    """Contexts that were opened or resumed in the period with what changed, counted warnings, and the last assessment."""
    contexts: list[dict[str, Any]] = []
    counts: Counter[str] = Counter()
    examples: dict[str, Mapping[str, Any]] = {}
    last, before = None, None
    for replay, at, document in store.assessments.between(begin, end):
        last = document
        for warning in document.get("warnings", ()):
            counts[warning["code"]] += 1
            examples.setdefault(warning["code"], warning)
        ledger = document.get("contexts") or []
        now = ledger[-1]["context"] if ledger else None
        if now is not None and now != before:
            changed = {name: [None if before is None else before.get(name), now.get(name)] for name in FACTS}
            contexts.append(
                {
                    "replay": replay,
                    "at_unix_s": at,
                    "new": bool(ledger[-1].get("replays", 0) <= 1),
                    "changed": {name: pair for name, pair in changed.items() if before is None or pair[0] != pair[1]},
                }
            )
            before = now
    warnings = [{**examples[code], "count": count} for code, count in counts.most_common()]
    return contexts, warnings, last


def _thresholds(configuration: Configuration) -> dict[str, Any]:
    health, prognosis = configuration.assess.health, configuration.assess.prognosis
    return {
        "advisory_rise": health.advisory_rise,
        "wear_rise": health.wear_rise,
        "limit_rise": health.limit_rise,
        "false_alarms_per_year": health.false_alarms_per_year,
        "min_replays": health.min_replays,
        "min_days": health.min_days,
        "life_limit_rise": prognosis.limit_rise,
        "service_days": prognosis.service_days,
    }


def _newest(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    newest = {row["joint"]: dict(row) for row in rows}
    return [newest[joint] for joint in sorted(newest)]


def _stale(rows: Sequence[Mapping[str, Any]], begin: float, end: float, configuration: Configuration) -> list[dict[str, Any]]:
    """Joints without a figure in the last `stale_days` of the period; none where the period is shorter than that."""
    limit = end - configuration.assess.health.stale_days * DAY_S
    learnt: dict[int, float | None] = dict.fromkeys(range(1, configuration.robot_description.joints + 1))
    for row in rows:
        # the replay has no figure of this joint, or the history is an old one without such figures
        if row.get("replay_torque_nm", row["reference_torque_nm"]) is not None:
            learnt[row["joint"]] = row["recorded_at_unix_s"]
    return [{"joint": joint, "learnt_at_unix_s": at} for joint, at in learnt.items() if (begin if at is None else at) < limit]


def _alerts(until: Sequence[AlertEvent], health: Mapping[str, Any] | None, begin: float, end: float) -> list[dict[str, Any]]:
    """The last alert of every condition that was active at some time of the period, as it stood at the period's end.

    until : all transitions before the end. health : alerts of a history that has lost its transitions.
    """
    found = {(alert["joint"], alert["condition"]): dict(alert) for alert in (health or {}).get("alerts", ())}
    for event in until:
        alert = {name: value for name, value in event.document.items() if name not in ("kind", "by", "why")}
        key = alert["joint"], alert["condition"]
        before = found.get(key) if event.document.get("kind") != "raised" else None
        found[key] = alert if alert.get("gravest") else alert | {"gravest": _graver(before, alert)}
    listed = [
        alert | {"active": alert["cleared_at_unix_s"] is None}
        for alert in found.values()
        if alert["raised_at_unix_s"] < end and (alert["cleared_at_unix_s"] is None or alert["cleared_at_unix_s"] >= begin)
    ]
    return sorted(listed, key=lambda alert: (not alert["active"], TIERS.index(alert["tier"]) * -1, alert["raised_at_unix_s"]))


def _graver(before: Mapping[str, Any] | None, alert: Mapping[str, Any]) -> dict[str, Any]:
    """The gravest moment of an alert whose transitions a release without it stored: the graver of that before and of this one."""
    now = {
        "at_unix_s": alert["updated_at_unix_s"],
        **{name: alert.get(name) for name in ("tier", "change", "probability", "text", "attribution")},
    }
    known = (before or {}).get("gravest") or now
    return max(known, now, key=lambda one: (TIERS.index(one["tier"]), abs(one["change"])))


def _from_production(configuration: Configuration, store: Store) -> dict[str, Any]:
    """What came from production, and how far the next replay is; nothing where no day of it was judged."""
    document = stored_from_production(store, configuration.schedule)
    return {} if document is None else {"from_production": as_json(document)}


def _inspection(configuration: Configuration, store: Store, begin: float, end: float, now_unix_s: float) -> dict[str, Any]:
    """Operating hours, stops of the period and checks; nothing where [inspection] asks for nothing."""
    document = inspection_document(configuration.inspection, store, now_unix_s)
    if document is None:
        return {}
    stops = store.duties.stops(from_unix_s=begin, to_unix_s=end)
    shown = [as_json(stop_document(stop)) for stop in stops[-STOPS_SHOWN:]]
    return {"inspection": {**as_json(document), "last_stops": shown, "stops_period": len(stops)}}


def _maintenance(store: Store, begin: float, end: float) -> list[dict[str, Any]]:
    """Work on joints that was done or declared in the period; what was taken back before its end says so."""
    rows = store.maintenance.rows()
    return [as_json(row_document(row)) for row in rows if begin <= row.declared_at_unix_s < end or begin <= row.document["at_unix_s"] < end]


def _stop(stop: Stop, end: float) -> dict[str, Any]:
    """A stop after which a person had to check the arm, and who allowed motion again before the period's end."""
    allowed = stop.allowed_at_unix_s is not None and stop.allowed_at_unix_s < end
    document = {
        "at_unix_s": stop.at_unix_s,
        "replay": stop.ledger_id,
        "cause": stop.cause,
        "allowed_at_unix_s": stop.allowed_at_unix_s if allowed else None,
        "allowed_by": stop.allowed_by if allowed else None,
        "allowed_why": stop.allowed_why if allowed else None,
    }
    return with_reasons(document, reason=stop.reason)


def _short(event: Mapping[str, Any]) -> dict[str, Any]:
    names = ("kind", "joint", "condition", "tier", "text", "by", "why", "acknowledged_by", "acknowledged_why", "shelved_by", "shelved_why")
    return {name: event.get(name) for name in (*names, "serviced_kind", "reasons")}


def _unwatched(windows: Sequence[Any], rows: Sequence[Mapping[str, Any]], begin: float, end: float, joints: int) -> dict[str, Any]:
    """Windows without an assessment with their reasons, gaps without a replay, and joints without a figure."""
    times = sorted({float(row["recorded_at_unix_s"]) for row in rows})
    usual = statistics.median(b - a for a, b in pairwise(times)) if len(times) > 1 else None
    gaps = []
    for a, b in zip([begin, *times], [*times, end], strict=True):
        if b - a > (GAP * usual if usual is not None else DAY_S if times else 0.0):
            gaps.append({"from_unix_s": a, "to_unix_s": b})
    silent: Counter[int] = Counter(int(row["joint"]) for row in rows if row.get("reference_torque_nm") is None)
    states = Counter(row.state for row in windows)
    return {
        "windows": len(windows),
        "assessed": states.get("assessed", 0),
        "failed": [
            with_reasons({"replay": row.id, "window_unix_s": row.window_unix_s, "state": row.state}, reason=row.reason)
            for row in windows
            if row.state in FAILED
        ],
        "usual_interval_s": usual,
        "gaps": gaps,
        "joints": [{"joint": joint, "replays": silent[joint], "of": len(times)} for joint in range(1, joints + 1) if silent[joint]],
    }
