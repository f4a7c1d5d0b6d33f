"""Ordinary work in the report: what came from work and what from replays, for each joint."""

from collections.abc import Mapping
from typing import Any

from monitor.publish.timestamps import unix_s
from monitor.views.language.catalogue import Language
from monitor.views.language.dates import moment
from monitor.views.report.html import heading, paragraph, table

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
