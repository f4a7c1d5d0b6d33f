"""A report's document → one self-contained HTML page, laid out for the maintenance file."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.judge.alerts.health import COMMON_MODE, FRICTION_FALLING, RISES
from monitor.judge.alerts.rules import stale_words
from monitor.recording import Array
from monitor.views.report.html import Column, Markup, bullets, drawn, escaped, heading, page, paragraph, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {
    "NORMAL": "#14682f", "CHECK_FUNCTION": "#a34e00", "OFF_SPEC": "#7d5e00", "MAINTENANCE_REQUIRED": "#1b4fae", "FAILURE": "#a3161c",
}  # fmt: skip
WORDS = {
    "NORMAL": "normal",
    "CHECK_FUNCTION": "check function",
    "OFF_SPEC": "out of specification",
    "MAINTENANCE_REQUIRED": "maintenance required",
    "FAILURE": "failure",
}
LINE, POINT = "#1f6fb4", "#c8781e"
MOST_POINTS = 1500
FACTS = {
    "serial": "serial number",
    "firmware": "firmware",
    "mounting_rad": "mounting",
    "payload_kg": "payload",
    "tool": "tool",
    "trajectory_digest": "trajectory",
}


def report_page(reports: Sequence[Mapping[str, Any]]) -> str:
    """All robots on one page, each beginning on a sheet of its own."""
    parts: list[str] = []
    for number, one in enumerate(reports):
        parts += _robot(one, new_page=number > 0)
    names = ", ".join(f"{one['robot']['site']}/{one['robot']['id']}" for one in reports)
    first = reports[0]
    subtitle = f"{names}. {_day(first['from'])} to {_day(first['to'])}; made {_time(first['made_at'])} by joint-monitor {first['version']}"
    return page("Friction health report", subtitle, parts)


def _robot(told: Mapping[str, Any], *, new_page: bool) -> list[str]:
    who, unwatched, verdict = told["robot"], told["unwatched"], told["verdict"]
    parts = [
        heading(f"{who['site']}/{who['id']}: {who['model'].upper()}", new_page=new_page),
        paragraph(
            f"Serial number {who['serial'] or 'not given'}; {who['mounting']}; payload {who['payload_kg']:g} kg; tool {who['tool']}; "
            f"trajectory {who['trajectory']}. Times are UTC.",
            "dim",
        ),
        _verdict(told),
    ]
    if verdict is not None:
        parts += [heading("Joints at the end of the period", 3), _joints(told)]
    parts += [heading("Alerts and their evidence", 3), *_alerts(told)]
    if told["history"]:
        parts += [
            heading("Friction over the period", 3),
            drawn(_over_time(told), _over_time_says(told)),
            drawn(
                _over_temperature(told),
                "Viscous friction over joint temperature, wear taken out; the law of all replays so far, ± 2σ; %/K as a straight line.",
            ),
        ]
    parts += [heading("Changes of context", 3), *_contexts(told)]
    failed = len(unwatched["failed"])
    parts += [
        heading("What was not monitored, and why", 3),
        paragraph(f"{unwatched['assessed']} of {unwatched['windows']} windows were assessed; {failed} taught nothing.")
        if unwatched["windows"]
        else paragraph("No window was attempted: the monitor did not run, or its schedule had none.", "warn"),
        *_unwatched(told),
        *_stops(told),
        heading("Thresholds in force when this was made", 3),
        paragraph(_thresholds(told["thresholds"])),
        heading("What this method cannot see", 3),
        bullets(told["limits"]),
        Markup(
            '<table style="margin-top:12mm"><tbody><tr><td style="width:50%">Reviewed by</td><td>Date, signature</td></tr></tbody></table>'
        ),
    ]
    return parts


def _verdict(told: Mapping[str, Any]) -> str:
    verdict = told["verdict"]
    if verdict is None:
        return '<div class="box">' + paragraph("No replay was assessed in this period: nothing can be said of this arm.", "warn") + "</div>"
    active = [alert for alert in told["alerts"] if alert["active"]]
    lines = [
        paragraph(Markup(f"{_chip(verdict['health']['arm'])} {escaped(_plain(verdict['why']['arm']))}")),
        paragraph(
            f"As of the last replay of the period, {_time(verdict['at'])}. Active alerts at the end of the period: {len(active)}.",
            "dim",
        ),
    ]
    return '<div class="box">' + "".join(lines) + _stale(told) + "</div>"


def _stale(told: Mapping[str, Any]) -> str:
    old = told["stale"]
    if not old:
        return ""
    known = [one["learnt_at"] for one in old if one["learnt_at"]]
    since = f"since {_time(min(known))}" if known else "in this period"
    text = stale_words([one["joint"] for one in old], len(told["joints"]), since, "the period's end")
    return paragraph(f"{text}. Find out below why, and have the arm replayed before relying on it.", "warn")


def _chip(state: str) -> Markup:
    return Markup(f'<span class="chip" style="color:{COLOURS.get(state, "#555")}">{escaped(WORDS.get(state, state))}</span>')


def _joints(told: Mapping[str, Any]) -> str:
    states = told["verdict"]["health"]["joints"]
    old = {one["joint"] for one in told["stale"]}
    rows = []
    for row in told["joints"]:
        life = row["remaining_life"]
        rows.append(
            [
                f"joint {row['joint']}",
                Markup(_chip(states[row["joint"] - 1]) + (" <b class=warn>STALE</b>" if row["joint"] in old else "")),
                f"{100 * row['wear']:+z.1f} ± {100 * row['wear_std']:.1f}",
                f"{3000 * row['wear_rate_per_day']:+z.1f} ± {3000 * row['wear_rate_std_per_day']:.1f}",
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
    return table([*columns, Column("T [°C]")], rows)


def _life(life: Mapping[str, Any]) -> str:
    if life["verdict"] == "reached":
        return "limit reached"
    if life["p50_days"] is None:
        return "no trend"
    low, high = ("–" if life[key] is None else f"{life[key]:.0f}" for key in ("p10_days", "p90_days"))
    return f"{life['p50_days']:.0f} d ({low}–{high})"


def _alerts(told: Mapping[str, Any]) -> list[str]:
    parts = []
    for alert in told["alerts"]:
        place = "The arm" if alert["joint"] is None else f"Joint {alert['joint']}"
        state = f"active, {alert['tier']}" if alert["active"] else f"cleared {_time(alert['cleared_at'])}"
        lines = [
            paragraph(
                Markup(
                    f"<b>{escaped(place)}: {escaped(_plain(alert['condition']))}</b> ({escaped(state)}), raised {_time(alert['raised_at'])}"
                )
            ),
            paragraph(alert["text"]),
            _sure(alert),
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
    if told["events"]:
        rows = [
            [
                _time(event["at"]),
                "arm" if event["joint"] is None else f"joint {event['joint']}",
                _plain(event["condition"]),
                f"{event['kind']}, {event['tier']}",
                _by(event),
            ]
            for event in told["events"]
        ]
        parts += [paragraph("Every transition:", "dim"), table(["when", "", "condition", "what", "by whom and why"], rows)]
    return parts


def _sure(alert: Mapping[str, Any]) -> str:
    """What the alert's figure is the probability of; conditions of the data have none."""
    if alert["condition"] in {*RISES, COMMON_MODE}:
        what = "has risen by more than the tier's rise"
    elif alert["condition"] == FRICTION_FALLING:
        what = "has fallen by more than the wear tier's rise"
    else:
        return ""
    chance = alert["probability"]  # no evidence makes it 100 %
    return paragraph(f"Probability that friction {what}: {'more than 99.99' if chance > 0.9999 else f'{100 * chance:.2f}'} %.")


