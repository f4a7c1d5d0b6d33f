"""What was not monitored, grouped by cause: a month of the same refusal is one line."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from monitor.publish.timestamps import unix_s
from monitor.reason import reason_at
from monitor.views.language.catalogue import Language
from monitor.views.language.dates import day, moment
from monitor.views.report.html import Column, bullets, paragraph, table
from monitor.views.windows import cause

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
