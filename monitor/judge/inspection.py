"""Inspection duties of an arm: which checks there are, and when each is due, by date and by operating hours.

A check whose last time nobody has recorded is due: an empty record is no proof of an inspection.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from annotated_types import Interval

from monitor.errors import BadInput
from monitor.recording import DAY_S

State = Literal["unrecorded", "done", "soon", "due"]
MUST_BE_MADE: tuple[State, ...] = ("due", "unrecorded")  # states of a check that somebody must make now
MONTH_DAYS = 30.0
LONGEST_DAYS, LONGEST_HOURS = 36_500.0, 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class InspectionItem:
    """One check that comes again and again."""

    name: str  # as `joint-monitor inspected NAME` takes it
    every_days: Annotated[float, Interval(ge=0.0, le=LONGEST_DAYS)] = 0.0  # [d] between two; 0: not by date
    every_hours: Annotated[float, Interval(ge=0.0, le=LONGEST_HOURS)] = 0.0  # [h] that the arm is on between two; 0: not by hours
    last_done: str = ""  # a date, e.g. "2026-01-31", of the last time before it is recorded with the monitor
    after_collision: bool = False  # the manufacturer asks for it after a heavy collision as well


class Plan(NamedTuple):
    """The checks that a manufacturer recommends, and where that is published."""

    source: str
    items: tuple[InspectionItem, ...]


def _check(name: str, *, after_collision: bool = False) -> InspectionItem:
    return InspectionItem(name=name, every_days=MONTH_DAYS, after_collision=after_collision)


# The manual has three timeframes (monthly, biannually, annually), one a check; the shortest of them stands here for all, so that no
# check comes late. Who reads another timeframe in the manual of their arm writes it down: an item of the same name replaces it.
PLANS = {
    "universal-robots": Plan(
        "Universal Robots, Service Manual e-Series (2024), 3.1.1 Inspection Plan, Robot Arm",
        (
            _check("blue lids", after_collision=True),
            _check("blue lid screws"),
            _check("flat rings"),
            _check("robot cable"),
            _check("robot cable connection"),
            _check("robot arm mounting bolts", after_collision=True),
            _check("tool mounting bolts", after_collision=True),
            _check("screws and bolts on joints", after_collision=True),
        ),
    )
}


@dataclass(frozen=True, slots=True, kw_only=True)
class InspectionSettings:
    """Whether operating hours and protective stops are counted, and which checks the arm needs."""

    count: bool = False  # count operating hours and protective stops; a plan or an item counts them too
    plan: str = ""  # the manufacturer's checks: "universal-robots"; empty: none
    notice_days: Annotated[float, Interval(ge=0.0, le=365.0)] = 14.0  # [d] so long before it is due a check is called soon
    hours_before: Annotated[float, Interval(ge=0.0, le=LONGEST_HOURS)] = 0.0  # [h] that the arm was on before the monitor counted
    items: tuple[InspectionItem, ...] = ()  # checks beside those of the plan, or in their place where the name is the same

    def __post_init__(self) -> None:
        """Raises BadInput for an unknown plan, a name that comes twice or is empty, and a new check without an interval."""
        if self.plan and self.plan not in PLANS:
            raise BadInput(f"inspection: plan = {self.plan!r}; expected {', '.join(repr(name) for name in PLANS)}, or empty")
        names = [item.name for item in self.items]
        known = {item.name for item in PLANS[self.plan].items} if self.plan else set()
        for item in self.items:
            if not item.name.strip() or item.name != item.name.strip() or len(item.name) > 100:
                raise BadInput(f"inspection: items: name = {item.name!r}; expected 1 to 100 letters")
            if names.count(item.name) > 1:
                raise BadInput(f"inspection: items: {item.name!r} comes twice; expected each name once")
            if not item.every_days and not item.every_hours and item.name not in known:
                raise BadInput(f"inspection: items: {item.name!r} has no interval; expected every_days or every_hours")

    @property
    def wanted(self) -> bool:
        """Whether anything is counted and shown."""
        return bool(self.count or self.plan or self.items)

    @property
    def checks(self) -> tuple[InspectionItem, ...]:
        """The plan's checks, those that an item of the same name replaces by it, and then the others."""
        own = {item.name: item for item in self.items}
        planned = PLANS[self.plan].items if self.plan else ()
        names = {item.name for item in planned}
        merged = [_replaced(item, own.get(item.name)) for item in planned]
        return (*merged, *(item for item in self.items if item.name not in names))


def _replaced(planned: InspectionItem, own: InspectionItem | None) -> InspectionItem:
    """A planned check with what the file says of it; without an interval of its own it keeps the plan's."""
    if own is None:
        return planned
    kept = not own.every_days and not own.every_hours
    return InspectionItem(
        name=own.name,
        every_days=planned.every_days if kept else own.every_days,
        every_hours=planned.every_hours if kept else own.every_hours,
        last_done=own.last_done,
        after_collision=planned.after_collision or own.after_collision,
    )


class Done(NamedTuple):
    """When a check was made, and the operating hours of then; None where they are not known."""

    at_unix_s: float
    hours: float | None = None


class Due(NamedTuple):
    """When a check is due."""

    state: State
    at_unix_s: float | None  # by date or by hours, whichever comes first; None: nobody knows
    days_left: float | None  # negative: overdue
    hours_left: float | None  # [h] that the arm may still be on; None: not by hours, or not known


def due(item: InspectionItem, done: Done | None, now_unix_s: float, hours: float, hours_a_day: float, notice_days: float) -> Due:
    """When a check is due. hours : operating hours now; hours_a_day : their usual pace, for the date at which hours run out."""
    if done is None:
        return Due("unrecorded", None, None, None)
    times: list[float] = []
    left: float | None = None
    if item.every_days:
        times.append(done.at_unix_s + DAY_S * item.every_days)
    if item.every_hours and done.hours is not None:
        left = item.every_hours - (hours - done.hours)
        if left <= 0.0:
            times.append(now_unix_s + DAY_S * min(left / hours_a_day, 0.0) if hours_a_day > 0.0 else now_unix_s)
        elif hours_a_day > 0.0:
            times.append(now_unix_s + DAY_S * left / hours_a_day)
    if not times:
        return Due("done", None, None, left)
    days_left = (min(times) - now_unix_s) / DAY_S
    state: State = "due" if days_left <= 0.0 else "soon" if days_left <= notice_days else "done"
    return Due(state, min(times), days_left, left)


def check_named(items: Sequence[InspectionItem], name: str) -> InspectionItem:
    """The check of a name. Raises BadInput, which lists the names."""
    for item in items:
        if item.name.casefold() == " ".join(name.split()).casefold():
            return item
    known = ", ".join(repr(item.name) for item in items) or "none: [inspection] names no plan and no items"
    raise BadInput(f"inspected: {name!r} is no check of this arm; known are {known}")