def _by(event: Mapping[str, Any]) -> str | None:
    verb = {"acknowledged": "acknowledged", "shelved": "shelved"}.get(event["kind"])
    if verb is None:
        return None
    why = event[f"{verb}_why"]
    return f"{event[f'{verb}_by']}{f': {why}' if why else ''}"


def _contexts(told: Mapping[str, Any]) -> list[str]:
    if not told["contexts"]:
        return [paragraph("None was seen: no replay was assessed.")]
    rows = []
    for change in told["contexts"]:
        what = [
            f"{FACTS[name]}: {_fact(name, after)}"
            if change is told["contexts"][0]
            else f"{FACTS[name]}: {_fact(name, before)} → {_fact(name, after)}"
            for name, (before, after) in change["changed"].items()
        ]
        first = (
            "in force at first"
            if change is told["contexts"][0]
            else ("a new baseline" if change["new"] else "known before: its baseline again")
        )
        rows.append([_time(change["at"]), f"replay {change['replay']}", "; ".join(what), first])
    return [table(["when", "", "what", "what it meant"], rows)]


def _fact(name: str, value: Any) -> str:
    if value is None:
        return "not known"
    if name == "payload_kg":
        return f"{value:g} kg"
    if name == "mounting_rad":
        return " / ".join(f"{np.degrees(angle):.0f}°" for angle in value)
    return str(value)


