"""Inspection duties in the report: operating hours, stops of the safety system, and checks with their due dates."""

from collections.abc import Mapping
from typing import Any

from monitor.judge.inspection import MUST_BE_MADE
from monitor.publish.timestamps import unix_s
from monitor.views.language.catalogue import Language
from monitor.views.language.dates import full_day, moment
from monitor.views.report.html import Markup, escaped, heading, paragraph, table

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
