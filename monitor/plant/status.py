"""What the plant knows, for people and programs: every arm, the worst first, and the tickets of its alerts. I/O."""

import time
from collections import Counter
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import sqlalchemy as sa

from monitor import __version__
from monitor.errors import BadInput, StoreError
from monitor.judge.alerts.health import NORMAL
from monitor.plant.arm import DOUBLED, ArmName, HeardArm, documents_of, worst_first
from monitor.plant.database import Database
from monitor.plant.ingest import RUNNING
from monitor.plant.tables import arm, delivery, history, last_value, note
from monitor.publish.documents import worded_json
from monitor.publish.shown import Age, Grade
from monitor.publish.timestamps import rfc3339, written_if
from monitor.reason import Reason, Sentence
from monitor.views.alert_sentence import deciding
from monitor.views.language.catalogue import ENGLISH, Language

FEW, LONGEST_NAME = 3, 60  # names that a line shows, and of how many letters
MOST_OF_A_SENTENCE, LONGEST = 300, 1000  # letters of what an arm says, and of a line
LONG_S = 2.0 * 3600.0  # from here on hours are told and no minutes
DOCUMENTS = ("health", "monitor", "info")
NEVER_RUN = Sentence("plant_never_run", "the plant has never run with this database")()
STOPPED = Sentence("plant_stopped", "the plant does not run: what follows is of {at}")
NOBODY_KNOWS = Sentence("one_arm_or_two", "nothing was done, as nobody knows whether {arm} is one arm: {why}")
NOTHING_DONE = Sentence("nothing_done", "nothing was done: {why}")
SILENT_S = 60.0  # the plant says every ten seconds that it runs


class PlantStatus(NamedTuple):
    """The plant at one moment."""

    not_running: Reason | None  # why what follows is old; None: the plant runs
    ways: dict[str, bool]  # by endpoint: whether somebody answers there
    copying: int  # arms whose histories are being copied
    arms: list[HeardArm]  # the worst first
    at_unix_s: float


def plant_status(database: Database, now_unix_s: float | None = None) -> PlantStatus:
    """Read it from the database, whether the plant runs or not. Raises StoreError."""
    now = time.time() if now_unix_s is None else now_unix_s
    with database.read() as connection:
        running = connection.execute(sa.select(note.c.at, note.c.document).where(note.c.key == RUNNING)).one_or_none()
        arms = heard_arms(connection)
    stopped = NEVER_RUN if running is None else None
    if running is not None and not -SILENT_S <= now - running[0] <= SILENT_S:  # a clock may have gone back
        stopped = STOPPED(at=rfc3339(running[0]))
    said = running[1] if running else {}
    return PlantStatus(stopped, dict(said.get("ways", {})), int(said.get("copying", 0)), worst_first(arms, now), now)


def heard_arms(connection: sa.Connection, numbers: Collection[int] | None = None, *, keys: Collection[str] = DOCUMENTS) -> list[HeardArm]:
    """Arms with the documents of these keys, without their friction. numbers : of these arms; None: of all."""
    present = (history.c.arm == arm.c.id) & (history.c.number == arm.c.history)
    rows = connection.execute(sa.select(arm, history.c.history_id, history.c.set_aside).outerjoin(history, present)).all()
    wanted = sa.select(last_value.c.arm, last_value.c.key, last_value.c.heard_at, last_value.c.document).where(last_value.c.key.in_(keys))
    if numbers is not None:
        wanted = wanted.where(last_value.c.arm.in_(list(numbers)))
    said: dict[int, dict[str, Any]] = {}
    heard: dict[int, dict[str, float]] = {}
    for number, key, heard_at, document in connection.execute(wanted):
        said.setdefault(number, {})[key] = document
        heard.setdefault(number, {})[key] = heard_at
    of_history: dict[str, list[ArmName]] = {}
    for row in rows:
        if row.history_id:
            of_history.setdefault(row.history_id, []).append(ArmName(row.site, row.robot))
    return [
        HeardArm(
            name=(name := ArmName(row.site, row.robot)),
            number=row.id,
            **documents_of(said.get(row.id, {}), heard.get(row.id, {}).get("health", 0.0)),
            heard_at_unix_s=heard.get(row.id, {}),
            silent_since_unix_s=row.silent_since,
            silent_why=row.silent_why,
            problem=row.problem,
            set_aside=row.set_aside,
            histories=row.history,
            same_history=tuple(str(each) for each in of_history.get(row.history_id, ()) if each != name),
        )
        for row in rows
        if numbers is None or row.id in numbers
    ]


