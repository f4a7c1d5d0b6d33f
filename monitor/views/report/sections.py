"""Sections of the report: what was not monitored, work on joints, inspection duties, and what came from ordinary work."""

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from monitor.judge.inspection import MUST_BE_MADE
from monitor.publish.timestamps import unix_s
from monitor.reason import reason_at
from monitor.recording import DAY_S
from monitor.views.history import MAINTENANCE, cause
from monitor.views.language.catalogue import Language, day, full_day, moment, utc
from monitor.views.report.html import Column, Markup, bullets, escaped, heading, paragraph, table

GRAVITY = ("aborted", "rejected", "skipped")  # how a window ended, the gravest first
CAUSES = 10  # lines of the table; rarer causes are counted together
GAPS = 5  # longest gaps that are listed
WARNINGS = 6  # most frequent warnings that are listed


class Group(NamedTuple):
    """Windows of the period that ended alike."""

    state: str
    cause: str
    windows: Sequence[Mapping[str, Any]]


def groups(failed: Sequence[Mapping[str, Any]]) -> list[Group]:
    """The windows by how they ended and why: the gravest first, of equally grave ones the most frequent."""
    found: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in failed:
        found.setdefault((row["state"], cause(reason_at(row, "reason"))), []).append(row)
    listed = [Group(state, why, rows) for (state, why), rows in found.items()]
    order = {state: k for k, state in enumerate(GRAVITY)}
    return sorted(listed, key=lambda group: (order.get(group.state, len(GRAVITY)), -len(group.windows)))


def unwatched(report: Mapping[str, Any], say: Language) -> list[str]:
    """Windows without an assessment, gaps between replays, joints without information, and warnings."""
    of, parts = report["unwatched"], []
    if not of["windows"]:
        parts.append(paragraph(say.say("No window was attempted: the monitor did not run, or its schedule had none."), "warn"))
    else:
        text = say.say("{assessed} of {windows} windows were assessed; {failed} taught nothing.", failed=len(of["failed"]), **_counts(of))
        parts.append(paragraph(text))
    if of["failed"]:
        parts.append(_table(groups(of["failed"]), say))
    items = _gaps(of["gaps"], say)
    items += [
        say.say(
            "{joint}: {replays} of {of} replays said nothing of its friction.",
            joint=say.name(row["joint"]),
            replays=row["replays"],
            of=row["of"],
        )
        for row in of["joints"]
    ]
    warnings = sorted(report["warnings"], key=lambda warning: -warning["count"])
    items += [
        say.say("In {count} of the replays, e.g.: {text}", count=one["count"], text=say.document(one)["text"])
        for one in warnings[:WARNINGS]
    ]
    if len(warnings) > WARNINGS:
        items.append(say.say("{count} rarer warnings are left out.", count=len(warnings) - WARNINGS))
    return [*parts, bullets(items)] if items else parts


def _counts(of: Mapping[str, Any]) -> dict[str, int]:
    return {"assessed": of["assessed"], "windows": of["windows"]}


def _table(found: Sequence[Group], say: Language) -> str:
    rows = []
    for group in found[:CAUSES]:
        times = [unix_s(row["window"]) for row in group.windows]
        first, last = day(times[0], times[-1], say), day(times[-1], times[-1], say)
        when = moment(times[0], say) if len(times) == 1 else first if first == last else f"{first} – {last}"
        rows.append([f"{len(times)} ×", say.word(group.state), when, say.at(group.windows[-1], "reason")])
    rest = found[CAUSES:]
    if rest:
        count = sum(len(group.windows) for group in rest)
        rows.append([f"{count} ×", "", "", say.say("{count} rarer causes", count=len(rest))])
    return table([Column(""), say.say("How it ended"), say.say("When"), say.say("Why, of the last one")], rows)


def _gaps(gaps: Sequence[Mapping[str, Any]], say: Language) -> list[str]:
    """The longest gaps in order of time, and how many shorter ones there were."""
    longest = sorted(gaps, key=lambda gap: unix_s(gap["from"]) - unix_s(gap["to"]))[:GAPS]
    items = [
        say.say(
            "No replay was learned from between {begin} and {end}.",
            begin=moment(unix_s(gap["from"]), say),
            end=moment(unix_s(gap["to"]), say),
        )
        for gap in sorted(longest, key=lambda gap: str(gap["from"]))
    ]
    if len(gaps) > GAPS:
        items.append(say.say("{count} shorter gaps are left out.", count=len(gaps) - GAPS))
    return items


# --- Work on joints in the report: a table, and a line on the day of each in the charts -----------------

SHOWN_AFTER_S = 31 * DAY_S  # work so long after the last replay still has its line


def maintenance_table(report: Mapping[str, Any], say: Language) -> list[str]:
    """What was done to joints, what the replays after it have shown, and who took it back; nothing where there was none."""
    if not report.get("maintenance"):
        return []
    rows = []
    for act in report["maintenance"]:
        meant = say.at(act, "meaning")
        if act["undone_at"]:
            meant = say.say("Taken back by {who}, {when}.", who=act["undone_by"], when=moment(unix_s(act["undone_at"]), say))
        by = ": ".join(filter(None, (act["by"], act["why"])))
        rows.append([moment(unix_s(act["at"]), say), say.name(act["joint"]), say.say(MAINTENANCE.get(act["kind"], act["kind"])), by, meant])
    titles = [say.say("When"), "", say.say("What"), say.say("by whom and why"), say.say("what it meant")]
    return [heading(say.say("Work on joints"), 3), table(titles, rows)]


