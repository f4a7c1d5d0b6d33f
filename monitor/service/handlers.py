"""The answers to queries on the bus: torque, history, transitions, and the commands of people."""

import logging
from base64 import b64encode
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import ValidationError

from monitor.errors import BadInput
from monitor.judge.alerts.health import Health
from monitor.judge.alerts.life_cycle import acknowledge, shelve, unacknowledge, unshelve
from monitor.publish import documents
from monitor.publish.bus import QueryHandler, handler
from monitor.publish.documents import Document
from monitor.publish.queries import (
    MOST_EVENTS,
    AckRequest,
    InspectedRequest,
    ReplayRequest,
    Request,
    ServicedRequest,
    ShelveRequest,
    UnackRequest,
    UndoInspectedRequest,
    UndoServicedRequest,
    UnshelveRequest,
    events_question,
    history_question,
    request,
)
from monitor.publish.timestamps import rfc3339, utc
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
        commands: dict[str, tuple[type[Request], Callable[[Any], documents.Answer]]] = {
            "cmd/ack": (AckRequest, self.acknowledge),
            "cmd/unack": (UnackRequest, self.unacknowledge),
            "cmd/shelve": (ShelveRequest, self.shelve),
            "cmd/unshelve": (UnshelveRequest, self.unshelve),
            "cmd/serviced": (ServicedRequest, self._alerts.serviced),
            "cmd/unserviced": (UndoServicedRequest, self._alerts.undo_serviced),
            "cmd/inspected": (InspectedRequest, self._alerts.inspected),
            "cmd/uninspected": (UndoInspectedRequest, self._alerts.inspected),
            "cmd/replay": (ReplayRequest, self.replay),
        }
        answers: dict[str, Callable[[Mapping[str, Any]], Document]] = {"torque": self.torque, "history": self.history, "event": self.events}
        answers |= {key: _command(model, key, act) for key, (model, act) in commands.items()}
        return {key: handler(key, about) for key, about in answers.items()}

    def torque(self, payload: Mapping[str, Any]) -> documents.Torque:
        """Temperature-corrected torque of the samples asked for."""
        model = self._state.torque_model  # one read: a replay may put another in its place meanwhile
        if model is None:
            raise BadInput("torque: there is no model yet; it comes with the first replay that is assessed")
        return torque_answer(model, self._state.robot, self._state.temperature_c, payload)

    def history(self, parameters: Mapping[str, Any]) -> documents.History:
        """One page of past estimates, or of their changes."""
        question = history_question(parameters, self._state.robot.joints)
        if question.changed_after is not None:
            return self._changes(question.changed_after, question.limit)
        if question.stored_after is not None:
            return self._stored(question.stored_after, question.limit)
        rows, following = self._store.assessments.history(
            joint=question.joint, from_unix_s=question.from_unix_s, to_unix_s=question.to_unix_s, after=question.after, limit=question.limit
        )
        for row in rows:  # their one time; five years of them are asked for at once
            row["recorded_at"] = rfc3339(row.pop("recorded_at_unix_s"))
        try:
            return documents.History.model_validate({"rows": rows, "next": following})
        except ValidationError:
            found, aside = documents.rows_of(rows)
            return documents.History(rows=found, next=following, set_aside=aside)

    def _changes(self, after: int, limit: int) -> documents.History:
        """One page of changes; `limit` counts rows, about, as of any page."""
        identity = self._store.changes.history_id()  # before the rows: a restoration in between would give them another one's name
        page, following = self._store.changes.after(after, max(limit // self._state.robot.joints, 1))
        rows: dict[int, list[dict[str, Any]]] = {}
        for replay, joint, at, document in self._store.assessments.friction_of(sorted({replay for _, replay, _ in page})):
            rows.setdefault(replay, []).append({**document, "replay": replay, "joint": joint, "recorded_at": rfc3339(at)})
        changes = []
        for seq, replay, at in page:
            found, aside = documents.rows_of(rows.get(replay, []))
            changes.append(documents.HistoryChange(seq=seq, replay=replay, at=utc(at), rows=found, set_aside=aside))
        return documents.History(rows=[], next=following, changes=changes, history_id=identity)

    def _stored(self, after: int, limit: int) -> documents.History:
        """One page of rows as they are stored."""
        identity = self._store.changes.history_id()  # before the rows, as above
        page, following = self._store.stored.after(after, limit)
        rows = [
            documents.StoredRow(seq=seq, table=table, row=row, content=None if content is None else b64encode(content).decode())
            for seq, table, row, content in page
        ]
        return documents.History(rows=[], next=following, stored=rows, history_id=identity)

    def events(self, parameters: Mapping[str, Any]) -> documents.Events:
        """The newest transitions after a number, or a page of the oldest ones."""
        after, limit = events_question(parameters)
        kept, following = self._store.events.range(), None
        if limit is None:
            found = self._store.events.rows(after=after, limit=MOST_EVENTS)
        else:
            found, following = self._store.events.page(after, limit)
        return documents.Events(
            events=[event_document(event) for event in found],
            first_kept=kept[0] if kept else None,
            last=kept[1] if kept else None,
            next=following,
            history_id=self._store.changes.history_id(),
        )

    def acknowledge(self, command: AckRequest) -> documents.Answer:
        """A person has seen an alert."""

        def change(health: Health, at: float) -> Health:
            return acknowledge(health, command.joint, command.condition, by=command.by, why=command.why, at_unix_s=at)

        return self._alerts.by_person("acknowledged", command, change)

    def shelve(self, command: ShelveRequest) -> documents.Answer:
        """A person does not want to be shown an alert for some hours."""

        def change(health: Health, at: float) -> Health:
            until = at + 3600.0 * command.hours
            return shelve(health, command.joint, command.condition, by=command.by, why=command.why, until_unix_s=until, at_unix_s=at)

        return self._alerts.by_person("shelved", command, change)

    def unacknowledge(self, command: UnackRequest) -> documents.Answer:
        """A person takes the acknowledgements of an alert back."""

        def change(health: Health, at: float) -> Health:
            return unacknowledge(health, command.joint, command.condition, by=command.by, why=command.why, at_unix_s=at)

        return self._alerts.by_person("unacknowledged", command, change)

    def unshelve(self, command: UnshelveRequest) -> documents.Answer:
        """A person wants to be shown an alert again before its shelving ends."""

        def change(health: Health, at: float) -> Health:
            return unshelve(health, command.joint, command.condition, by=command.by, at_unix_s=at)

        return self._alerts.by_person("unshelved", command, change)

    def replay(self, command: ReplayRequest) -> documents.Answer:
        """A person asks for a replay; conditions, guard and permit decide as for any other."""
        if self._state.configuration.replay.allow_motion is not True:
            raise BadInput("cmd/replay: refused: motion is not allowed here (allow_motion is false)")
        if self._state.requests is None:
            raise BadInput("cmd/replay: refused: this monitor schedules no replays")
        if self._state.replaying.locked():
            raise BadInput("cmd/replay: refused: a replay is under way")
        self._state.requests.request()
        log.info("replay wanted by=%r why=%r", command.by, command.why)
        return documents.Answer(done="accepted")


def _command(model: type[Request], key: str, act: Callable[[Any], documents.Answer]) -> Callable[[Mapping[str, Any]], documents.Answer]:
    """The handler that reads the payload of a command first."""
    return lambda payload: act(request(model, key, payload))
