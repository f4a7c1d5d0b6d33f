"""What the plant knows, for people and programs: every arm, the worst first, and the tickets of its alerts. I/O."""

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

import sqlalchemy as sa

from monitor import __version__
from monitor.errors import BadInput, StoreError
from monitor.plant.arm import DOUBLED, GRADES, ArmStatus, worst_first
from monitor.plant.database import Database
from monitor.plant.ingest import RUNNING
from monitor.plant.tables import arm, delivery, history, last_value, note
from monitor.publish.timestamps import rfc3339

FEW, LONGEST_NAME = 3, 60  # names that a line shows, and of how many letters
MOST_OF_A_SENTENCE, LONGEST = 300, 1000  # letters of what an arm says, and of a line
LONG_S = 2.0 * 3600.0  # from here on hours are told and no minutes
SILENT_S = 60.0  # the plant says every ten seconds that it runs


class PlantStatus(NamedTuple):
    """The plant at one moment."""

    not_running: str | None  # why what follows is old; None: the plant runs
    ways: dict[str, bool]  # by endpoint: whether somebody answers there
    copying: int  # arms whose histories are being copied
    arms: list[ArmStatus]  # the worst first


def plant_status(database: Database, now_unix_s: float | None = None) -> PlantStatus:
    """Read it from the database, whether the plant runs or not. Raises StoreError."""
    now = time.time() if now_unix_s is None else now_unix_s
    with database.read() as connection:
        running = connection.execute(sa.select(note.c.at, note.c.document).where(note.c.key == RUNNING)).one_or_none()
        present = (history.c.arm == arm.c.id) & (history.c.number == arm.c.history)
        rows = connection.execute(sa.select(arm, history.c.history_id).outerjoin(history, present)).all()
        said: dict[int, dict[str, Any]] = {}
        heard: dict[int, float] = {}  # when each monitor's own document came
        wanted = sa.select(last_value.c.arm, last_value.c.key, last_value.c.heard_at, last_value.c.document).where(
            last_value.c.key.in_(("health", "monitor", "info"))
        )
        for number, key, heard_at, document in connection.execute(wanted):
            said.setdefault(number, {})[key] = document
            if key == "monitor":
                heard[number] = heard_at
    document = running[1] if running else {}
    stopped = "the plant has never run with this database" if running is None else None
    if running is not None and not -SILENT_S <= now - running[0] <= SILENT_S:  # a clock may have gone back
        stopped = f"the plant does not run: what follows is of {rfc3339(running[0])}"
    of_history: dict[str, list[str]] = {}
    for row in rows:
        if row.history_id:
            of_history.setdefault(row.history_id, []).append(f"{row.site}/{row.robot}")
    found = [
        arm_status(row._mapping, said.get(row.id, {}), of_history.get(row.history_id, []), heard_unix_s=heard.get(row.id)) for row in rows
    ]
    arms = worst_first(found)
    return PlantStatus(stopped, dict(document.get("ways", {})), int(document.get("copying", 0)), arms)


def arm_status(
    row: Mapping[str, Any] | sa.RowMapping, said: Mapping[str, Any], same: Sequence[str], *, heard_unix_s: float | None = None
) -> ArmStatus:
    """One arm from its row and its last documents, of which each may lack anything: they came from elsewhere.

    same : the arms that have its history, itself among them. heard_unix_s : when its document `monitor` came.
    """
    health, monitor, info = (value if isinstance(value := said.get(key), dict) else {} for key in ("health", "monitor", "info"))
    alerts = [each for each in _list(health, "alerts") if each.get("active")]
    last = monitor.get("last_replay")
    about = info.get("robot")
    return ArmStatus(
        site=row["site"],
        robot=row["robot"],
        model=_text(about, "model"),
        state=_text(health, "state"),
        why=_text(health, "why"),
        since=_text(health, "since"),
        stale=health.get("stale") is True,
        silent_since_unix_s=row["silent_since"],
        silent_why=row["silent_why"],
        problem=row["problem"],
        alerts=len(alerts),
        unacknowledged=sum(not each.get("acknowledged_at") for each in alerts),
        troubles=tuple(str(each.get("name")) for each in _list(monitor, "troubles")),
        last_replay=_text(last, "window"),
        version=_text(info, "version"),
        clock_ahead_s=_ahead(_text(monitor, "said_at"), heard_unix_s),
        histories=row["history"],
        same_history=tuple(name for name in same if name != f"{row['site']}/{row['robot']}"),
        joints=tuple(_text(each, "state") for each in _list(health, "joints")),
        active_alerts=tuple(alerts),
    )