def _unwatched(told: Mapping[str, Any]) -> list[str]:
    unwatched, parts = told["unwatched"], []
    if unwatched["failed"]:
        rows = [[_time(row["window"]), row["state"], row["reason"]] for row in unwatched["failed"]]
        parts.append(table(["window", "ended", "why"], rows))
    items = [f"No replay was learnt from between {_time(gap['from'])} and {_time(gap['to'])}." for gap in unwatched["gaps"]]
    items += [f"Joint {row['joint']}: {row['replays']} of {row['of']} replays said nothing of its friction." for row in unwatched["joints"]]
    items += [f"Warning {warning['code']} in {warning['count']} of the replays, e.g.: {warning['text']}" for warning in told["warnings"]]
    if items:
        parts.append(bullets(items))
    elif not parts:
        parts.append(paragraph("Nothing was left out.", "good"))
    return parts


def _stops(told: Mapping[str, Any]) -> list[str]:
    """Stops that a person had to look at; nothing where there was none."""
    if not told["stops"]:
        return []
    rows = [
        [
            _time(stop["at"]),
            f"{_plain(stop['cause'])}: {stop['reason']}",
            Markup('<b class="warn">nobody: nothing moves</b>')
            if stop["allowed_at"] is None
            else f"{stop['allowed_by']}, {_time(stop['allowed_at'])}: {stop['allowed_why'] or 'no reason'}",
        ]
        for stop in told["stops"]
    ]
    return [
        heading("Stops that a person had to look at", 3),
        table(["when", "what ended the replay", "who allowed motion again, and why"], rows),
    ]


def _thresholds(of: Mapping[str, Any]) -> str:
    return (
        f"Advisory from {100 * of['advisory_rise']:g} %, wear tier from {100 * of['wear_rise']:g} %, limit from {100 * of['limit_rise']:g} "
        f"% more friction than at first, in {of['min_replays']} replays on {of['min_days']} days at least, at most "
        f"{of['false_alarms_per_year']:g} alerts a year that mean nothing. Life left is until {100 * of['life_limit_rise']:g} %; the next "
        f"service is taken to be in {of['service_days']:g} days."
    )


# --- drawings ------------------------------------------------------------------------------------------


def _panels(height: float) -> "tuple[Figure, Any]":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, height), layout="constrained")
    return figure, figure.subplots(2, 3).ravel()