def refuse_doubled(database: Database, site: str, robot: str) -> None:
    """Before a command: raises BadInput where two monitors have this name, as either of two arms could do what is asked."""
    try:
        with database.read() as connection:
            problem = connection.execute(sa.select(arm.c.problem).where(arm.c.site == site, arm.c.robot == robot)).scalar_one_or_none()
    except StoreError as error:
        raise BadInput(NOBODY_KNOWS(arm=f"{site}/{robot}", why=error.reason)) from None
    if problem == DOUBLED:
        raise BadInput(NOTHING_DONE(why=DOUBLED))


def as_document(status: PlantStatus) -> dict[str, Any]:
    """For programs."""
    counts = Counter(arm.grade for arm in status.arms)
    return {
        **worded_json(not_running=status.not_running),
        "ways": status.ways,
        "copying": status.copying,
        "counts": {"arms": len(status.arms)} | {grade.value: counts[grade] for grade in Grade},
        "arms": [arm_document(arm, status.at_unix_s) for arm in status.arms],
    }


def arm_document(arm: HeardArm, now_unix_s: float, say: Language = ENGLISH) -> dict[str, Any]:
    """One arm, for programs and for the screen: sentences in a language."""
    shown = arm.shown
    return {
        "site": arm.name.site,
        "robot": arm.name.robot,
        "grade": arm.grade.value,
        "model": arm.model,
        "state": shown.state,
        "pill": shown.pill.value,
        "age": shown.age.value,
        "why": deciding(shown, now_unix_s, say),
        "since": written_if(None if arm.health is None else arm.health.since),
        "stale": arm.stale,
        "silent_since": None if arm.silent is None else rfc3339(arm.silent.since_unix_s or 0.0),
        "silent_why": None if arm.silent is None else say.say(arm.silent.why),
        "problem": None if arm.problem is None else say.say(arm.problem),
        "set_aside": None if arm.set_aside is None else say.say(arm.set_aside),
        "alerts": len(arm.alerts),
        "waiting": len(arm.waiting(now_unix_s)),
        "troubles": list(arm.troubles),
        "clock_ahead_s": arm.clock_ahead_s,
        "last_replay": written_if(None if arm.last_replay is None else arm.last_replay.window),
        "version": arm.version,
        "histories": arm.histories,
        "same_history": list(arm.same_history),
    }


def as_lines(status: PlantStatus, most: int | None = None) -> list[str]:
    """For people: a line an arm, the worst first; those that are well are only counted where there are more than `most`."""
    counts = Counter(arm.grade for arm in status.arms)
    lines = [f"NOT FOLLOWED: {status.not_running.text}"] if status.not_running else []
    lines.append(f"{len(status.arms)} arms: " + ", ".join(f"{counts[grade]} {grade.value}" for grade in Grade))
    lines += [f"no answer from {endpoint}" for endpoint, up in status.ways.items() if not up]
    lines += [f"{status.copying} histories are being copied"] if status.copying else []
    shown = status.arms if most is None else status.arms[:most]
    width = max((len(str(arm.name)) for arm in shown), default=0)
    for each in shown:
        state = each.shown.pill.value or "no state yet"
        lines.append(f"{each.grade.value:<9} {each.name!s:<{width}}  {state:<20}  {_about(each, status.at_unix_s)}".rstrip())
    if len(shown) < len(status.arms):
        lines.append(f"… and {len(status.arms) - len(shown)} more; --all shows them")
    return lines


