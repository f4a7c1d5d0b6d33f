"""The report as one self-contained HTML page, made from the documents of its robots."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.alerts.life_text import assumptions_text
from monitor.judge.alerts.staleness import stale_text
from monitor.judge.alerts.unseen_step import unseen_steps_text
from monitor.model.joint_names import joint_text
from monitor.views.language.catalogue import ENGLISH, Language
from monitor.views.report.charts import STATE_COLOURS, friction_over_temperature, friction_over_time, friction_over_time_caption
from monitor.views.report.html import Column, Markup, bullets, drawn, escaped, heading, page, paragraph, table
from monitor.views.units import PERCENT_PER_MONTH

STATE_WORDS = {
    "NORMAL": "normal",
    "CHECK_FUNCTION": "check function",
    "OFF_SPEC": "out of specification",
    "MAINTENANCE_REQUIRED": "maintenance required",
    "FAILURE": "failure",
}
CONTEXT_WORDS = {
    "serial": "serial number",
    "firmware": "firmware",
    "mounting_rad": "mounting",
    "payload_kg": "payload",
    "tool": "tool",
    "trajectory_digest": "trajectory",
}


def report_page(reports: Sequence[Mapping[str, Any]], say: Language = ENGLISH) -> str:
    """The HTML page. Each robot begins on a new sheet. reports : documents of `service.report`."""
    parts: list[str] = []
    for number, one in enumerate(reports):
        parts += _robot(one, new_page=number > 0)
    names = ", ".join(f"{one['robot']['site']}/{one['robot']['id']}" for one in reports)
    first = reports[0]
    subtitle = f"{names}. {_day(first['from'])} to {_day(first['to'])}; made {_time(first['made_at'])} by joint-monitor {first['version']}"
    return page(say.say("Friction health report"), subtitle, parts)


def _robot(report: Mapping[str, Any], *, new_page: bool) -> list[str]:
    """The sections of one robot."""
    who, unwatched, verdict = report["robot"], report["unwatched"], report["verdict"]
    parts = [
        heading(f"{who['site']}/{who['id']}: {who['model'].upper()}", new_page=new_page),
        paragraph(
            f"Serial number {who['serial'] or 'not given'}; {who['mounting']}; payload {who['payload_kg']:g} kg; tool {who['tool']}; "
            f"trajectory {who['trajectory']}. Times are UTC.",
            "dim",
        ),
        _verdict(report),
    ]
    if verdict is not None:
        parts += [heading("Joints at the end of the period", 3), _joints(report)]
    parts += [heading("Alerts and their evidence", 3), *_alerts(report)]
    if report["history"]:
        parts += [
            heading("Friction over the period", 3),
            drawn(friction_over_time(report), friction_over_time_caption(report)),
            drawn(
                friction_over_temperature(report),
                "Viscous friction over joint temperature, wear taken out; the law of all replays so far, ± 2σ; %/K as a straight line.",
            ),
        ]
    parts += [heading("Changes of context", 3), *_contexts(report)]
    failed = len(unwatched["failed"])
    parts += [
        heading("What was not monitored, and why", 3),
        paragraph(f"{unwatched['assessed']} of {unwatched['windows']} windows were assessed; {failed} taught nothing.")
        if unwatched["windows"]
        else paragraph("No window was attempted: the monitor did not run, or its schedule had none.", "warn"),
        *_unwatched(report),
        *_stops(report),
        heading("Thresholds in force when this was made", 3),
        paragraph(_thresholds(report["thresholds"])),
        heading("What this method cannot see", 3),
        bullets(report["limits"]),
        Markup(
            '<table style="margin-top:12mm"><tbody><tr><td style="width:50%">Reviewed by</td><td>Date, signature</td></tr></tbody></table>'
        ),
    ]
    return parts


def _verdict(report: Mapping[str, Any]) -> str:
    """The box at the top: the state of the arm at the end of the period, and what is too old to rely on."""
    verdict = report["verdict"]
    if verdict is None:
        return '<div class="box">' + paragraph("No replay was assessed in this period: nothing can be said of this arm.", "warn") + "</div>"
    active = [alert for alert in report["alerts"] if alert["active"]]
    lines = [
        paragraph(Markup(f"{_chip(verdict['health']['arm'])} {escaped(_plain(verdict['why']['arm']))}")),
        paragraph(
            f"As of the last replay of the period, {_time(verdict['at'])}. Active alerts at the end of the period: {len(active)}.",
            "dim",
        ),
    ]
    return '<div class="box">' + "".join(lines) + _stale(report) + "</div>"


def _stale(report: Mapping[str, Any]) -> str:
    """Which joints have not been assessed for too long; nothing where all have."""
    old = report["stale"]
    if not old:
        return ""
    known = [one["learnt_at"] for one in old if one["learnt_at"]]
    since = f"since {_time(min(known))}" if known else "in this period"
    text = stale_text([one["joint"] for one in old], len(report["joints"]), since, "the period's end")
    return paragraph(f"{text}. Find out below why, and have the arm replayed before relying on it.", "warn")


def _chip(state: str) -> Markup:
    """A state as a word in its colour."""
    return Markup(f'<span class="chip" style="color:{STATE_COLOURS.get(state, "#555")}">{escaped(STATE_WORDS.get(state, state))}</span>')


def _joints(report: Mapping[str, Any]) -> str:
    """A table with one row for each joint."""
    states = report["verdict"]["health"]["joints"]
    old = {one["joint"] for one in report["stale"]}
    rows = []
    for row in report["joints"]:
        life = row["remaining_life"]
        rows.append(
            [
                joint_text(row["joint"]),
                Markup(_chip(states[row["joint"] - 1]) + (" <b class=warn>STALE</b>" if row["joint"] in old else "")),
                f"{100 * row['wear']:+z.1f} ± {100 * row['wear_std']:.1f}",
                f"{PERCENT_PER_MONTH * row['wear_rate_per_day']:+z.1f} ± {PERCENT_PER_MONTH * row['wear_rate_std_per_day']:.1f}",
                _life(life),
                f"{100 * life.get('before_service_probability', 0.0):.0f}",
                _pair(row["coulomb_nm"], row["coulomb_std_nm"]),
                _pair(row["viscous_nm_s_per_rad"], row["viscous_std_nm_s_per_rad"]),
                None if row["temperature_c"] is None else f"{row['temperature_c']:.1f}",
            ]
        )
    columns: list[Column | str] = [
        "",
        "state",
        Column("wear [%]"),
        Column("pace [%/month]"),
        Column("life left"),
        Column("limit before service [%]"),
        Column("fc [Nm]"),
        Column("fv [Nm·s/rad]"),
    ]
    unseen = unseen_steps_text(report["joints"])
    assumptions = assumptions_text(report["joints"])
    said = "".join(paragraph(text, "dim") for text in (assumptions, unseen) if text)
    return table([*columns, Column("T [°C]")], rows) + said


def _life(life: Mapping[str, Any]) -> str:
    """Remaining life as a cell: median, P10 and P90 [days]."""
    if life["verdict"] == "reached":
        return "limit reached"
    if life["p50_days"] is None:
        return "no trend"
    low, high = ("–" if life[key] is None else f"{life[key]:.0f}" for key in ("p10_days", "p90_days"))
    return f"{life['p50_days']:.0f} d ({low}–{high})"


def _alerts(report: Mapping[str, Any]) -> list[str]:
    """A box for each alert of the period, and a table of all transitions."""
    parts = []
    for alert in report["alerts"]:
        place = "The arm" if alert["joint"] is None else joint_text(alert["joint"])
        state = f"active, {alert['tier']}" if alert["active"] else f"cleared {_time(alert['cleared_at'])}"
        lines = [
            paragraph(
                Markup(
                    f"<b>{escaped(place)}: {escaped(_plain(alert['condition']))}</b> ({escaped(state)}), raised {_time(alert['raised_at'])}"
                )
            ),
            paragraph(alert["text"]),
            _probability(alert),
            paragraph(f"Asked: {alert['action']}") if alert["active"] else "",
        ]
        if alert["acknowledged_at"]:
            why = f": {alert['acknowledged_why']}" if alert["acknowledged_why"] else ""
            lines.append(paragraph(f"Acknowledged by {alert['acknowledged_by']}, {_time(alert['acknowledged_at'])}{why}"))
        else:
            lines.append(paragraph("Not acknowledged.", "warn"))
        if alert["shelved_until"]:
            lines.append(
                paragraph(f"Shelved by {alert['shelved_by']} until {_time(alert['shelved_until'])}: {alert['shelved_why'] or 'no reason'}")
            )
        parts.append('<div class="box">' + "".join(lines) + "</div>")
    if not parts:
        parts.append(paragraph("None was active in this period.", "good"))
    if report["events"]:
        rows = [
            [
                _time(event["at"]),
                "arm" if event["joint"] is None else joint_text(event["joint"]),
                _plain(event["condition"]),
                f"{event['kind']}, {event['tier']}",
                _by(event),
            ]
            for event in report["events"]
        ]
        parts += [paragraph("Every transition:", "dim"), table(["when", "", "condition", "what", "by whom and why"], rows)]
    return parts


def _probability(alert: Mapping[str, Any]) -> str:
    """The probability of the change that the condition is about; nothing for a condition of the data, which has none."""
    condition = CONDITIONS.get(alert["condition"])
    if condition is None or condition.probability_of is None:
        return ""
    what = condition.probability_of
    chance = alert["probability"]  # no evidence makes it 100 %
    return paragraph(f"Probability that friction {what}: {'more than 99.99' if chance > 0.9999 else f'{100 * chance:.2f}'} %.")


def _by(event: Mapping[str, Any]) -> str | None:
    """Who acknowledged or shelved the alert, and why; None for another transition."""
    verb = {"acknowledged": "acknowledged", "shelved": "shelved"}.get(event["kind"])
    if verb is None:
        return None
    why = event[f"{verb}_why"]
    return f"{event[f'{verb}_by']}{f': {why}' if why else ''}"


def _contexts(report: Mapping[str, Any]) -> list[str]:
    """The context at first and each of its changes: arm, mounting, payload, tool, trajectory."""
    if not report["contexts"]:
        return [paragraph("None was seen: no replay was assessed.")]
    rows = []
    for change in report["contexts"]:
        what = [
            f"{CONTEXT_WORDS[name]}: {_fact(name, after)}"
            if change is report["contexts"][0]
            else f"{CONTEXT_WORDS[name]}: {_fact(name, before)} → {_fact(name, after)}"
            for name, (before, after) in change["changed"].items()
        ]
        first = (
            "in force at first"
            if change is report["contexts"][0]
            else ("a new baseline" if change["new"] else "known before: its baseline again")
        )
        rows.append([_time(change["at"]), f"replay {change['replay']}", "; ".join(what), first])
    return [table(["when", "", "what", "what it meant"], rows)]


def _fact(name: str, value: Any) -> str:
    """One fact of a context, with its unit."""
    if value is None:
        return "not known"
    if name == "payload_kg":
        return f"{value:g} kg"
    if name == "mounting_rad":
        return " / ".join(f"{np.degrees(angle):.0f}°" for angle in value)
    return str(value)


def _unwatched(report: Mapping[str, Any]) -> list[str]:
    """Windows without an assessment, gaps between replays, joints without information, and warnings."""
    unwatched, parts = report["unwatched"], []
    if unwatched["failed"]:
        rows = [[_time(row["window"]), row["state"], row["reason"]] for row in unwatched["failed"]]
        parts.append(table(["window", "ended", "why"], rows))
    items = [f"No replay was learnt from between {_time(gap['from'])} and {_time(gap['to'])}." for gap in unwatched["gaps"]]
    items += [
        f"{joint_text(row['joint'])}: {row['replays']} of {row['of']} replays said nothing of its friction." for row in unwatched["joints"]
    ]
    items += [f"Warning {warning['code']} in {warning['count']} of the replays, e.g.: {warning['text']}" for warning in report["warnings"]]
    if items:
        parts.append(bullets(items))
    elif not parts:
        parts.append(paragraph("Nothing was left out.", "good"))
    return parts


def _stops(report: Mapping[str, Any]) -> list[str]:
    """Stops after which a person had to allow motion again; nothing where there was none."""
    if not report["stops"]:
        return []
    rows = [
        [
            _time(stop["at"]),
            f"{_plain(stop['cause'])}: {stop['reason']}",
            Markup('<b class="warn">nobody: nothing moves</b>')
            if stop["allowed_at"] is None
            else f"{stop['allowed_by']}, {_time(stop['allowed_at'])}: {stop['allowed_why'] or 'no reason'}",
        ]
        for stop in report["stops"]
    ]
    return [
        heading("Stops that a person had to look at", 3),
        table(["when", "what ended the replay", "who allowed motion again, and why"], rows),
    ]


def _thresholds(of: Mapping[str, Any]) -> str:
    """The alert settings as sentences."""
    return (
        f"Advisory from {100 * of['advisory_rise']:g} %, wear tier from {100 * of['wear_rise']:g} %, limit from {100 * of['limit_rise']:g} "
        f"% more friction than at first, in {of['min_replays']} replays on {of['min_days']} days at least, at most "
        f"{of['false_alarms_per_year']:g} alerts a year that mean nothing. Life left is until {100 * of['life_limit_rise']:g} %; the next "
        f"service is taken to be in {of['service_days']:g} days."
    )


def _plain(text: str) -> str:
    return text.replace("_", " ")


def _pair(value: float | None, std: float | None) -> str | None:
    return None if value is None else f"{value:.2f} ± {0.0 if std is None else std:.2f}"


def _time(text: str) -> str:
    return datetime.fromisoformat(text).strftime("%Y-%m-%d %H:%M")


def _day(text: str) -> str:
    return text[:10]
