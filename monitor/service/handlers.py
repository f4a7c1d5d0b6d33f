"""The answers to queries on the bus: torque, history, transitions, and the commands of people."""

import logging
from collections.abc import Mapping
from typing import Any

from monitor.errors import BadInput
from monitor.judge.alerts.health import Health
from monitor.judge.alerts.life_cycle import acknowledge, shelve, unacknowledge, unshelve
from monitor.publish.bus import QueryHandler, handler
from monitor.publish.documents import (
    AckRequest,
    InspectedRequest,
    ReplayRequest,
    ServicedRequest,
    ShelveRequest,
    UnackRequest,
    UndoInspectedRequest,
    UndoServicedRequest,
    UnshelveRequest,
)
from monitor.publish.queries import MOST_EVENTS, events_question, history_question, request
from monitor.publish.timestamps import rfc3339
from monitor.publish.torque import torque_answer
from monitor.service.alert_changes import AlertChanges
from monitor.service.publisher import event_document
from monitor.service.shared_state import SharedState

log = logging.getLogger(__name__)


class Handlers:
    """Each method answers one key; it raises BadInput with the text of the error reply."""

    def __init__(self, state: SharedState, alerts: AlertChanges) -> None:
        self._state, self._store, self._alerts = state, state.store, alerts

    def by_key(self) -> dict[str, QueryHandler]:
        """All of them, by key below the robot's prefix."""
        answers = {
            "torque": self.torque,
            "history": self.history,
            "event": self.events,
            "cmd/ack": self.acknowledge,
            "cmd/unack": self.unacknowledge,
            "cmd/shelve": self.shelve,
            "cmd/unshelve": self.unshelve,
            "cmd/serviced": self.serviced,
            "cmd/unserviced": self.undo_serviced,
            "cmd/inspected": self.inspected,
            "cmd/uninspected": self.undo_inspected,
            "cmd/replay": self.replay,
        }
        return {key: handler(key, about) for key, about in answers.items()}

    def torque(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """Temperature-corrected torque of the samples asked for."""
        model = self._state.torque_model  # one read: a replay may put another in its place meanwhile
        if model is None:
            raise BadInput("torque: there is no model yet; it comes with the first replay that is assessed")
        return torque_answer(model, self._state.robot, self._state.temperature_c, payload)

    def history(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """One page of past estimates, or of their changes."""
        question = history_question(parameters, self._state.robot.joints)
        if question.changed_after is not None:
            return self._changes(question.changed_after, question.limit)
        rows, following = self._store.assessments.history(
            joint=question.joint, from_unix_s=question.from_unix_s, to_unix_s=question.to_unix_s, after=question.after, limit=question.limit
        )
        for row in rows:  # their one time; five years of them are asked for at once
            row["recorded_at"] = rfc3339(row.pop("recorded_at_unix_s"))
        return {"rows": rows, "next": following}

    def _changes(self, after: int, limit: int) -> dict[str, Any]:
        """One page of changes; `limit` counts rows, about, as of any page."""
        identity = self._store.changes.history_id()  # before the rows: a restoration in between would give them another one's name
        page, following = self._store.changes.after(after, max(limit // self._state.robot.joints, 1))
        rows: dict[int, list[dict[str, Any]]] = {}
        for replay, joint, at, document in self._store.assessments.friction_of(sorted({replay for _, replay, _ in page})):
            rows.setdefault(replay, []).append({**document, "replay": replay, "joint": joint, "recorded_at": rfc3339(at)})
        changes = [{"seq": seq, "replay": replay, "at": rfc3339(at), "rows": rows.get(replay, [])} for seq, replay, at in page]
        return {"rows": [], "next": following, "changes": changes, "history_id": identity}

    def events(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """The newest transitions after a number, or a page of the oldest ones."""
        after, limit = events_question(parameters)
        kept, following = self._store.events.range(), None
        if limit is None:
            found = self._store.events.rows(after=after, limit=MOST_EVENTS)
        else:
            found, following = self._store.events.page(after, limit)
        return {
            "events": [event_document(event) for event in found],
            "first_kept": kept[0] if kept else None,
            "last": kept[1] if kept else None,
            "next": following,
            "history_id": self._store.changes.history_id(),
        }

    def acknowledge(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person has seen an alert."""
        command = request(AckRequest, payload)

        def change(health: Health, at: float) -> Health:
            return acknowledge(health, command.joint, command.condition, by=command.by, why=command.why, at_unix_s=at)

        return self._alerts.by_person("acknowledged", command, change)

    def shelve(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person does not want to be shown an alert for some hours."""
        command = request(ShelveRequest, payload)

        def change(health: Health, at: float) -> Health:
            until = at + 3600.0 * command.hours
            return shelve(health, command.joint, command.condition, by=command.by, why=command.why, until_unix_s=until, at_unix_s=at)

        return self._alerts.by_person("shelved", command, change)

    def unacknowledge(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person takes the acknowledgements of an alert back."""
        command = request(UnackRequest, payload)

        def change(health: Health, at: float) -> Health:
            return unacknowledge(health, command.joint, command.condition, by=command.by, why=command.why, at_unix_s=at)

        return self._alerts.by_person("unacknowledged", command, change)

    def unshelve(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person wants to be shown an alert again before its shelving ends."""
        command = request(UnshelveRequest, payload)

        def change(health: Health, at: float) -> Health:
            return unshelve(health, command.joint, command.condition, by=command.by, at_unix_s=at)

        return self._alerts.by_person("unshelved", command, change)

    def serviced(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person declares work on a joint."""
        return self._alerts.serviced(request(ServicedRequest, payload))

    def undo_serviced(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person takes the last declared work on a joint back."""
        return self._alerts.undo_serviced(request(UndoServicedRequest, payload))

    def inspected(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person records a check."""
        return self._alerts.inspected(request(InspectedRequest, payload))

    def undo_inspected(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person takes the last record of a check back."""
        return self._alerts.inspected(request(UndoInspectedRequest, payload))

    def replay(self, payload: Mapping[str, Any]) -> dict[str, Any]:
        """A person asks for a replay; conditions, guard and permit decide as for any other."""
        command = request(ReplayRequest, payload)
        if self._state.configuration.replay.allow_motion is not True:
            raise BadInput("cmd/replay: refused: motion is not allowed here (allow_motion is false)")
        if self._state.requests is None:
            raise BadInput("cmd/replay: refused: this monitor schedules no replays")
        if self._state.replaying.locked():
            raise BadInput("cmd/replay: refused: a replay is under way")
        self._state.requests.request()
        log.info("replay wanted by=%r why=%r", command.by, command.why)
        return {"done": "accepted"}
