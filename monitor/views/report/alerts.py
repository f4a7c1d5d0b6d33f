"""The alerts of a report, the gravest first: the sentence that decides, then its evidence, then what people did about it."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from monitor.judge.alerts.conditions import CONDITIONS
from monitor.publish.documents import Alert, Friction, mended_alerts, readable
from monitor.publish.shown import TIER_WORDS, Pill, alert_pill, gravest_first
from monitor.publish.timestamps import unix_s
from monitor.views.alert_sentence import JointPast, sentences
from monitor.views.history import mark_text
from monitor.views.language.catalogue import Language, moment
from monitor.views.report.charts import STATE_COLOURS
from monitor.views.report.html import Markup, escaped, heading, paragraph, table

SHOWN = 24  # transitions in the table; updates of an alert are counted only


def chip(pill: Pill, say: Language) -> Markup:
    """A state as a word in its colour."""
    return Markup(f'<span class="chip" style="color:{STATE_COLOURS.get(pill.value or "", "#555")}">{escaped(say.say(pill.word))}</span>')


def lead(alert: Alert, report: Mapping[str, Any], say: Language) -> list[str]:
    """The sentences that an alert leads with, as of the end of the period."""
    rows = [row for row in report["joints"] if row["joint"] == alert.joint]
    replays = [row["recorded_at"] for row in report["history"]] or [report["from"]]
    began = report.get("began_at") or replays[0]
    friction, _ = readable(Friction, rows)
    past = JointPast(friction[0] if friction else None, unix_s(began), unix_s(replays[-1]))
    told = sentences(alert, past, min(unix_s(report["to"]), unix_s(report["made_at"])), say)
    return [sentence for sentence in told if sentence]


def alerts_of(report: Mapping[str, Any]) -> list[Alert]:
    """The alerts of the period, the gravest first."""
    return gravest_first(mended_alerts(report["alerts"]))


def alert_boxes(report: Mapping[str, Any], say: Language) -> list[str]:
    """A box for each alert of the period."""
    boxes = ['<div class="box">' + "".join(_lines(alert, report, say)) + "</div>" for alert in alerts_of(report)]
    lost = len(report["alerts"]) - len(boxes)
    return [*boxes, paragraph(say.say("{count} alerts cannot be read.", count=lost), "warn")] if lost else boxes


def _lines(alert: Alert, report: Mapping[str, Any], say: Language) -> list[str]:
    headline, *others = lead(alert, report, say)
    state = say.say("active") if alert.cleared_at is None else say.say("cleared {when}", when=_moment(alert.cleared_at, say))
    kind = f"{say.name(alert.joint)}: {_name(alert.condition, say)}{_tier(alert.tier, say)}, {state}"
    raised = say.say("raised {when}", when=_moment(alert.raised_at, say))
    lead_text = Markup(f'{chip(alert_pill(alert), say)} <b class="lead">{escaped(headline)}</b>')
    lines = [paragraph(f"{kind}; {raised}", "dim small"), paragraph(lead_text)]
    if alert.active:
        lines.append(paragraph(" ".join(others)))
        action = say.at(alert, "action")
        if action not in others:
            lines.append(paragraph(action))
    gravest = alert.gravest
    if gravest is not None and gravest.text != alert.text:
        when = _moment(gravest.at, say)
        lines.append(paragraph(say.say("At its gravest, {when}: {text}", when=when, text=say.at(gravest, "text")), "small"))
    lines += [paragraph(say.at(alert, "text"), "small"), _probability(alert, say)]
    if alert.cleared_why:
        lines.append(paragraph(say.say("Cleared: {why}.", why=say.at(alert, "cleared_why"))))
    if alert.acknowledged_at is not None:
        seen = say.say("Acknowledged by {who}, {when}", who=alert.acknowledged_by, when=_moment(alert.acknowledged_at, say))
        lines.append(paragraph(_because(seen, alert.acknowledged_why)))
    elif alert.active:
        lines.append(paragraph(say.say("Not acknowledged."), "warn"))
    if alert.shelved_until is not None:
        shelved = say.say("Shelved by {who} until {when}", who=alert.shelved_by, when=_moment(alert.shelved_until, say))
        lines.append(paragraph(_because(shelved, alert.shelved_why)))
    return lines


def _moment(at: datetime, say: Language) -> str:
    return moment(at.timestamp(), say)


def _probability(alert: Alert, say: Language) -> str:
    """The probability of the change that the condition is about; nothing for a condition of the data, which has none."""
    condition = CONDITIONS.get(alert.condition)
    if condition is None or condition.change_probable is None:
        return ""
    chance = alert.probability  # no evidence makes it 100 %
    figure = say.say("more than {percent} %", percent=say.figure(99.99, 2)) if chance > 0.9999 else say.percent(chance, 2)
    what = say.say(condition.change_probable)
    return paragraph(say.say("Probability that friction {what}: {chance}.", what=what, chance=figure), "small")


def transitions(report: Mapping[str, Any], say: Language) -> list[str]:
    """What happened to alerts, and what people did, as a table; updates are counted only."""
    told = [event for event in report["events"] if event["kind"] != "updated"]
    if not told:
        return []
    rows = [
        [
            moment(unix_s(event["at"]), say),
            say.name(event["joint"]),
            say.say(work) if (work := mark_text(event)) else _name(event.get("condition") or event["kind"], say),
            say.word(event["kind"]) + _tier(event.get("tier"), say),
            _by(event),
        ]
        for event in told[-SHOWN:]
    ]
    left = len(report["events"]) - len(rows)
    titles = [say.say("When"), "", say.say("Alert"), say.say("What"), say.say("by whom and why")]
    parts = [heading(say.say("What happened"), 3), table(titles, rows)]
    return [*parts, paragraph(say.say("{count} updates and older transitions are left out.", count=left), "dim small")] if left else parts


def _by(event: Mapping[str, Any]) -> str | None:
    """Who did it, and why; None where nobody did."""
    names = ("by", "acknowledged_by") if event["kind"] != "shelved" else ("by", "shelved_by")
    who = next((event[name] for name in names if event.get(name)), None)
    if who is None or event["kind"] in {"raised", "cleared"}:
        return None
    return _because(who, event.get(names[1].replace("_by", "_why")) or event.get("why"))


def _tier(tier: str | None, say: Language) -> str:
    words = TIER_WORDS.get(tier or "")
    return f", {say.say(words)}" if words else ""


def _because(text: str, why: str | None) -> str:
    return f"{text}: {why}" if why else text


def _name(condition: str, say: Language) -> str:
    text = say.word(condition)
    return text[:1].upper() + text[1:]
