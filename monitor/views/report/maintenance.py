"""Work on joints in the report: a table, and a line on the day of each in the charts."""

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

from monitor.publish.timestamps import unix_s
from monitor.recording import DAY_S
from monitor.views.language.catalogue import Language
from monitor.views.language.dates import moment, utc
from monitor.views.marks import PRODUCTION
from monitor.views.report.html import heading, table

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
        rows.append([moment(unix_s(act["at"]), say), say.name(act["joint"]), say.say(PRODUCTION.get(act["kind"], act["kind"])), by, meant])
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
        one.annotate(say.say(PRODUCTION.get(act["kind"], act["kind"])), (when, 1.0), fontsize="x-small", va="top", **beside)
