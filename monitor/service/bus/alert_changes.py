"""Changes of alerts between replays: what a person does to one, and alerts that the monitor raises about itself."""

import dataclasses
import logging
from collections.abc import Callable
from typing import Any

from monitor.errors import BadInput
from monitor.judge.alerts.conditions import CONDITIONS, NOTHING_LEARNT, STORE_RESTORED
from monitor.judge.alerts.documents import alert_document
from monitor.judge.alerts.health import Alert, Health
from monitor.judge.alerts.life_cycle import service_alert
from monitor.publish.documents import AckRequest
from monitor.publish.timestamps import outside
from monitor.service.bus.publisher import Publisher
from monitor.service.learning import nothing_learnt
from monitor.service.shared_state import SharedState
from monitor.store.store import RESTORED, Store

log = logging.getLogger(__name__)


class AlertChanges:
    """Each change is durable first, and published then."""

    def __init__(self, state: SharedState, store: Store, publisher: Publisher, now: Callable[[], float]) -> None:
        self._state, self._store, self._publisher, self._now = state, store, publisher, now
        self.restored: str | None = None  # what became of a damaged history, until the alert about it is raised

    def by_person(self, kind: str, request: AckRequest, change: Callable[[Health, float], Health]) -> dict[str, Any]:
        """Apply what a person does to an alert; returns the answer to the command. Raises BadInput without such an active alert."""
        with self._state.revising:
            at = self._now()
            if self._state.health is None:
                raise BadInput(f"cmd: no alert can be {kind}: no replay has been assessed yet")
            health = change(self._state.health, at)
            alert = next(alert for alert in health.alerts if alert.key == (request.joint, request.condition) and alert.active)
            self.keep(health, kind, alert, at)
        log.info("alert=%s/%s %s by=%r why=%r", request.joint or "arm", request.condition, kind, request.by, request.why)
        return {"done": kind, "alert": outside(alert_document(alert))}

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

    def clear_own(self) -> None:
        """Clear every alert that the monitor raised about itself and a person has acknowledged. Raises StoreError."""
        self.raise_restored()
        with self._state.revising:
            at = self._now()
            raised_by_service = {name for name, condition in CONDITIONS.items() if condition.raised_by_service}
            for alert in self._state.health.active_alerts if self._state.health else ():
                lasts = alert.condition == NOTHING_LEARNT and self._state.nothing_learnt is not None
                if alert.condition in raised_by_service and alert.acknowledged_at_unix_s is not None and not lasts:
                    self._revise_own("cleared", dataclasses.replace(alert, cleared_at_unix_s=at, updated_at_unix_s=at), at)

    def look_at_learning(self) -> str | None:
        """For how long nothing was learnt, where that is too long; the alert about it is raised once. Raises StoreError.

        The alert stands beside an assessment: before the first one the text stands in `health` and among the problems alone.
        """
        text = nothing_learnt(self._state.configuration.schedule, self._store, self._now())
        self._state.take_nothing_learnt(text)
        health = self._state.health
        if text is not None and health is not None and all(alert.condition != NOTHING_LEARNT for alert in health.active_alerts):
            self._raise_own(NOTHING_LEARNT, text)
        return text

    def keep(self, health: Health, kind: str, alert: Alert, at: float) -> None:
        """Make a changed alert durable with its health, then publish both. The caller holds `revising`. Raises StoreError."""
        events = self._store.events.revise(health.as_document(), [{"kind": kind, **alert_document(alert)}], at)
        self._state.take_health(health)
        self._publisher.alert(alert)
        self._publisher.health()
        for event in events:
            self._publisher.event(event)

    def _raise_own(self, condition: str, text: str) -> None:
        with self._state.revising:
            at = self._now()
            self._revise_own("raised", service_alert(CONDITIONS[condition], text, at), at)

    def _revise_own(self, kind: str, alert: Alert, at: float) -> None:
        assert self._state.health is not None
        others = tuple(other for other in self._state.health.alerts if other.key != alert.key)
        self.keep(dataclasses.replace(self._state.health, alerts=(*others, alert)), kind, alert, at)
