"""The daemon's documents on the bus: who publishes what."""

import dataclasses
import hashlib
import json
import platform
import socket
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from monitor import __version__
from monitor.config.schema import Configuration
from monitor.judge.alerts.health import Alert, alert_document
from monitor.judge.assessment import JointFriction
from monitor.judge.document import plain
from monitor.judge.drift.ripple_track import joint_ripple
from monitor.publish.bus import Bus
from monitor.publish.health_document import published_health
from monitor.publish.timestamps import outside
from monitor.recording import Context
from monitor.service.history.inspection import inspection_document
from monitor.service.history.maintenance import friction_known, row_document
from monitor.service.history.needed import from_production_document, need_document, needed
from monitor.service.shared_state import SharedState
from monitor.store.history.events import AlertEvent

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")  # Linux makes another identifier at every boot of the host, proc(5)
PACKAGES = ("eclipse-zenoh", "numpy", "pin", "ur-rtde")  # their versions decide what is on the wire and in the figures


def info(configuration: Configuration, *, started_at_unix_s: float, context: Context | None) -> dict[str, Any]:
    """The document before its times become text. `context`: of the last replay, with serial and firmware as reported by the controller."""
    seen = context or configuration.context
    return {
        "robot": dataclasses.asdict(configuration.robot),
        "serial": seen.serial or configuration.robot.serial,
        "firmware": seen.firmware,
        "mounting": configuration.robot.mounting,
        "version": __version__,
        "versions": versions(),
        "host": socket.gethostname(),
        "boot_id": boot_id(),
        "started_at_unix_s": started_at_unix_s,
        "configuration_digest": digest(configuration),
        "trajectory_digest": configuration.excitation.digest,
    }


def digest(configuration: Configuration) -> str:
    """16 hexadecimal digits of every setting in force, defaults included. The file's place and layout have no influence."""
    settings = {field.name: getattr(configuration, field.name) for field in dataclasses.fields(configuration)}
    del settings["path"], settings["excitation"]
    plain_settings = plain(settings) | {"trajectory": configuration.excitation.digest, "repetitions": configuration.excitation.repetitions}
    plain_settings["replay"].pop("cell", None)
    plain_settings["replay"]["cell"] = configuration.replay.cell.digest if configuration.replay.cell else None
    for name in ("zenoh", "client_zenoh"):  # their content belongs to Zenoh, and their folder differs from host to host
        plain_settings["bus"][name] = Path(plain_settings["bus"][name]).name
    return hashlib.sha256(json.dumps(plain_settings, sort_keys=True, default=str).encode()).hexdigest()[:16]


def boot_id() -> str | None:
    """The identifier of the host's present boot; None where the system has none."""
    try:
        return BOOT_ID.read_text("ascii").strip()
    except OSError:
        return None


