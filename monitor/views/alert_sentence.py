"""The sentences that an alert leads with: what has changed, when it gets serious, and what to do by when."""

from typing import NamedTuple

from monitor.judge.alerts.conditions import CONDITIONS, RISES
from monitor.publish.documents import Alert, Friction, Gravest, RemainingLife
from monitor.publish.shown import Shown
from monitor.recording import DAY_S
from monitor.views.history import MAINTENANCE
from monitor.views.language.catalogue import ENGLISH, Language, around, day, since, span, utc

OF_ONE_JOINTS_FRICTION = ("wear_rising", "sudden_step", "friction_falling")
LATEST_DAYS = 3 * 365.25  # a date beyond it would claim too much
NOW_DAYS = 3.0  # an inspection that is due so soon is due now


class JointPast(NamedTuple):
    """What is known of the joint of an alert; None: nobody knows."""

    friction: Friction | None = None  # its newest document
    began_unix_s: float | None = None  # since when its friction is compared
    learnt_unix_s: float | None = None  # the replay from which its remaining days count


class Sentences(NamedTuple):
    """What a person reads of an alert before anything else."""

    headline: str  # what is the case
    pace: str  # when the limit is met; empty where the condition has no such date
    due: str  # what to do, and by when


def deciding(shown: Shown, now_unix_s: float, say: Language = ENGLISH, began_unix_s: float | None = None) -> str:
    """The sentence that decides how an arm is shown. began_unix_s : since when friction of the alert's joint is compared."""
    return say.say(shown.why) if shown.alert is None else _headline(shown.alert, began_unix_s, now_unix_s, say)


def sentences(alert: Alert, past: JointPast, now_unix_s: float, say: Language = ENGLISH) -> Sentences:
    """The sentences of one alert."""
    headline, action = _headline(alert, past.began_unix_s, now_unix_s, say), say.at(alert, "action")
    if not alert.active or alert.condition not in RISES or past.friction is None or alert.awaiting_proof:
        return Sentences(headline, "", action)
    life, learnt = past.friction.remaining_life, past.learnt_unix_s or now_unix_s
    pace = _pace(life, learnt, now_unix_s, say)
    if alert.tier != "wear" or (life.p10_days is None and life.verdict != "reached"):
        return Sentences(headline, pace, action)
    by = learnt + (life.p10_days or 0.0) * DAY_S
    now = by - now_unix_s < NOW_DAYS * DAY_S
    due = say.say("Inspect now.") if now else say.say("Inspect by {day}.", day=day(by, now_unix_s, say))
    return Sentences(headline, pace, due)


def _headline(alert: Alert, began_unix_s: float | None, now_unix_s: float, say: Language) -> str:
    who = say.name(alert.joint)
    if alert.awaiting_proof and alert.serviced_at is not None:
        act = MAINTENANCE.get(alert.serviced_kind or "", alert.serviced_kind or "")
        return say.say(
            "{joint}: {work} {when}. The next replays show whether it helped.",
            joint=who,
            work=say.say(act),
            when=since(alert.serviced_at.timestamp(), now_unix_s, say),
        )
    of: Alert | Gravest = alert if alert.active or alert.gravest is None else alert.gravest  # a cleared one says what it was about
    if of.lowest_at is not None:
        began_unix_s = of.lowest_at.timestamp()
    before = say.say("at the beginning") if began_unix_s is None else since(began_unix_s, now_unix_s, say)
    known = CONDITIONS.get(alert.condition)  # None: of the gateway, or of another release
    headline = None if known is None else known.headline(alert.joint, of.change, say.percent(abs(of.change)), before)
    return say.say(headline) if headline is not None else say.at(of, "text") or say.word(alert.condition)


def _pace(life: RemainingLife, learnt_unix_s: float, now_unix_s: float, say: Language) -> str:
    """When friction meets its limit, as a sentence."""
    if life.verdict == "reached":
        return say.say("It has met its limit.")
    early, middle, late = life.p10_days or 0.0, life.p50_days, life.p90_days
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
