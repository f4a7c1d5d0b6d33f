"""Operating hours, stops and checks of one arm as a document, and what people record of checks. I/O.

The daemon does this when it is asked on the bus, and `joint-monitor inspected` itself where no daemon runs.
"""

from collections.abc import Sequence

from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.judge.inspection import PLANS, Done, InspectionItem, InspectionSettings, check_named, due
from monitor.publish import documents
from monitor.publish.queries import InspectedRequest, UndoInspectedRequest
from monitor.publish.timestamps import unix_s, utc, utc_if
from monitor.recording import DAY_S
from monitor.store.history.duties import DutyDay, InspectionRow, SafetyStop
from monitor.store.store import Store

CLOCK_S = 300.0  # [s] a person's clock may be ahead of ours by so much


def declared_time(text: str, now_unix_s: float, instead: str) -> float:
    """The time [Unix s] that a person names of something done, now where that person's clock is a little ahead.

    Raises BadInput where it is none, or yet to come; `instead` says what to do then.
    """
    try:
        at = unix_s(text)
    except ValueError:
        raise BadInput(f"at {text!r}: not a date or time; expected e.g. 2026-01-31 or 2026-01-31T14:00:00Z") from None
    if at > now_unix_s + CLOCK_S:
        raise BadInput(f"at {text!r}: that is yet to come; {instead}")
    return min(at, now_unix_s)


Request = InspectedRequest | UndoInspectedRequest
PACE_DAYS = 28  # the usual operating hours a day are of so many days
STOPS_SHOWN = 20  # newest stops of the document
HOUR_S = 3600.0


