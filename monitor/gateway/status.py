"""What the gateway owes and has delivered, for people and programs; whether it runs or not. I/O."""

import time
from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import sqlalchemy as sa

from monitor.gateway.outbox import DEAD, DELIVERED, OWED
from monitor.gateway.run import RUNNING
from monitor.gateway.silence import SILENCES
from monitor.plant.database import Database
from monitor.plant.status import Ticket, open_tickets
from monitor.plant.tables import delivery, note
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S

SILENT_S = 60.0  # the gateway says every ten seconds that it runs
SHOWN = 10  # deliveries that are named of each kind


class Line(NamedTuple):
    """One delivery."""

    channel: str
    recipient: str
    kind: str
    robot: str | None
    made_at: float
    due_at: float
    attempts: int
    error: str | None
    state: str


class GatewayStatus(NamedTuple):
    """The gateway at one moment."""

    not_running: str | None  # None: it runs
    channels: dict[str, dict[str, Any]]  # as it said them last
    owed: list[Line]  # the oldest first
    dead: list[Line]  # given up within the last 30 days
    delivered_day: dict[str, int]  # by channel, within a day
    tickets: list[Ticket]  # that are open


def gateway_status(database: Database, now_unix_s: float | None = None) -> GatewayStatus:
    """Read it from the plant's database. Raises StoreError."""
    now = time.time() if now_unix_s is None else now_unix_s
    to_somebody = (delivery.c.state == OWED) & (delivery.c.channel != SILENCES)  # a silence that is told is kept, and owed to nobody
    columns = [delivery.c[name] for name in Line._fields]
    with database.read() as connection:
        notes = sa.select(note.c.key, note.c.at, note.c.document).where((note.c.key == RUNNING) | note.c.key.startswith(f"{RUNNING} "))
        running = connection.execute(notes.order_by(note.c.at.desc())).all()
        owed = [Line(*row) for row in connection.execute(sa.select(*columns).where(to_somebody).order_by(delivery.c.id))]
        lately = sa.select(*columns).where(delivery.c.state == DEAD, delivery.c.ended_at > now - 30 * DAY_S)
        dead = [Line(*row) for row in connection.execute(lately.order_by(delivery.c.id))]
        count = sa.select(delivery.c.channel).where(delivery.c.state == DELIVERED, delivery.c.ended_at > now - DAY_S)
        delivered = Counter(connection.execute(count).scalars())
    tickets = open_tickets(database)
    stopped = None if running else "the gateway has never run with this database"
    if running and now - running[0].at > SILENT_S:
        stopped = f"the gateway does not run: what follows is of {rfc3339(running[0].at)}"
    channels: dict[str, dict[str, Any]] = {}
    for each in running if stopped is None else running[:1]:  # several may run: one with deliveries, others that show states
        if stopped is not None or now - each.at <= SILENT_S:
            for name, said in (each.document or {}).get("channels", {}).items():
                channels[name if name not in channels else f"{name} ({each.key.removeprefix(RUNNING).strip()})"] = said
    return GatewayStatus(stopped, channels, owed, dead, dict(delivered), tickets)


def as_document(status: GatewayStatus) -> dict[str, Any]:
    """For programs."""
    return {
        "not_running": status.not_running,
        "channels": {
            name: {
                **{"trouble": said.get("trouble"), "status": said.get("status"), "delivered_day": status.delivered_day.get(name, 0)},
                **{"trouble_since": _at(said.get("trouble_since_unix_s")), "next_try": _at(said.get("next_try_unix_s"))},
            }
            for name, said in status.channels.items()
        },
        "tickets": [ticket._asdict() for ticket in status.tickets],
        "owed": [_document(line) for line in status.owed],
        "dead": [_document(line) for line in status.dead],
    }


def as_lines(status: GatewayStatus) -> list[str]:
    """For a terminal."""
    lines = [f"NOT RUNNING: {status.not_running}"] if status.not_running else []
    for name, said in status.channels.items():
        lines.append(f"{name}: {_trouble(said) if said.get('trouble') else said.get('status') or 'works'}")
    for ticket in status.tickets[:SHOWN]:
        where = "" if ticket.joint is None else f" joint {ticket.joint}"
        lines.append(f"{ticket.robot}{where} {ticket.condition}: ticket {ticket.number or 'without a number'} {ticket.url or ''}".rstrip())
    if len(status.tickets) > SHOWN:
        lines.append(f"… and {len(status.tickets) - SHOWN} more tickets; --json has them all")
    for what, listed in (("owed", status.owed), ("given up", status.dead)):
        lines.append(f"{what}: {len(listed)}")
        lines += [f"  {_sentence(line)}" for line in listed[:SHOWN]]
        if len(listed) > SHOWN:
            lines.append(f"  … and {len(listed) - SHOWN} more; --json has them all")
    return lines


def _trouble(said: Mapping[str, Any]) -> str:
    since, at = _at(said.get("trouble_since_unix_s")), _at(said.get("next_try_unix_s"))
    return f"TROUBLE{f' since {since}' if since else ''}: {said['trouble']}{f'; tried again at {at}' if at else ''}"


def _at(unix_s: Any) -> str | None:
    return rfc3339(unix_s) if isinstance(unix_s, int | float) else None


def _sentence(line: Line) -> str:
    parts = [f"{line.channel} to {line.recipient}: {line.kind}", line.robot or "", f"since {rfc3339(line.made_at)}"]
    if line.attempts:
        attempts = "1 attempt" if line.attempts == 1 else f"{line.attempts} attempts"
        again = f", the next one at {rfc3339(line.due_at)}" if line.state == OWED else ""
        parts.append(f"{attempts}{again}: {line.error}")
    elif line.due_at > line.made_at:
        parts.append(f"waits until {rfc3339(line.due_at)}")
    return ", ".join(part for part in parts if part)


def _document(line: Line) -> dict[str, Any]:
    times = {"made_at": rfc3339(line.made_at), "due_at": rfc3339(max(line.due_at, line.made_at))}
    return {name: value for name, value in line._asdict().items() if name != "state"} | times
