"""The report of a plant: all arms, the worst first, and what has happened in a period; one page that can be printed. No I/O, no clock."""

from collections.abc import Sequence
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

from monitor import __version__
from monitor.gateway.notify.texts import KINDS, TIERS, headline, local
from monitor.gateway.values import ArmState, Transition, gravity
from monitor.views.language.catalogue import Language, full_day, moment
from monitor.views.report.html import Markup, escaped, heading, page, paragraph, table

SICK = ("FAILURE", "MAINTENANCE_REQUIRED")
ORDER = (*SICK, "OFF_SPEC", "CHECK_FUNCTION", None, "NORMAL")
LISTED = 20  # arms and changes in the text of the mail; the page has all
ROWS = 2000  # changes on the page


class PlantPage(NamedTuple):
    """The page, and what the mail says in its text."""

    html: str
    lines: list[str]
    sick: int


def plant_page(
    arms: Sequence[ArmState],
    changes: Sequence[Transition],
    begin_unix_s: float,
    end_unix_s: float,
    at_unix_s: float,
    say: Language,
    zone: ZoneInfo,
    link: str = "",
) -> PlantPage:
    """The report of these arms. changes : transitions of the period, the oldest first."""
    ordered = sorted(arms, key=_rank)
    sick = [arm for arm in ordered if arm.health.get("state") in SICK]
    subtitle = say.say(
        "{begin} to {end}; made on {made} by joint-monitor {version}. Times are {zone}.",
        begin=full_day(begin_unix_s, say),
        end=full_day(end_unix_s, say),
        made=moment(at_unix_s, say),
        version=__version__,
        zone=str(zone),
    )
    told = [each for each in changes if each.changes_tier]
    parts = [paragraph(_counts(arms, say), "lead"), heading(say.say("Arms, the worst first"))]
    columns = [say.say(title) for title in ("Arm", "State", "Since", "Active alerts", "Heard")]
    parts.append(table(columns, [_row(arm, say, zone, link) for arm in ordered]))
    parts.append(heading(say.say("What has changed")))
    if told:
        columns = [say.say(title) for title in ("When", "Arm", "What", "Tier", "Change")]
        parts.append(table(columns, [_change(each, say, zone) for each in told[-ROWS:]]))
    else:
        parts.append(paragraph(say.say("Nothing: no alert was raised, changed or cleared.")))
    lines = [_counts(arms, say)]
    shown = [f"  {arm.name}: {say.at(arm.health, 'why')}" for arm in sick[:LISTED]]
    lines += ["\n".join(shown)] if shown else []
    lines.append(say.say("{count} changes of alerts.", count=len(told)))
    return PlantPage(page(say.say("Report of the plant"), subtitle, parts, say.code), lines, len(sick))


def _rank(arm: ArmState) -> tuple[int, int, str]:
    state = arm.health.get("state")
    return ORDER.index(state) if state in ORDER else len(ORDER), -len(arm.alerts), str(arm.name)


def _counts(arms: Sequence[ArmState], say: Language) -> str:
    sick = sum(arm.health.get("state") in SICK for arm in arms)
    silent = sum(arm.silent_since_unix_s is not None for arm in arms)
    waiting = sum(not alert.get("acknowledged_at") for arm in arms for alert in arm.alerts)
    return say.say(
        "{arms} arms: {sick} need somebody, {silent} are silent; {waiting} alerts wait for a person.",
        arms=len(arms),
        sick=sick,
        silent=silent,
        waiting=waiting,
    )


def _row(arm: ArmState, say: Language, zone: ZoneInfo, link: str) -> list[object]:
    state = arm.health.get("state")
    kind = "bad" if state in SICK else "good" if state == "NORMAL" else "warn"
    alerts = "".join(
        f"<div>{escaped(_alert(alert, say))}</div>" for alert in sorted(arm.alerts, key=lambda each: -gravity(str(each.get("tier"))))
    )
    name = escaped(arm.name)
    if arm.silent_since_unix_s is not None:
        heard = say.say("silent since {at}", at=local(arm.silent_since_unix_s, zone))
    else:
        heard = local(max(arm.heard_at_unix_s.values()), zone) if arm.heard_at_unix_s else "–"
    return [
        Markup(f'<a href="{escaped(link)}/arms/{name}/">{name}</a>') if link else str(arm.name),
        Markup(f'<span class="chip {kind}">{escaped(say.word(str(state)) if state else "–")}</span>'),
        str(arm.health.get("since") or "–")[:10],
        Markup(alerts or "–"),
        heard,
    ]


def _alert(alert: Any, say: Language) -> str:
    tier = say.say(TIERS.get(str(alert.get("tier")), str(alert.get("tier"))))
    seen = "" if alert.get("acknowledged_at") else f" ({say.say('waits for a person')})"
    return f"{tier}: {say.at(alert, 'text') or say.word(str(alert.get('condition')))}{seen}"


def _change(each: Transition, say: Language, zone: ZoneInfo) -> list[object]:
    what = {
        "at_unix_s": each.at_unix_s,
        **{"after": each.after, "event": each.document, "text": each.text, "condition": each.condition},
    }
    return [
        local(each.at_unix_s, zone),
        str(each.arm),
        headline(what, say),
        say.say(TIERS.get(each.tier, each.tier)),
        say.say(KINDS.get(each.kind, each.kind)),
    ]
