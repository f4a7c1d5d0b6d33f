"""The daemon's documents on the bus: who publishes what."""

import dataclasses
import hashlib
import json
import logging
import platform
import socket
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from monitor import __version__
from monitor.config.schema import Configuration
from monitor.judge.alerts.health import Alert, alert_document
from monitor.judge.document import plain
from monitor.judge.drift.ripple_track import joint_ripple
from monitor.publish import documents
from monitor.publish.bus import Bus
from monitor.publish.compensation import compensation
from monitor.publish.documents import Document, made, mended, worded
from monitor.publish.health_document import health_document
from monitor.publish.timestamps import outside, utc, utc_if
from monitor.recording import Context
from monitor.service.history.inspection import inspection_document
from monitor.service.history.maintenance import friction_known, row_document
from monitor.service.history.needed import from_production_document
from monitor.service.plant_prior import prior_taken
from monitor.service.shared_state import SharedState
from monitor.store.history.events import AlertEvent
from monitor.store.history.ledger import LedgerRow

if TYPE_CHECKING:
    from monitor.judge.assessment import JointFriction

log = logging.getLogger(__name__)

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")  # Linux makes another identifier at every boot of the host, proc(5)
PACKAGES = ("eclipse-zenoh", "numpy", "pin", "ur-rtde")  # their versions decide what is on the wire and in the figures


def info(
    configuration: Configuration, *, started_at_unix_s: float, context: Context | None, prior: documents.PriorTaken | None = None
) -> documents.Info:
    """Who watches which arm, with which programs, and since when. context : of the last replay, with what the controller reported."""
    seen = context or configuration.context
    return documents.Info(
        robot=dataclasses.asdict(configuration.robot),
        serial=seen.serial or configuration.robot.serial or None,
        firmware=seen.firmware,
        mounting=configuration.robot.mounting,
        version=__version__,
        versions=versions(),
        host=socket.gethostname(),
        boot_id=boot_id(),
        started_at=utc(started_at_unix_s),
        configuration_digest=digest(configuration),
        trajectory_digest=configuration.excitation.digest,
        prior=prior,
    )


def digest(configuration: Configuration) -> str:
    """16 hexadecimal digits of every setting in force, defaults included. The file's place and layout have no influence."""
    settings = {field.name: getattr(configuration, field.name) for field in dataclasses.fields(configuration)}
    del settings["path"], settings["excitation"], settings["prior_of_plant"]
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

    def say(self, document: Document, *, done: Callable[[], None] | None = None) -> None:
        """Publish one document of a registered kind; `done` runs once it is sent."""
        self._bus.say(document, done=done)

    def _say(self, model: type[Document], value: object) -> None:
        """Publish the document of a value; where it is none, the log names it, and everything else goes on."""
        try:
            document = made(model, value)
        except ValidationError as error:
            log.error("a document %s does not fit its model and is not published: %s", model.__name__, error)
            return
        self.say(document)

    def everything(self) -> None:
        """Publish every last value that is known at a start."""
        self.info()
        for joint in range(1, self._state.robot.joints + 1):
            self.newest_friction(joint)
        for row in self._store.maintenance.rows():  # of each joint the last one stays
            self.say(row_document(row))
        self.judgement()
        self.from_production()
        self.inspection()

    def info(self) -> None:
        """Publish who watches which arm, with what, and since when."""
        belief = self._state.estimator.belief
        context = belief.context if belief else None
        configuration = self._state.configuration
        prior = prior_taken(configuration, self._store)
        self.say(info(configuration, started_at_unix_s=self._started_at_unix_s, context=context, prior=prior))

    def health(self) -> None:
        """Publish the states of arm and joints and whether they are too old; also before the first assessment."""
        state, belief = self._state, self._state.estimator.belief
        self.say(
            health_document(
                state.alerts,
                self._now(),
                state.configuration.assess.health,
                next_replay_due=utc_if(state.next_due_unix_s),
                nothing_learnt=state.nothing_learnt,
                production=state.production_motion.evidence(),
                ripple=(None if belief is None else joint_ripple(belief.ripple)) or (),
            )
        )

    def judgement(self) -> None:
        """Publish health, model and alerts as they are after the last assessment."""
        self.health()
        if self._state.torque_model is not None:
            self._say(documents.Model, self._state.torque_model.as_document())
            belief = self._state.estimator.belief
            if belief is not None:
                self.say(compensation(self._state.torque_model, belief))
        for alert in self._state.alerts.alerts:
            self.alert(alert)

    def friction(self, joint: "JointFriction") -> None:
        """Publish one joint after one replay."""
        self._say(documents.Friction, joint)

    def newest_friction(self, joint: int) -> None:
        """Publish what is known of one joint (from 1) after the last replay, and after work since then."""
        belief = self._state.estimator.belief
        rows = self._store.assessments.friction(joint=joint, limit=1)
        if belief is not None and rows:
            known = friction_known(rows[0], float(belief.learnt_replays[joint - 1]))
            self._say(documents.Friction, {key: value for key, value in known.items() if key != "replay"})

    def from_production(self) -> None:
        """Publish what came from the arm's ordinary work, and how far the next replay is; nothing before the first day of work."""
        document = from_production_document(self._store, self._state.estimator, self._state.configuration.schedule)
        if document is not None:
            self.say(document)

    def inspection(self) -> None:
        """Publish operating hours, stops and checks; nothing where [inspection] asks for none. Raises StoreError."""
        document = inspection_document(self._state.configuration.inspection, self._store, self._now())
        if document is not None:
            self.say(document)

    def alert(self, alert: Alert) -> None:
        """Publish the present state of one alert."""
        self.say(mended(documents.Alert, outside(plain(alert_document(alert))))[0])

    def event(self, event: AlertEvent) -> None:
        """Publish one transition; the history marks it as published once it is sent."""
        self.say(event_document(event), done=lambda: self._store.events.mark_published(event.seq))

    def replay_announced(self, number: int, about: Mapping[str, Any]) -> None:
        """Publish what is going to happen to the arm, for people nearby and the cell's own programs. about : as the gate says it."""
        self.say(made(documents.Replay, about, state="announced", replay=number, said_at=utc(self._now())))

    def replay_ended(self, row: LedgerRow) -> None:
        """Publish how a window ended."""
        now = utc(self._now())
        self.say(documents.Replay(state="ended", replay=row.id, verdict=row.state, said_at=now, **worded(reason=row.reason)))


def event_document(event: AlertEvent) -> documents.Event:
    """One transition as it is published."""
    return mended(documents.Event, outside(plain({"seq": event.seq, "at_unix_s": event.at_unix_s, **event.document})))[0]