def draw_maintenance(one: Any, report: Mapping[str, Any], joint: int, last: datetime, say: Language) -> None:
    """Draw a line on each day on which something was done to the joint, with the kind of work. What was taken back is left out."""
    for act in report.get("maintenance", ()):
        when = utc(unix_s(act["at"])).replace(tzinfo=None)
        if act["joint"] != joint or act["undone_at"] or when > last + timedelta(seconds=SHOWN_AFTER_S):
            continue
        one.axvline(when, color="#333333", lw=0.8, ls=":")
        beside = {"xycoords": ("data", "axes fraction"), "xytext": (2, -2), "textcoords": "offset points"}
        one.annotate(say.say(MAINTENANCE.get(act["kind"], act["kind"])), (when, 1.0), fontsize="x-small", va="top", **beside)


# --- Inspection duties in the report: operating hours, stops of the safety system, and checks with their due dates ---

N_ = str  # marks a text for the catalogue
STATES = {"unrecorded": N_("due, never recorded"), "done": N_("not due yet"), "soon": N_("due soon"), "due": N_("due")}


def inspection(report: Mapping[str, Any], say: Language) -> list[str]:
    """The section; nothing where [inspection] asks for nothing."""
    found = report.get("inspection")
    if not found:
        return []
    parts = [heading(say.say("Inspection duties"), 3)]
    if found["counted_since"] is None:
        parts.append(paragraph(say.say("The arm was not heard yet: no hours are counted.")))
    else:
        hours = say.say(
            "Operating hours: {operating} h. Since {since} the arm was heard for {heard} h, on for {on} h and in motion for {moving} h. "
            "Its safety system stopped it {stops} times, {period} times in this period.",
            operating=say.figure(found["operating_h"], 1),
            since=full_day(unix_s(found["counted_since"]), say),
            heard=say.figure(found["heard_h"], 1),
            on=say.figure(found["on_h"], 1),
            moving=say.figure(found["moving_h"], 1),
            stops=found["stops"],
            period=found["stops_period"],
        )
        parts.append(paragraph(hours))
    if found["last_stops"]:
        rows = [[moment(unix_s(stop["at"]), say), *_stop(stop, say)] for stop in found["last_stops"]]
        parts.append(table([say.say("When"), say.say("What"), say.say("Joint"), say.say("Code of the controller")], rows))
    if found["items"]:
        titles = [say.say(title) for title in (N_("Check"), N_("State"), N_("Due on"), N_("Last done"), N_("By"), N_("Stops since"))]
        parts.append(table(titles, [_item(item, say) for item in found["items"]]))
    if found["plan"]:
        told = say.say("The checks are those of {source}; their intervals are the shortest that it names, unless the file says others.",
                       source=found["plan"])  # fmt: skip
        parts.append(paragraph(told, "dim small"))
    return parts


def _stop(stop: Mapping[str, Any], say: Language) -> list[str]:
    kind = say.word(stop["kind"])
    during = f" ({say.say('during a replay')})" if stop["during_replay"] else ""
    return [f"{kind}{during}", "–" if stop["joint"] is None else say.name(stop["joint"]), stop["code"] or "–"]


def _item(item: Mapping[str, Any], say: Language) -> list[object]:
    name, is_in = item["name"], STATES[item["state"]]
    state: object = say.say(is_in)
    if item["state"] in MUST_BE_MADE:
        state = Markup(f'<b class="warn">{escaped(str(state))}</b>')
    due = "–" if item["due"] is None else full_day(unix_s(item["due"]), say)
    if item["hours_left"] is not None:
        due += f" ({say.say('{hours} h left', hours=say.figure(item['hours_left'], 0))})"
    last = "–" if item["last_done"] is None else full_day(unix_s(item["last_done"]), say)
    return [say.say(name), state, due, last, item["last_by"] or "–", str(item["stops_since"])]


# --- Ordinary work in the report: what came from work and what from replays, for each joint -------------

SECONDS_AN_HOUR = 3600.0


def from_production(report: Mapping[str, Any], say: Language) -> list[str]:
    """Observations of each joint by replays and by work, and what the newest period of work tells; nothing where work is not judged."""
    found = report.get("from_production")
    if not found:
        return []
    rows = []
    for joint in found["joints"]:
        share = "–" if joint["share"] is None else say.figure(joint["share"], 2)
        learnt = moment(unix_s(joint["learnt_at"]), say) if joint["learnt_at"] else "–"
        rows.append([say.name(joint["joint"]), str(joint["learnt_from_replays"]), str(joint["learnt_from_production"]), learnt, share])
    titles = ["", say.say("Replays"), say.say("Periods of work"), say.say("Last learnt from work"), say.say("Information held/needed")]
    hours = say.figure(found["seen_s"] / SECONDS_AN_HOUR, 1)
    days = moment(unix_s(found["period_ended_at"]), say)
    told = say.say(
        "Work was listened to for {hours} h until {when}. A joint that holds 1 or more is known from it.", when=days, hours=hours
    )
    return [heading(say.say("What came from ordinary work"), 3), paragraph(told), table(titles, rows)]