def _ahead(said_at: str | None, heard_unix_s: float | None) -> float | None:
    """How far the clock of whoever said something at that time is ahead of ours; None where it cannot be read."""
    if said_at is None or heard_unix_s is None:
        return None
    try:
        at = datetime.fromisoformat(said_at)
        return at.timestamp() - heard_unix_s if at.tzinfo is not None else None
    except (ValueError, OverflowError):
        return None


def refuse_doubled(database: Database, site: str, robot: str) -> None:
    """Before a command: raises BadInput where two monitors have this name, as either of two arms could do what is asked."""
    try:
        with database.read() as connection:
            problem = connection.execute(sa.select(arm.c.problem).where(arm.c.site == site, arm.c.robot == robot)).scalar_one_or_none()
    except StoreError as error:
        raise BadInput(f"nothing was done, as nobody knows whether {site}/{robot} is one arm: {error}") from None
    if problem == DOUBLED:
        raise BadInput(f"nothing was done: {DOUBLED}")


def _list(document: Any, key: str) -> list[dict[str, Any]]:
    value = document.get(key) if isinstance(document, dict) else None
    return [each for each in value if isinstance(each, dict)] if isinstance(value, list) else []


def _text(document: Any, key: str) -> str | None:
    value = document.get(key) if isinstance(document, dict) else None
    return value if isinstance(value, str) else None


def as_document(status: PlantStatus) -> dict[str, Any]:
    """For programs."""
    counts = Counter(arm.grade for arm in status.arms)
    return {
        "not_running": status.not_running,
        "ways": status.ways,
        "copying": status.copying,
        "counts": {"arms": len(status.arms)} | {name: counts[grade] for grade, name in enumerate(GRADES)},
        "arms": [arm_document(arm) for arm in status.arms],
    }


def arm_document(arm: ArmStatus) -> dict[str, Any]:
    """One arm, for programs and for the screen."""
    return {
        "site": arm.site,
        "robot": arm.robot,
        "grade": GRADES[arm.grade],
        "model": arm.model,
        "state": arm.state,
        "why": arm.why,
        "since": arm.since,
        "stale": arm.stale,
        "silent_why": arm.silent_why,
        "problem": arm.problem,
        "silent_since": None if arm.silent_since_unix_s is None else rfc3339(arm.silent_since_unix_s),
        "alerts": arm.alerts,
        "unacknowledged": arm.unacknowledged,
        "troubles": list(arm.troubles),
        "clock_ahead_s": arm.clock_ahead_s if arm.clock_differs else None,
        "last_replay": arm.last_replay,
        "version": arm.version,
        "histories": arm.histories,
        "same_history": list(arm.same_history),
    }


def as_lines(status: PlantStatus, most: int | None = None) -> list[str]:
    """For people: a line an arm, the worst first; those that are well are only counted where there are more than `most`."""
    counts = Counter(arm.grade for arm in status.arms)
    lines = [f"NOT FOLLOWED: {status.not_running}"] if status.not_running else []
    lines.append(f"{len(status.arms)} arms: " + ", ".join(f"{counts[grade]} {name}" for grade, name in enumerate(GRADES)))
    lines += [f"no answer from {endpoint}" for endpoint, up in status.ways.items() if not up]
    lines += [f"{status.copying} histories are being copied"] if status.copying else []
    shown = status.arms if most is None else status.arms[:most]
    width = max((len(f"{arm.site}/{arm.robot}") for arm in shown), default=0)
    for each in shown:
        lines.append(
            f"{GRADES[each.grade]:<9} {f'{each.site}/{each.robot}':<{width}}  {each.state or 'no state yet':<20}  {_about(each)}".rstrip()
        )
    if len(shown) < len(status.arms):
        lines.append(f"… and {len(status.arms) - len(shown)} more; --all shows them")
    return lines


def _about(each: ArmStatus) -> str:
    """What a person must know of an arm, in one line."""
    parts = []
    if each.silent_since_unix_s is not None:
        parts.append(f"SILENT since {rfc3339(each.silent_since_unix_s)}: {each.silent_why}")
    if each.stale:
        parts.append("STALE: nothing was learnt of it for a long time")
    if each.problem:
        parts.append(f"NOT COPIED: {_line(each.problem, MOST_OF_A_SENTENCE)}")
    if each.why and each.state != "NORMAL":
        parts.append(_line(each.why, MOST_OF_A_SENTENCE))
    if each.unacknowledged:
        parts.append(f"{each.unacknowledged} of {each.alerts} alerts wait for a person")
    if each.troubles:
        parts.append(f"troubles of its monitor: {_few(each.troubles)}")
    if each.clock_differs and each.clock_ahead_s is not None:
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


def _twin(each: ArmStatus) -> str:
    """What it means that two arms have one history."""
    if each.silent_since_unix_s is not None:
        return f"if it was renamed, joint-monitor plant forget {each.site}/{each.robot} takes the old name away"
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
