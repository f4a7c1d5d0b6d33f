"""The tickets that the gateway has opened for alerts, as the plant's database has them. I/O."""

from typing import NamedTuple

import sqlalchemy as sa

from monitor.plant.database import Database
from monitor.plant.tables import delivery


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
