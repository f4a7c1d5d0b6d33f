"""Dates in words: the day, and the part of a month where a day would claim too much."""

from datetime import UTC, datetime

from monitor.recording import DAY_S
from monitor.views.language.catalogue import Language

# N_ marks a text for the catalogue
N_ = str
MONTHS = (
    N_("January"), N_("February"), N_("March"), N_("April"), N_("May"), N_("June"), N_("July"), N_("August"), N_("September"),
    N_("October"), N_("November"), N_("December"),
)  # fmt: skip
SOON_DAYS = 60.0  # a date that is nearer is given as a day
EARLY, MIDDLE = 10, 20  # the last days of the early and of the middle part of a month


def utc(unix_s: float) -> datetime:
    """The time in UTC."""
    return datetime.fromtimestamp(unix_s, UTC)


def day(unix_s: float, now_unix_s: float, say: Language) -> str:
    """A day, e.g. 7 June; with its year, unless that is the present one."""
    at = utc(unix_s)
    if at.year == utc(now_unix_s).year:
        return say.say("{day} {month}", day=at.day, month=say.say(MONTHS[at.month - 1]))
    return full_day(unix_s, say)


def full_day(unix_s: float, say: Language) -> str:
    """A day with its year, e.g. 7 June 2026."""
    at = utc(unix_s)
    return say.say("{day} {month} {year}", day=at.day, month=say.say(MONTHS[at.month - 1]), year=at.year)


def moment(unix_s: float, say: Language) -> str:
    """A day with its year and the time of day."""
    return f"{full_day(unix_s, say)}, {utc(unix_s):%H:%M}"


def month(unix_s: float, now_unix_s: float, say: Language) -> str:
    """A month, e.g. May; with its year, unless that is the present one."""
    at = utc(unix_s)
    name = say.say(MONTHS[at.month - 1])
    return name if at.year == utc(now_unix_s).year else f"{name} {at.year}"


def around(unix_s: float, now_unix_s: float, say: Language) -> str:
    """About when: a day where it is near, else the part of a month."""
    if abs(unix_s - now_unix_s) < SOON_DAYS * DAY_S:
        return say.say("around {day}", day=day(unix_s, now_unix_s, say))
    of, name = utc(unix_s).day, month(unix_s, now_unix_s, say)
    if of <= EARLY:
        return say.say("in early {month}", month=name)
    return say.say("in mid-{month}", month=name) if of <= MIDDLE else say.say("in late {month}", month=name)


def span(from_unix_s: float, to_unix_s: float | None, about_unix_s: float, now_unix_s: float, say: Language) -> str:
    """From when to when: days where they are near, else months; without an end it is open. Empty where both are the same month.

    about_unix_s : the date beside which it stands; a year is given where it is another one.
    """
    near = from_unix_s - now_unix_s < SOON_DAYS * DAY_S
    first = (day if near else month)(from_unix_s, about_unix_s, say)
    if to_unix_s is None:
        return say.say("{first} or later", first=first)
    last = (day if near and to_unix_s - now_unix_s < SOON_DAYS * DAY_S else month)(to_unix_s, about_unix_s, say)
    return "" if first == last else say.say("{first} to {last}", first=first, last=last)


def since(unix_s: float, now_unix_s: float, say: Language) -> str:
    """With what a change is compared: a day where it is near, else a month."""
    if now_unix_s - unix_s < SOON_DAYS * DAY_S:
        return say.say("on {day}", day=day(unix_s, now_unix_s, say))
    return say.say("in {month}", month=month(unix_s, now_unix_s, say))