def _of_joint(told: Mapping[str, Any], joint: int) -> list[Mapping[str, Any]]:
    rows = [row for row in told["history"] if row["joint"] == joint]
    return rows[:: max(1, len(rows) // MOST_POINTS)]


def _over_time_says(told: Mapping[str, Any]) -> str:
    rows = told["history"]
    text = "Friction since the beginning, temperature taken out: the estimate from all replays until then as a line with its 2σ band, "
    text += "and what each replay says by itself as a point with its own 2σ interval. Where there is a trend, a fan leads to the "
    of = told["thresholds"]
    text += f"limit (P10 to P90, P50 dashed). Across: the wear tier at {100 * of['wear_rise']:g} % dashed, the limit at "
    text += f"{100 * of['limit_rise']:g} % dash-dotted."
    missing = sum(1 for row in rows if row.get("replay_torque_nm") is None)
    if missing:
        text += f" Of {missing} of {len(rows)} figures the history keeps the estimate only, so they have no point."
    return text


def _alone(rows: Sequence[Mapping[str, Any]]) -> tuple[Any, Any]:
    """(N,) change [%] that each replay shows by itself, against the unworn friction of its day, and its std; NaN where not kept."""
    keys = ("replay_torque_nm", "replay_torque_std_nm", "reference_torque_nm", "wear")
    one, std, every, wear = (np.array([row.get(key) for row in rows], dtype=float) for key in keys)
    unworn = every / (1.0 + wear)
    return 100 * (one / unworn - 1.0), 100 * std / unworn


def _over_time(told: Mapping[str, Any]) -> "Figure":
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    figure, axes = _panels(4.2)
    of = told["thresholds"]
    for j, one in enumerate(axes):
        rows = _of_joint(told, j + 1)
        if not rows:
            one.set_visible(False)
            continue
        at = [datetime.fromisoformat(row["recorded_at"]).astimezone(UTC).replace(tzinfo=None) for row in rows]
        wear, std = (100 * np.array([row[key] for row in rows]) for key in ("wear", "wear_std"))
        one.fill_between(at, wear - 2 * std, wear + 2 * std, color=LINE, alpha=0.2, lw=0)
        alone, alone_std = _alone(rows)
        many = len(rows) >= 300
        one.errorbar(at, alone, 2 * alone_std, fmt=".", ms=2 if many else 3, lw=0.25 if many else 0.4, color=POINT, alpha=0.5)
        one.plot(at, wear, "-", lw=1.4, color=LINE)
        top = max(float(np.max(wear + 2 * std)), float(np.nanmax([0.0, *(alone + 2 * alone_std)])), 100 * of["wear_rise"] * 1.3)
        # by their dashes too: the page may be printed in grey
        for level, colour, dash in ((of["wear_rise"], COLOURS["MAINTENANCE_REQUIRED"], "--"), (of["limit_rise"], COLOURS["FAILURE"], "-.")):
            if 100 * level < 1.2 * top:
                one.axhline(100 * level, color=colour, lw=0.9, ls=dash)
        one.set_ylim(min(-3.0, float(np.min(wear - 2 * std)), float(np.nanmin([0.0, *(alone - 2 * alone_std)]))), 1.15 * top)
        _ahead(one, at, rows[-1], of["life_limit_rise"])
        locator = AutoDateLocator(minticks=2, maxticks=5)  # type: ignore[no-untyped-call]
        one.xaxis.set_major_locator(locator)
        one.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        _labelled(one, f"joint {j + 1}", "change [%]" if j % 3 == 0 else "")
    return figure


def _ahead(one: Any, at: Sequence[datetime], row: Mapping[str, Any], limit: float) -> None:
    """Remaining life as a fan to the limit: P10–P90 filled, P50 dashed, as far as there is room for; nothing without a trend."""
    life, wear = row["remaining_life"], row["wear"]
    if life["verdict"] != "trend" or life["p50_days"] is None or wear >= limit:
        return
    ends = [np.inf if life[key] is None else life[key] for key in ("p10_days", "p50_days", "p90_days")]
    to = min(max(1.5 * (at[-1] - at[0]).days, 60.0), 1.05 * ends[2])
    parts = [min(1.0, to / end) for end in ends]
    x = [at[-1] + timedelta(days=min(to, end)) for end in ends]
    y = [100 * (wear + part * (limit - wear)) for part in parts]
    one.fill([at[-1], x[0], x[2], x[2]], [100 * wear, y[0], y[0], y[2]], color=LINE, alpha=0.2, lw=0)
    one.plot([at[-1], x[1]], [100 * wear, y[1]], "--", lw=1.1, color=LINE)
    one.set_ylim(top=max(one.get_ylim()[1], 1.12 * y[0]))


def _over_temperature(told: Mapping[str, Any]) -> "Figure":
    figure, axes = _panels(4.1)
    laws = {law["joint"]: law for law in told["verdict"]["temperature"]} if told["verdict"] else {}
    for j, one in enumerate(axes):
        rows = [row for row in _of_joint(told, j + 1) if row["temperature_c"] is not None and row["viscous_nm_s_per_rad"] is not None]
        if not rows:
            one.set_visible(False)
            continue
        T = np.array([row["temperature_c"] for row in rows])
        fv = np.array([row["viscous_nm_s_per_rad"] / (1.0 + row["wear"]) for row in rows])
        one.plot(T, fv, ".", ms=4, color=POINT)
        law = laws.get(j + 1)
        if law is not None and law["viscous_nm_s_per_rad"] is not None:
            pace = 100 * law["slope_nm_s_per_rad_k"] / law["viscous_nm_s_per_rad"]
            at, fv_at, std_at = _law(law, [float(T.min()), float(T.max())])
            one.fill_between(at, fv_at - 2 * std_at, fv_at + 2 * std_at, color=LINE, alpha=0.2, lw=0)
            one.plot(at, fv_at, lw=1.4, color=LINE, label=f"{pace:+z.2f} %/K")
            one.legend(fontsize="x-small", frameon=False, loc="upper right")
        if j >= 3:
            one.set_xlabel("T [°C]", fontsize="small")
        _labelled(one, f"joint {j + 1}", "fv [Nm·s/rad]" if j % 3 == 0 else "")
    return figure


def _law(law: Mapping[str, Any], seen_c: Sequence[float]) -> Array:
    """(3, P): temperature, fv and its deviation along the law; of verdicts that tell no points, the ends of the straight line."""
    if law.get("viscous_by_temperature"):
        return np.array(law["viscous_by_temperature"]).T
    ends = np.array(law["range_c"] or seen_c)
    line = law["viscous_nm_s_per_rad"] + law["slope_nm_s_per_rad_k"] * (ends - law["reference_temperature_c"])
    return np.stack([ends, line, np.zeros(2)])


def _labelled(one: Any, title: str, ylabel: str) -> None:
    one.set_title(title, fontsize="small", loc="left")
    one.set_ylabel(ylabel, fontsize="small")
    one.tick_params(labelsize="x-small")
    one.xaxis.get_offset_text().set_size("x-small")
    one.grid(alpha=0.25)


# --- words ---------------------------------------------------------------------------------------------


def _plain(text: str) -> str:
    return text.replace("_", " ")


def _pair(value: float | None, std: float | None) -> str | None:
    return None if value is None else f"{value:.2f} ± {0.0 if std is None else std:.2f}"


def _time(text: str) -> str:
    return datetime.fromisoformat(text).strftime("%Y-%m-%d %H:%M")


def _day(text: str) -> str:
    return text[:10]
