"""What people and ordinary work changed between two replays, done anew upon another state than that of then."""

from collections.abc import Mapping, Sequence
from typing import Any

from monitor.errors import BadInput
from monitor.judge.alerts.health import Health, Transition, alert_from_document
from monitor.judge.alerts.life_cycle import acknowledge, declare, unacknowledge
from monitor.judge.alerts.states import with_service_alert
from monitor.judge.document import plain
from monitor.judge.drift.maintenance import Maintenance
from monitor.judge.maintenance import begin_maintenance, with_new_joints
from monitor.service.history.assess_and_store import EstimatorState
from monitor.service.history.recompute import Change, judge_day
from monitor.store.history.events import AlertEvent
from monitor.store.history.maintenance import Amendment, MaintenanceRow
from monitor.store.history.production import DayOfProduction
from monitor.store.store import Store
from monitor.studies.reassess.compare import Said, of_the_monitor
from monitor.studies.reassess.settings import settings_with


class AmendAnew:
    """Declared work, days of ordinary work and what people did to alerts, each applied to the state as it would be.

    Work that was taken back counts as never declared. What a person did to an alert counts where that alert is active.
    """

    def __init__(self, store: Store, changes: Mapping[str, Any]) -> None:
        self.said: list[Said] = []
        self._store, self._changes = store, changes
        self._declared: dict[float, MaintenanceRow] = {
            row.declared_at_unix_s: row for row in store.maintenance.rows() if row.ledger_id is None and row.in_force
        }
        self._made_with = next((each.made_with for each in reversed(store.assessments.judged()) if each.made_with), None)

    def __call__(self, state: EstimatorState | None, changes: Sequence[Change]) -> EstimatorState | None:
        """The state after changes between two replays; None where it was not known."""
        for change in changes:
            if state is None:
                return None
            if isinstance(change, Amendment):
                state = self._with_declared(state, change)
            elif isinstance(change, DayOfProduction):
                state = self._with_day(state, change)
            else:
                state = self._with_person(state, change)
        return state

    def _with_declared(self, state: EstimatorState, change: Amendment) -> EstimatorState:
        row = self._declared.get(change.at_unix_s)
        if row is None or state.belief is None or state.health is None or self._made_with is None:
            return state
        kept = row.document
        act = Maintenance(kept["joint"], kept["kind"], kept["at_unix_s"], kept["declared_at_unix_s"], kept["by"], kept["why"])
        settings = settings_with(self._store.assessments.provenance(self._made_with)["settings"], self._changes)
        begun, maintenance = begin_maintenance(state.belief, (act,))
        after = with_new_joints(begun, maintenance, settings.drift, settings.temperature)
        serviced = declare(state.health, maintenance, change.at_unix_s)
        self._say(serviced.transitions)
        return EstimatorState(belief=after, health=serviced.health)

    def _with_day(self, state: EstimatorState, day: DayOfProduction) -> EstimatorState:
        if state.belief is None or state.health is None or not state.health.joints:
            return state
        settings = settings_with(self._store.assessments.provenance(day.made_with)["settings"], self._changes)
        try:
            verdict = judge_day(day, state.belief, state.health, settings)
        except BadInput:  # the period ends before what this state has learnt
            return state
        self._say(verdict.transitions)
        return EstimatorState(belief=verdict.belief, health=verdict.health)

    def _with_person(self, state: EstimatorState, event: AlertEvent) -> EstimatorState:
        document, health = event.document, state.health or Health(joints=())
        if of_the_monitor(document["condition"]):
            health = with_service_alert(health, alert_from_document(document), event.at_unix_s)
        elif (act := {"acknowledged": acknowledge, "unacknowledged": unacknowledge}.get(document["kind"])) is not None:
            try:
                by, why = document.get("by") or "unknown", document.get("why") or ""
                health = act(health, document["joint"], document["condition"], by=by, why=why, at_unix_s=event.at_unix_s)
            except BadInput:  # the alert is not active here
                return state
        return EstimatorState(belief=state.belief, health=health)

    def _say(self, transitions: Sequence[Transition]) -> None:
        self.said += [Said.of(each.kind, plain(each.alert)) for each in transitions]
