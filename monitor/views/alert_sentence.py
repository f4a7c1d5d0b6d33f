"""The sentences that an alert leads with: what has changed, when it gets serious, and what to do by when."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from monitor.judge.alerts.conditions import CONDITIONS
from monitor.publish.timestamps import unix_s
from monitor.recording import DAY_S
from monitor.views.history import MAINTENANCE
from monitor.views.language.catalogue import Language, around, day, since, span, utc

OF_ONE_JOINTS_FRICTION = ("wear_rising", "sudden_step", "friction_falling")
LATEST_DAYS = 3 * 365.25  # a date beyond it would claim too much
NOW_DAYS = 3.0  # an inspection that is due so soon is due now


class JointPast(NamedTuple):
    """What is known of the joint of an alert; None: nobody knows."""

    friction: Mapping[str, Any] | None = None  # its newest document
    began_unix_s: float | None = None  # since when its friction is compared
    learnt_unix_s: float | None = None  # the replay from which its remaining days count


class Sentences(NamedTuple):
    """What a person reads of an alert before anything else."""

    headline: str  # what is the case
    pace: str  # when the limit is met; empty where the condition has no such date
    due: str  # what to do, and by when


def sentences(alert: Mapping[str, Any], past: JointPast, now_unix_s: float, say: Language) -> Sentences:
    """The sentences of one alert, a document as it is published."""
    headline = _headline(alert, past.began_unix_s, now_unix_s, say)
    action = say.at(alert, "action")
    if not alert["active"] or alert["condition"] not in {"wear_rising", "sudden_step"} or not past.friction or alert.get("awaiting_proof"):
        return Sentences(headline, "", action)
    life = past.friction.get("remaining_life") or {}
    learnt = past.learnt_unix_s or now_unix_s
    pace = _pace(life, learnt, now_unix_s, say)
    early = life.get("p10_days")
    if alert["tier"] != "wear" or (early is None and life.get("verdict") != "reached"):
        return Sentences(headline, pace, action)
    by = learnt + (early or 0.0) * DAY_S
    now = by - now_unix_s < NOW_DAYS * DAY_S
    due = say.say("Inspect now.") if now else say.say("Inspect by {day}.", day=day(by, now_unix_s, say))
    return Sentences(headline, pace, due)


def _headline(alert: Mapping[str, Any], began_unix_s: float | None, now_unix_s: float, say: Language) -> str:
    joint, condition, who = alert["joint"], alert["condition"], say.name(alert["joint"])
    if alert.get("awaiting_proof") and alert.get("serviced_at"):
        when, act = unix_s(alert["serviced_at"]), MAINTENANCE.get(alert["serviced_kind"], alert["serviced_kind"])
        return say.say(
            "{joint}: {work} {when}. The next replays show whether it helped.",
            joint=who,
            work=say.say(act),
            when=since(when, now_unix_s, say),
        )
    gravest = alert.get("gravest") if not alert["active"] else None  # a cleared alert says what it was about
    change = float((gravest or alert).get("change") or 0.0)
    lowest_at = (gravest or alert).get("lowest_at")
    if lowest_at is not None:
        began_unix_s = unix_s(lowest_at)
    before = say.say("at the beginning") if began_unix_s is None else since(began_unix_s, now_unix_s, say)
    known = CONDITIONS.get(condition)  # None: of the gateway, or of another release
    headline = None if known is None else known.headline(joint, change, say.percent(abs(change)), before)
    return say.say(headline) if headline is not None else say.at(gravest or alert, "text") or say.word(condition)


def _pace(life: Mapping[str, Any], learnt_unix_s: float, now_unix_s: float, say: Language) -> str:
    """When friction meets its limit, as a sentence."""
    if life.get("verdict") == "reached":
        return say.say("It has met its limit.")
    early, middle, late = life.get("p10_days") or 0.0, life.get("p50_days"), life.get("p90_days")
    if middle is None:
        return say.say("It shows no steady pace, so nobody can say when it meets its limit.")
    begin = learnt_unix_s
    if middle > LATEST_DAYS:
        return say.say("At this pace it does not meet its limit before {year}.", year=utc(begin + max(early, 0.5 * middle) * DAY_S).year)
    when = around(begin + middle * DAY_S, now_unix_s, say)
    end = None if late is None or late > 2 * LATEST_DAYS else begin + late * DAY_S
    between = span(begin + early * DAY_S, end, begin + middle * DAY_S, now_unix_s, say)
    if not between:
        return say.say("At this pace it meets its limit {when}.", when=when)
    return say.say("At this pace it meets its limit {when} ({between}).", when=when, between=between)