def _about(each: HeardArm, now_unix_s: float) -> str:
    """What a person must know of an arm, in one line."""
    parts, shown, waits = [], each.shown, each.waiting(now_unix_s)
    if each.silent is not None:
        parts.append(f"SILENT since {rfc3339(each.silent.since_unix_s or 0.0)}: {each.silent.why.text}")
    if each.stale:
        parts.append("STALE: nothing was learnt of it for a long time")
    if each.problem:
        parts.append(f"NOT COPIED: {_line(each.problem.text, MOST_OF_A_SENTENCE)}")
    if each.set_aside:
        parts.append(f"SET ASIDE: {_line(each.set_aside.text, MOST_OF_A_SENTENCE)}")
    if shown.age is Age.NOW and shown.state != NORMAL and each.health is not None:
        parts.append(_line(deciding(shown, now_unix_s), MOST_OF_A_SENTENCE))
    if waits:
        parts.append(f"{len(waits)} of {len(each.alerts)} alerts wait for a person")
    if each.troubles:
        parts.append(f"troubles of its monitor: {_few(each.troubles)}")
    if each.clock_ahead_s is not None:
        side = "ahead of" if each.clock_ahead_s > 0.0 else "behind"
        parts.append(f"its clock is {_duration(abs(each.clock_ahead_s))} {side} the plant's")
    if each.version and each.version != __version__:
        parts.append(f"its monitor is of version {_line(each.version, LONGEST_NAME)}, the plant of {__version__}")
    if each.same_history:
        parts.append(f"its history is that of {_few(each.same_history)} as well: {_twin(each)}")
    if each.histories > 1:
        parts.append(f"history number {each.histories}: earlier ones were restored or replaced")
    return _line("; ".join(parts))


def _duration(seconds: float) -> str:
    return f"{seconds / 3600.0:.0f} h" if seconds > LONG_S else f"{seconds / 60.0:.0f} min"


def _twin(each: HeardArm) -> str:
    """What it means that two arms have one history."""
    if each.silent is not None:
        return f"if it was renamed, joint-monitor plant forget {each.name} takes the old name away"
    return "was it renamed, or its disk copied?"


def _few(names: Sequence[str]) -> str:
    shown = ", ".join(_line(name, LONGEST_NAME) for name in names[:FEW])
    return shown if len(names) <= FEW else f"{shown} and {len(names) - FEW} more"


def _line(text: str, most: int = LONGEST) -> str:
    """What an arm says, as part of a line of a terminal: it may hold anything, of any length."""
    shown = "".join(sign if sign.isprintable() else " " for sign in text)
    return shown if len(shown) <= most else f"{shown[: most - 1]}…"


# --- The tickets that the gateway has opened for alerts, as the plant's database has them


class Ticket(NamedTuple):
    """The ticket of one alert."""

    robot: str  # site/robot
    joint: int | None
    condition: str
    number: str | None  # None: the maintenance system did not say it
    url: str | None  # for people


def open_tickets(database: Database) -> list[Ticket]:
    """The tickets of alerts that are not over. Raises StoreError."""
    there = (delivery.c.kind == "close") | ((delivery.c.kind == "open") & (delivery.c.state == "delivered"))
    wanted = sa.select(delivery.c.kind, delivery.c.robot, delivery.c.document, delivery.c.answer)
    wanted = wanted.where(delivery.c.channel == "tickets", there)
    found: dict[str, Ticket] = {}
    with database.read() as connection:
        for kind, robot, document, answer in connection.execute(wanted.order_by(delivery.c.id)):
            if kind == "open":
                said = answer or {}
                found[document["alert_id"]] = Ticket(robot, document["joint"], document["condition"], said.get("number"), said.get("url"))
            else:
                found.pop(document["alert_id"], None)
    return list(found.values())
