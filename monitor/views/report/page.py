"""The report as one self-contained HTML page, made from the documents of its robots. A month in which nothing happened is one sheet."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from monitor.judge.alerts.remaining_life import assumptions
from monitor.judge.alerts.states import IN_PERIOD, PERIODS_END, SINCE, stale_reason, unseen_steps
from monitor.publish.shown import Age, shown_of
from monitor.publish.timestamps import unix_s
from monitor.reason import reason_from
from monitor.views.alert_sentence import OF_ONE_JOINTS_FRICTION
from monitor.views.history import PERCENT_PER_MONTH
from monitor.views.language.catalogue import ENGLISH, Language, full_day, moment
from monitor.views.report.alerts import alert_boxes, alerts_of, chip, lead, transitions
from monitor.views.report.charts import friction_over_temperature, friction_over_time, friction_over_time_caption
from monitor.views.report.html import Column, Markup, bullets, drawn, escaped, heading, page, paragraph, table
from monitor.views.report.sections import from_production, inspection, maintenance_table, unwatched

N_ = str  # marks a text for the catalogue
CONTEXT_WORDS = {
    "serial": N_("serial number"),
    "firmware": N_("firmware"),
    "mounting_rad": N_("mounting"),
    "payload_kg": N_("payload"),
    "tool": N_("tool"),
    "trajectory_digest": N_("trajectory"),
}


def report_page(reports: Sequence[Mapping[str, Any]], say: Language = ENGLISH, left_out: Sequence[Mapping[str, str]] = ()) -> str:
    """The HTML page. Each robot begins on a new sheet.

    reports : documents of `service.history.report`. left_out : robots of which there is nothing to report, by site, id and why.
    """
    parts: list[str] = []
    for number, one in enumerate(reports):
        parts += _robot(one, say, new_page=number > 0)
    for robot in left_out:
        parts += [heading(f"{robot['site']}/{robot['id']}"), paragraph(say.say(robot["why"]), "warn")]
    first = reports[0]
    subtitle = say.say(
        "{names}. {begin} to {end}; made on {made} by joint-monitor {version}. Times are UTC.",
        names=", ".join(f"{one['robot']['site']}/{one['robot']['id']}" for one in reports),
        begin=full_day(unix_s(first["from"]), say),
        end=full_day(unix_s(first["to"]), say),
        made=moment(unix_s(first["made_at"]), say),
        version=first["version"],
    )
    return page(say.say("Friction health report"), subtitle, parts, say.code)


def _robot(report: Mapping[str, Any], say: Language, *, new_page: bool) -> list[str]:
    """The sections of one robot: what decides first, what it rests on after it."""
    who = report["robot"]
    facts = say.say(
        "Serial number {serial}; {mounting}; payload {payload} kg; tool {tool}; trajectory {trajectory}.",
        serial=who["serial"] or say.say("not given"),
        mounting=say.word(str(who["mounting"])),
        payload=say.figure(who["payload_kg"], 2),
        tool=who["tool"],
        trajectory=who["trajectory"],
    )
    parts = [
        heading(f"{who['site']}/{who['id']}: {who['model'].upper()}", new_page=new_page),
        paragraph(facts, "dim"),
        _verdict(report, say),
    ]
    parts += _stops(report, say)
    boxes = alert_boxes(report, say)
    if boxes:
        parts += [heading(say.say("Alerts, the gravest first"), 3), *boxes]
    if report["verdict"] is not None:
        parts += [heading(say.say("Joints at the end of the period"), 3), _joints(report, say)]
    if report["history"]:
        parts.append(drawn(friction_over_time(report, say), friction_over_time_caption(report, say)))
        if any(alert["condition"] in OF_ONE_JOINTS_FRICTION for alert in report["alerts"]):
            caption = say.say(
                "Viscous friction over joint temperature, wear taken out; the law of all replays so far, ± 2σ; %/K as a straight line."
            )
            parts.append(drawn(friction_over_temperature(report, say), caption))
    parts += [
        *from_production(report, say),
        *maintenance_table(report, say),
        *transitions(report, say),
        *_contexts(report, say),
        *inspection(report, say),
        heading(say.say("What was not monitored, and why"), 3),
    ]
    parts += [*unwatched(report, say), *_small_print(report, say)]
    return parts


def _verdict(report: Mapping[str, Any], say: Language) -> str:
    """The box at the top: the state of the arm at the end of the period, what decides, and what is too old to rely on."""
    verdict, alerts = report["verdict"], alerts_of(report)
    active = [alert for alert in alerts if alert.active]
    state, why = (None, None) if verdict is None else (verdict["health"]["arm"], reason_from(verdict["why"]["arm"]))
    shown = shown_of(state, why, active, stale=bool(report["stale"]))
    decides = shown.alert or (active[0] if active and shown.age is Age.NOW else None)  # a notice decides nothing, and is said
    text = " ".join(lead(decides, report, say)) if decides is not None else _capital(say.say(shown.why))
    lines = [paragraph(Markup(f'{chip(shown.pill, say)} <b class="lead">{escaped(text)}</b>'))]
    if verdict is None:
        nothing = say.say("No replay was assessed in this period: nothing can be said of this arm.")
        return '<div class="box">' + "".join(lines if active else []) + paragraph(nothing, "warn") + "</div>"
    lines += [
        paragraph(
            say.say(
                "As of the last replay of the period, {when}. Active alerts at the end of the period: {count}.",
                when=moment(unix_s(verdict["at"]), say),
                count=len(active),
            ),
            "dim",
        ),
    ]
    return '<div class="box">' + "".join(lines) + _stale(report, say) + "</div>"


def _stale(report: Mapping[str, Any], say: Language) -> str:
    """Which joints have not been assessed for too long; nothing where all have."""
    old = report["stale"]
    if not old:
        return ""
    known = [one["learnt_at"] for one in old if one["learnt_at"]]
    since = SINCE(at_unix_s=unix_s(min(known))) if known else IN_PERIOD
    text = stale_reason([one["joint"] for one in old], len(report["joints"]), since, PERIODS_END)
    advice = say.say("Find out below why, and have the arm replayed before relying on it.")
    return paragraph(f"{say.say(text)}. {advice}", "warn")


def _joints(report: Mapping[str, Any], say: Language) -> str:
    """A table with one row for each joint."""
    states = report["verdict"]["health"]["joints"]
    old = {one["joint"] for one in report["stale"]}
    rows = []
    for row in report["joints"]:
        life = row["remaining_life"]
        out_of_date = f" <b class=warn>{escaped(say.say('OUT OF DATE'))}</b>" if row["joint"] in old else ""
        rows.append(
            [
                say.name(row["joint"]),
                Markup(chip(shown_of(states[row["joint"] - 1], None, stale=row["joint"] in old).pill, say) + out_of_date),
                _pair(say, 100 * row["wear"], 100 * row["wear_std"], 1, signed=True),
                _pair(say, PERCENT_PER_MONTH * row["wear_rate_per_day"], PERCENT_PER_MONTH * row["wear_rate_std_per_day"], 1, signed=True),
                _life(life, say),
                _pair(say, row["coulomb_nm"], row["coulomb_std_nm"], 2),
                _pair(say, row["viscous_nm_s_per_rad"], row["viscous_std_nm_s_per_rad"], 2),
            ]
        )
    columns: list[Column | str] = [
        "",
        say.say("State"),
        Column(say.say("change [%]")),
        Column(say.say("per month [%]")),
        Column(say.say("Time left")),
        Column("fc [N·m]"),
        Column("fv [N·m·s/rad]"),
    ]
    told = [say.say(reason) for reason in (assumptions(report["joints"]), unseen_steps(report["joints"])) if reason is not None]
    ripple = _ripple(report["joints"], say)
    return table(columns, rows) + "".join(paragraph(text, "dim small") for text in [*told, *ripple])


def _ripple(joints: Sequence[Mapping[str, Any]], say: Language) -> list[str]:
    """The gear ripple of each joint that shows any, as one sentence of evidence; nothing where none does."""
    parts = []
    for row in joints:
        of = row.get("ripple") or {"cycles_per_turn": ()}
        seen = [
            f"{cycles}: {1000 * of['track_a'][k]:.0f} ± {1000 * of['track_std_a'][k]:.0f} ({1000 * of['first_a'][k]:.0f})"
            for k, cycles in enumerate(of["cycles_per_turn"])
            if of["track_a"][k] is not None and of["track_a"][k] > 2.0 * of["track_std_a"][k]  # more than its noise
        ]
        if seen:
            parts.append(f"{say.name(row['joint'])} {', '.join(seen)}")
    if not parts:
        return []
    text = say.say(
        "Gear ripple of the current in mA, at cycles a turn of the joint; in brackets the first replays: {joints}.", joints="; ".join(parts)
    )
    return [text]


def _life(life: Mapping[str, Any], say: Language) -> str:
    """Remaining life as a cell: median, P10 and P90 [days]."""
    if life["verdict"] == "reached":
        return say.say("limit reached")
    if life["p50_days"] is None:
        return say.say("no trend")
    low, high = ("…" if life[key] is None else f"{life[key]:.0f}" for key in ("p10_days", "p90_days"))
    return say.say("{middle} days ({early}–{late})", middle=f"{life['p50_days']:.0f}", early=low, late=high)


def _contexts(report: Mapping[str, Any], say: Language) -> list[str]:
    """Changes of arm, mounting, payload, tool and trajectory in the period; nothing where there was none."""
    rows = []
    for change in report["contexts"][1:]:
        what = [
            f"{say.say(CONTEXT_WORDS[name])}: {_fact(name, before, say)} → {_fact(name, after, say)}"
            for name, (before, after) in change["changed"].items()
            if name in CONTEXT_WORDS
        ]
        meaning = say.say("a new baseline") if change["new"] else say.say("known before: its baseline again")
        rows.append([moment(unix_s(change["at"]), say), "; ".join(what), meaning])
    if not rows:
        return []
    title = heading(say.say("What changed on the arm"), 3)
    return [title, table([say.say("When"), say.say("What"), say.say("what it meant")], rows)]


def _fact(name: str, value: Any, say: Language) -> str:
    """One fact of a context, with its unit."""
    if value is None:
        return say.say("not known")
    if name == "payload_kg":
        return f"{say.figure(value, 2)} kg"
    if name == "mounting_rad":
        return " / ".join(f"{np.degrees(angle):.0f}°" for angle in value)
    return str(value)


def _stops(report: Mapping[str, Any], say: Language) -> list[str]:
    """Stops after which a person had to allow motion again; nothing where there was none."""
    if not report["stops"]:
        return []
    rows = []
    for stop in report["stops"]:
        allowed: object = Markup(f'<b class="warn">{escaped(say.say("nobody: nothing moves"))}</b>')
        if stop["allowed_at"] is not None:
            when, why = moment(unix_s(stop["allowed_at"]), say), stop["allowed_why"] or say.say("no reason")
            allowed = f"{stop['allowed_by']}, {when}: {why}"
        what = f"{say.word(stop['cause'])}: {say.at(stop, 'reason')}"
        rows.append([moment(unix_s(stop["at"]), say), what, allowed])
    titles = [say.say("When"), say.say("what ended the replay"), say.say("who allowed motion again, and why")]
    return [heading(say.say("Stops that a person had to look at"), 3), table(titles, rows)]


def _small_print(report: Mapping[str, Any], say: Language) -> list[str]:
    """Thresholds, what the method cannot see, and where a person signs."""
    of = report["thresholds"]
    thresholds = say.say(
        "Notice from {advisory} %, wear from {wear} %, limit from {limit} % more friction than at first, in {replays} replays on {days} "
        "days at least, at most {false_alarms} alerts a year that mean nothing. Time left is until {life} %; the next service is taken to "
        "be in {service} days.",
        advisory=f"{100 * of['advisory_rise']:g}",
        wear=f"{100 * of['wear_rise']:g}",
        limit=f"{100 * of['limit_rise']:g}",
        replays=of["min_replays"],
        days=of["min_days"],
        false_alarms=say.figure(of["false_alarms_per_year"], 1),
        life=f"{100 * of['life_limit_rise']:g}",
        service=f"{of['service_days']:g}",
    )
    by, date = escaped(say.say("Reviewed by")), escaped(say.say("Date, signature"))
    return [
        '<div class="fine">',
        heading(say.say("Thresholds in force when this was made"), 4),
        paragraph(thresholds),
        heading(say.say("What this method cannot see"), 4),
        bullets(say.of(limit) for limit in report["limits"]),
        "</div>",
        Markup(f'<table class="sign"><tbody><tr><td>{by}</td><td>{date}</td></tr></tbody></table>'),
    ]


def _pair(say: Language, value: float | None, std: float | None, digits: int, *, signed: bool = False) -> str | None:
    return None if value is None else f"{say.figure(value, digits, signed=signed)} ± {say.figure(std or 0.0, digits)}"


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"