def inspection_document(settings: InspectionSettings, store: Store, now_unix_s: float) -> documents.Inspection | None:
    """Operating hours, stops and checks; None where [inspection] asks for nothing. Raises StoreError."""
    if not settings.wanted:
        return None
    first, heard_s, on_s, moving_s, stops = store.duties.total()
    today = int(now_unix_s // DAY_S)
    recent = store.duties.days(today - PACE_DAYS + 1)
    pace = _hours_a_day(recent, today)
    hours = settings.hours_before + on_s / HOUR_S
    newest = store.duties.stops(limit=STOPS_SHOWN)
    rows = [row for row in store.duties.inspections() if row.in_force]
    return documents.Inspection(
        said_at=utc(now_unix_s),
        counted_since=None if first is None else utc(first * DAY_S),
        heard_h=heard_s / HOUR_S,
        on_h=on_s / HOUR_S,
        moving_h=moving_s / HOUR_S,
        operating_h=hours,
        on_h_per_day=pace,
        stops=stops,
        stops_28_days=sum(day.stops for day in recent),
        stops_by_joint=[documents.JointStops(joint=joint, stops=count) for joint, count in store.duties.stops_by_joint().items()],
        last_stops=[stop_document(stop) for stop in reversed(newest)],
        plan=PLANS[settings.plan].source if settings.plan else None,
        items=[_item(item, settings, rows, store, now_unix_s, hours, pace) for item in settings.checks],
    )


def stop_document(stop: SafetyStop) -> documents.SafetyStop:
    """One stop as it is published."""
    return documents.SafetyStop(
        at=utc(stop.at_unix_s),
        kind=stop.kind,
        ended_at=utc_if(stop.ended_at_unix_s),
        joint=stop.joint,
        code=stop.code,
        during_replay=bool(stop.during_replay),
    )


def _hours_a_day(recent: Sequence[DutyDay], today: int) -> float:
    """The usual operating hours a day [h]; today, which is not over, does not count unless it is the only day."""
    days = [day for day in recent if day.day != today] or list(recent)
    return sum(day.on_s for day in days) / HOUR_S / (max(today - days[0].day, 1)) if days else 0.0


def _item(
    item: InspectionItem,
    settings: InspectionSettings,
    rows: Sequence[InspectionRow],
    store: Store,
    now_unix_s: float,
    hours: float,
    pace: float,
) -> documents.InspectionItem:
    own = max((row for row in rows if row.item == item.name), key=lambda row: row.done_at_unix_s, default=None)
    configured = unix_s(item.last_done) if item.last_done else None
    if configured is not None and configured > now_unix_s + DAY_S:  # a slip is no record; a day in which it is tomorrow somewhere
        configured = None
    done: Done | None = None
    if own is not None and (configured is None or own.done_at_unix_s >= configured):
        done = Done(own.done_at_unix_s, own.hours)
    elif configured is not None:
        own, done = None, Done(configured, _hours_at(store, settings, configured, hours))
    found = due(item, done, now_unix_s, hours, pace, settings.notice_days)
    return documents.InspectionItem(
        name=item.name,
        every_days=item.every_days or None,
        every_hours=item.every_hours or None,
        after_collision=item.after_collision,
        last_done=None if done is None else utc(done.at_unix_s),
        last_by=None if own is None else own.done_by,
        last_why=None if own is None else own.why,
        state=found.state,
        due=utc_if(found.at_unix_s),
        days_left=found.days_left,
        hours_left=found.hours_left,
        stops_since=store.duties.stops_since(0.0 if done is None else done.at_unix_s),
    )


def _hours_at(store: Store, settings: InspectionSettings, at_unix_s: float, hours_now: float) -> float | None:
    """The operating hours of a time, to a day; of one before the count those at its beginning. None: nothing is counted yet."""
    days = store.duties.days()
    day = int(at_unix_s // DAY_S)
    if not days or day < days[0].day:
        return settings.hours_before if days else None
    return hours_now - sum(each.on_s for each in days if each.day > day) / HOUR_S


def declare(store: Store, settings: InspectionSettings, request: Request, now_unix_s: float) -> documents.Answer:
    """Store what a person says of a check; returns the answer to the command. Raises BadInput where it does not fit this arm."""
    item = check_named(settings.checks, request.item)
    if isinstance(request, UndoInspectedRequest):
        rows = [row for row in store.duties.inspections() if row.in_force and row.item == item.name]
        if not rows:
            raise BadInput(f"inspected: {item.name!r}: nothing is recorded that could be taken back")
        store.duties.undo(rows[-1].id, now_unix_s, request.by, request.why)
        return _answer("uninspected", store, settings, item, now_unix_s)
    at = now_unix_s if request.at is None else declared_time(request.at, now_unix_s, "record a check when it is made")
    _, _, on_s, _, _ = store.duties.total()
    hours = settings.hours_before + on_s / HOUR_S
    then = hours if now_unix_s - at < DAY_S else _hours_at(store, settings, at, hours)
    store.duties.inspected(item.name, at, now_unix_s, then, request.by, request.why)
    return _answer("inspected", store, settings, item, now_unix_s)


def _answer(done: str, store: Store, settings: InspectionSettings, item: InspectionItem, now_unix_s: float) -> documents.Answer:
    document = inspection_document(settings, store, now_unix_s)
    assert document is not None  # there is a check
    shown = next(each for each in document.items if each.name == item.name)
    return documents.Answer(done=done, inspection=shown, text=[item_text(shown)])


def item_text(item: documents.InspectionItem) -> str:
    """One check as a sentence."""
    if item.last_done is None:
        return f"{item.name}: due, nobody has recorded when it was done last."
    last = f"last done {item.last_done:%Y-%m-%d}"
    if item.due is None or item.days_left is None:
        return f"{item.name}: {last}; its hours are not known yet."
    when = f"due {item.due:%Y-%m-%d}" if item.days_left > 0.0 else f"due since {item.due:%Y-%m-%d}"
    hours = "" if item.hours_left is None else f", {item.hours_left:.0f} h left"
    return f"{item.name}: {when}{hours}; {last}."


def offline(configuration: Configuration, request: Request, now_unix_s: float) -> documents.Answer:
    """Store what a person says where no daemon runs. Raises BadInput, StoreError; StoreInUse where a daemon has the history."""
    check_named(configuration.inspection.checks, request.item)
    with Store.open(configuration.state_directory) as store:
        return declare(store, configuration.inspection, request, now_unix_s)