def versions() -> dict[str, str]:
    """Versions of Python and of `PACKAGES`; a package that is not installed is left out."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


class Publisher:
    """Publishes what the shared state and the history hold. Any thread may call it; nothing in it blocks for long."""

    def __init__(self, bus: Bus, state: SharedState) -> None:
        self._bus, self._state, self._store, self._now = bus, state, state.store, state.now
        self._started_at_unix_s = self._now()

    def say(self, kind: str, document: dict[str, Any], *, done: Callable[[], None] | None = None, **parts: Any) -> None:
        """Publish one document of a registered kind, its times as text. `parts` fill in its key; `done` runs once it is sent."""
        published = outside(document)
        assert isinstance(published, dict)
        self._bus.say(kind, published, done=done, **parts)

    def everything(self) -> None:
        """Publish every last value that is known at a start."""
        self.info()
        for joint in range(1, self._state.robot.joints + 1):
            self.newest_friction(joint)
        for row in self._store.maintenance.rows():  # of each joint the last one stays
            self.act(row_document(row))
        self.judgement()
        self.from_production()
        self.inspection()

    def info(self) -> None:
        """Publish who watches which arm, with what, and since when."""
        belief = self._state.estimator.belief
        context = belief.context if belief else None
        self.say("info", info(self._state.configuration, started_at_unix_s=self._started_at_unix_s, context=context))

    def health(self) -> None:
        """Publish the states of arm and joints and whether they are too old; also before the first assessment."""
        now, nothing_learnt = self._now(), self._state.nothing_learnt
        self.say(
            "health",
            {
                **published_health(self._state.alerts, now, self._state.configuration.assess.health),
                "ripple": self._ripple(),
                "production": [plain(each) for each in self._state.production_motion.evidence()],
                "next_replay_due_unix_s": self._state.next_due_unix_s,
                "said_at_unix_s": now,
                **({} if nothing_learnt is None else {"nothing_learnt": nothing_learnt}),
            },
        )

    def _ripple(self) -> list[dict[str, Any]]:
        """The gear ripple of each joint after the last replay; empty where none was seen."""
        belief = self._state.estimator.belief
        joints = None if belief is None else joint_ripple(belief.ripple)
        return [{"joint": joint, **plain(ripple)} for joint, ripple in enumerate(joints or (), start=1)]

    def judgement(self) -> None:
        """Publish health, model and alerts as they are after the last assessment."""
        self.health()
        if self._state.torque_model is not None:
            self.say("model", self._state.torque_model.as_document())
        for alert in self._state.alerts.alerts:
            self.alert(alert)

    def friction(self, joint: JointFriction) -> None:
        """Publish one joint after one replay."""
        self.say("friction", plain(joint), joint=joint.joint)

    def newest_friction(self, joint: int) -> None:
        """Publish what is known of one joint (from 1) after the last replay, and after work since then."""
        belief = self._state.estimator.belief
        rows = self._store.assessments.friction(joint=joint, limit=1)
        if belief is not None and rows:
            known = friction_known(rows[0], float(belief.filter_state.replays[joint - 1]))
            self.say("friction", {key: value for key, value in known.items() if key != "replay"}, joint=joint)

    def from_production(self) -> None:
        """Publish what came from the arm's ordinary work, and how far the next replay is; nothing before the first day of work."""
        estimator = self._state.estimator
        settings = self._state.configuration.schedule
        found = needed(settings, self._store, estimator.belief, self._state.health)
        document = from_production_document(self._store, estimator, need_document(settings, found))
        if document is not None:
            self.say("from-production", document)

    def inspection(self) -> None:
        """Publish operating hours, stops and checks; nothing where [inspection] asks for none. Raises StoreError."""
        document = inspection_document(self._state.configuration.inspection, self._store, self._now())
        if document is not None:
            self.say("inspection", document)

    def act(self, document: dict[str, Any]) -> None:
        """Publish the last work on one joint."""
        self._bus.say("maintenance", document, joint=document["joint"])

    def alert(self, alert: Alert) -> None:
        """Publish the present state of one alert."""
        self.say("alert", alert_document(alert), where="arm" if alert.joint is None else f"j{alert.joint}", condition=alert.condition)

    def event(self, event: AlertEvent) -> None:
        """Publish one transition; the history marks it as published once it is sent."""
        self._bus.say("event", event_document(event), done=lambda: self._store.events.mark_published(event.seq))

    def replay(self, document: dict[str, Any]) -> None:
        """Publish what is going to happen to the arm, or has happened: for the cell's own programs."""
        self.say("replay", {**document, "said_at_unix_s": self._now()})

    def live(self, document: dict[str, Any]) -> None:
        """Publish one sample of predicted against measured torque; its time is text already."""
        self._bus.say("torque-live", document)


def event_document(event: AlertEvent) -> dict[str, Any]:
    """One transition as it is published."""
    document = outside({"seq": event.seq, "at_unix_s": event.at_unix_s, **event.document})
    assert isinstance(document, dict)
    return document
