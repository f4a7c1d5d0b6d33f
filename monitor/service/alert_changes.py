"""Changes of alerts between replays: what a person does to one, and alerts that the monitor raises about itself."""

import dataclasses
import logging
from collections.abc import Callable
from typing import Any

from monitor.errors import BadInput
from monitor.judge.alerts.condition import ServiceSituation
from monitor.judge.alerts.conditions import CONDITIONS, STORE_RESTORED
from monitor.judge.alerts.health import Alert, Health, alert_document
from monitor.judge.alerts.life_cycle import ACKNOWLEDGED_AND_OVER, service_alert, service_transition
from monitor.judge.alerts.states import with_service_alert
from monitor.publish import documents
from monitor.publish.documents import made
from monitor.publish.queries import AckRequest, InspectedRequest, ServicedRequest, UndoInspectedRequest, UndoServicedRequest
from monitor.reason import reason_of
from monitor.service.computing import ComputingFailed
from monitor.service.history.inspection import declare
from monitor.service.history.maintenance import Declared, declare_maintenance, undo_maintenance
from monitor.service.publisher import Publisher
from monitor.service.shared_state import SharedState
from monitor.store.store import RESTORED

log = logging.getLogger(__name__)


class AlertChanges:
    """Each change is durable first, and published then."""

    def __init__(self, state: SharedState, publisher: Publisher) -> None:
        self._state, self._store, self._publisher, self._now = state, state.store, publisher, state.now
        self.restored: str | None = None  # what became of a damaged history, until the alert about it is raised

    def by_person(self, kind: str, request: AckRequest, change: Callable[[Health, float], Health]) -> documents.Answer:
        """Apply what a person does to an alert; returns the answer to the command. Raises BadInput without such an active alert."""
        with self._state.revising:
            at = self._now()
            health = change(self._state.alerts, at)
            alert = next(alert for alert in health.alerts if alert.key == (request.joint, request.condition) and alert.active)
            self.keep(health, kind, alert, at, by=request.by, why=request.why)
            if kind == "acknowledged" and (
                alert.condition == STORE_RESTORED or alert.over_since_unix_s is not None
            ):  # it waited for a person alone
                gone: dict[str, Any] = {"cleared_at_unix_s": at, "updated_at_unix_s": at, "cleared_why": ACKNOWLEDGED_AND_OVER}
                self._revise_own("cleared", dataclasses.replace(alert, **gone), at)
        log.info("alert=%s/%s %s by=%r why=%r", request.joint or "arm", request.condition, kind, request.by, request.why)
        now = next((each for each in self._state.alerts.alerts if each.key == alert.key), alert)
        return documents.Answer(done=kind, alert=made(documents.Alert, alert_document(now)))

    def serviced(self, request: ServicedRequest) -> documents.Answer:
        """Declare work on a joint; returns the answer to the command. Raises BadInput where the request does not fit this arm."""
        with self._state.revising:
            declared = declare_maintenance(self._store, self._state.configuration, self._state.estimator, request, self._now())
            self._take(declared)
        log.info("joint=%d serviced kind=%s by=%r why=%r", request.joint, request.kind, request.by, request.why)
        return declared.answer

    def undo_serviced(self, request: UndoServicedRequest) -> documents.Answer:
        """Take the last declared work on a joint back; returns the answer to the command. Raises BadInput where that is not possible."""
        with self._state.revising:
            try:
                declared = undo_maintenance(self._store, self._state.estimator, request, self._now(), self._state.compute)
            except ComputingFailed as error:
                raise BadInput(f"serviced: nothing was changed, try again: {error}") from None
            self._take(declared)
        log.info("joint=%d service taken back by=%r why=%r", request.joint, request.by, request.why)
        return declared.answer

    def inspected(self, request: InspectedRequest | UndoInspectedRequest) -> documents.Answer:
        """Record a check, or take a record back; returns the answer to the command. Raises BadInput where the arm has no such check."""
        answer = declare(self._store, self._state.configuration.inspection, request, self._now())
        log.info("check=%r %s by=%r why=%r", request.item, answer.done, request.by, request.why)
        self._publisher.inspection()
        return answer

    def _take(self, declared: Declared) -> None:
        """Take the state after work, and publish what it changed. The caller holds `revising`."""
        self._state.estimator = declared.state
        assert declared.answer.maintenance is not None
        self._publisher.say(declared.answer.maintenance)
        self._publisher.newest_friction(declared.answer.maintenance.joint)
        for alert in declared.alerts:
            self._publisher.alert(alert)
        self._publisher.health()
        for event in declared.events:
            self._publisher.event(event)

    def read_restored(self) -> None:
        """Read what became of a damaged history, also where the last start ended before the alert was raised."""
        self.restored = self._store.notes.get(RESTORED) or None

    def raise_restored(self) -> None:
        """Raise what became of a damaged history, as soon as there is an assessment beside which the alert can stand."""
        if self.restored is None or self._state.health is None:
            return
        if all(alert.condition != STORE_RESTORED for alert in self._state.health.active_alerts):  # a crash may have come before the note
            self._raise_own(STORE_RESTORED, self.restored)
        self._store.notes.set(RESTORED, "")
        self.restored = None

    def look(self, situation: ServiceSituation) -> None:
        """Raise, update and clear the alerts that the monitor raises about itself. Raises StoreError.

        Without effect while a verdict is computed: that may take minutes, and the main loop, which looks again soon, is not to be missed.
        """
        if self._state.revising.locked():
            return
        self.raise_restored()
        with self._state.revising:
            known = {alert.key: alert for alert in self._state.alerts.alerts}
            for condition in CONDITIONS.values():
                if condition.service is not None:
                    transition = service_transition(known.get((None, condition.name)), condition, situation)
                    if transition is not None:
                        self._revise_own(*transition, situation.now_unix_s)
            self._clear_acknowledged(situation)

    def _clear_acknowledged(self, situation: ServiceSituation) -> None:
        """Clear what no predicate describes, once somebody has acknowledged it."""
        at = situation.now_unix_s
        for alert in self._state.alerts.active_alerts:
            if alert.condition == STORE_RESTORED and alert.acknowledged_at_unix_s is not None:
                gone: dict[str, Any] = {"cleared_at_unix_s": at, "updated_at_unix_s": at, "cleared_why": ACKNOWLEDGED_AND_OVER}
                self._revise_own("cleared", dataclasses.replace(alert, **gone), at)

    def keep(self, health: Health, kind: str, alert: Alert, at: float, *, by: str | None = None, why: str | None = None) -> None:
        """Make a changed alert durable with its health, then publish both. The caller holds `revising`. Raises StoreError.

        by, why : of the person who changed it; None where nobody did.
        """
        events = self._store.events.revise(health.as_document(), [{"kind": kind, **alert_document(alert), "by": by, "why": why}], at)
        self._state.estimator = dataclasses.replace(self._state.estimator, health=health)
        self._publisher.alert(alert)
        self._publisher.health()
        for event in events:
            self._publisher.event(event)

    def _raise_own(self, condition: str, text: str) -> None:
        with self._state.revising:
            at = self._now()
            self._revise_own("raised", service_alert(CONDITIONS[condition], reason_of(text), at), at)

    def _revise_own(self, kind: str, alert: Alert, at: float) -> None:
        self.keep(with_service_alert(self._state.alerts, alert, at), kind, alert, at)
        (log.info if kind == "cleared" else log.warning)(
            "alert=arm/%s %s: %s", alert.condition, kind, alert.text, extra={"alert": f"arm/{alert.condition}"}
        )
