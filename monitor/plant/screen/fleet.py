"""What the screen's list shows: every arm with its joints and alerts, and one joint among its peers. From the database. I/O."""

import gzip
import logging
import threading
import time
from collections.abc import Mapping
from typing import Any

import orjson
import sqlalchemy as sa

from monitor import __version__
from monitor.errors import StoreError
from monitor.plant.arm import ArmStatus
from monitor.plant.database import Database
from monitor.plant.status import arm_document, open_tickets, plant_status
from monitor.plant.tables import arm, friction, last_value
from monitor.publish.timestamps import rfc3339

log = logging.getLogger(__name__)

FRESH_S = 2.0  # so long an answer is given again: many browsers cost no more than one
OLD_S = 30.0  # an older answer is given to nobody: reading it anew is waited for
MOST_ALERTS = 100  # of one arm; eight joints cannot have as many
ALERT_TEXTS = ("condition", "tier", "text", "raised_at")  # always there
ALERT_PERHAPS = ("acknowledged_at", "acknowledged_by", "shelved_until")
PEER_FIGURES = ("wear", "wear_std", "wear_rate_per_day", "reference_torque_nm")


class Fleet:
    """The list of all arms. Who asks gets what was read last, and has it read anew. Several threads may use it."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._reading = threading.Lock()
        self._read_at = -OLD_S
        self._encoded = self._packed = b""

    def document(self) -> bytes:
        """The list as JSON, at most half a minute old. Raises StoreError where the database does not answer."""
        age_s = time.monotonic() - self._read_at
        if age_s < FRESH_S:
            return self._encoded
        if age_s < OLD_S and self._reading.acquire(blocking=False):
            threading.Thread(target=self._read_in_background, name="fleet", daemon=True).start()
        elif age_s >= OLD_S:
            with self._reading:
                if time.monotonic() - self._read_at >= FRESH_S:
                    self._keep(self._read())
        return self._encoded

    def packed(self) -> bytes:
        """`document`, compressed. A browser asks for it every three seconds, and 1000 arms are 600 kB. Raises StoreError."""
        self.document()
        return self._packed

    def _read_in_background(self) -> None:
        try:
            self._keep(self._read())
        except StoreError as error:
            log.debug("the list of arms is not read: %s", error)  # whoever asks when it is old is told
        finally:
            self._reading.release()

    def _keep(self, document: dict[str, Any]) -> None:
        encoded = orjson.dumps(document)
        self._encoded, self._packed = encoded, gzip.compress(encoded, 1)
        self._read_at = time.monotonic()

    def _read(self) -> dict[str, Any]:
        status = plant_status(self._database)
        arms = [shown_arm(each) for each in status.arms]
        tickets = {(each.robot, each.joint, each.condition): each for each in open_tickets(self._database)}
        for each in arms if tickets else ():
            for alert in each["alerts"]:
                ticket = tickets.get((f"{each['site']}/{each['robot']}", alert.get("joint"), str(alert.get("condition"))))
                if ticket is not None:
                    alert["ticket"] = {"number": ticket.number, "url": ticket.url}
        about = {"not_running": status.not_running, "ways": status.ways, "version": __version__}
        return {**about, "said_at": rfc3339(time.time()), "arms": arms}

    def peers(self, site: str, robot: str, joint: int) -> dict[str, Any]:
        """The last figures of this joint and of the same joint of every arm of its model.

        Raises StoreError, and KeyError for an unknown arm.
        """
        with self._database.read() as connection:
            infos = sa.select(arm.c.id, arm.c.site, arm.c.robot, arm.c.history, last_value.c.document).outerjoin(
                last_value, (last_value.c.arm == arm.c.id) & (last_value.c.key == "info")
            )
            arms = connection.execute(infos).all()
            models = {(row.site, row.robot): _model(row.document) for row in arms}
            model = models[site, robot]
            found = []
            for row in arms:
                same = (row.site, row.robot) == (site, robot)
                if not same and (model is None or models[row.site, row.robot] != model):
                    continue
                newest = (
                    sa.select(friction.c.recorded_at, *(friction.c[name] for name in PEER_FIGURES))
                    .where(friction.c.arm == row.id, friction.c.history == row.history, friction.c.joint == joint)
                    .order_by(friction.c.recorded_at.desc())
                    .limit(1)
                )
                figures = connection.execute(newest).one_or_none()
                if figures is not None:
                    values = {name: getattr(figures, name) for name in PEER_FIGURES}
                    found.append(
                        {"site": row.site, "robot": row.robot, "this": same, "recorded_at": rfc3339(figures.recorded_at), **values}
                    )
        return {"model": model, "joint": joint, "peers": found}


def shown_arm(arm: ArmStatus) -> dict[str, Any]:
    """What the list shows of an arm."""
    return {**arm_document(arm), "joints": arm.joints, "alerts": [_alert(alert) for alert in arm.active_alerts[:MOST_ALERTS]]}


def _alert(said: Mapping[str, Any]) -> dict[str, Any]:
    """What the list shows of an alert: an arm of another make may say anything, and the screen of all arms must be drawn."""
    texts = {key: said[key] if isinstance(said.get(key), str) else "" for key in ALERT_TEXTS}
    perhaps = {key: said[key] if isinstance(said.get(key), str) else None for key in ALERT_PERHAPS}
    return {"joint": said["joint"] if isinstance(said.get("joint"), int) else None, **texts, **perhaps}


def _model(info: Any) -> str | None:
    robot = info.get("robot") if isinstance(info, dict) else None
    value = robot.get("model") if isinstance(robot, dict) else None
    return value if isinstance(value, str) else None
