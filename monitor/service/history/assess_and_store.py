"""Assess a recording with the estimator's present state, and commit the result with everything that follows from it.

The daemon and `import` both use these functions, and the recomputation repeats them: it recomputes what was run.
"""

import hashlib
import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from monitor.assess import Rejected, assess
from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.judge.alerts.documents import alert_document, alert_from_document, health_from_document
from monitor.judge.alerts.health import Alert, Health
from monitor.judge.assessment import Assessment
from monitor.judge.belief import Belief, belief_from_document
from monitor.judge.document import plain
from monitor.judge.torque.compensated_model import CompensatedModel, model_from_document
from monitor.model.robot import Robot
from monitor.recording import Recording
from monitor.store.events import AlertEvent
from monitor.store.provenance import provenance
from monitor.store.recordings import read_recording
from monitor.store.store import Store

log = logging.getLogger(__name__)

NOT_IDENTIFIED = frozenset({"endless"})  # came later: with it the digests of stored verdicts would all differ


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatorState:
    """The estimator's state of one arm; each part is None before the first assessment, but for a health with early alerts alone."""

    belief: Belief | None = None
    health: Health | None = None
    model: CompensatedModel | None = None


class HistoryEntry(NamedTuple):
    """The outcome of one recording, as it entered the history."""

    outcome: Assessment | Rejected
    events: list[AlertEvent]
    recording: Recording | None  # None where the file cannot be read


def load_state(store: Store) -> EstimatorState:
    """The state after the last assessment, with the alerts as people and the service have changed them since."""
    state = store.assessments.state()
    if state is None:
        early = early_alerts(store)
        return EstimatorState(health=Health(joints=(), alerts=early) if early else None)
    return EstimatorState(
        belief=belief_from_document(state.belief), health=health_from_document(state.health), model=model_from_document(state.model)
    )


def early_alerts(store: Store) -> tuple[Alert, ...]:
    """The alerts that the service has raised before the first assessment."""
    return tuple(alert_from_document(document) for document in store.events.early_alerts())


def made_with(configuration: Configuration) -> dict[str, Any]:
    """The provenance of a verdict: everything besides recordings that can change it: programs, processor, threads, arm and settings."""
    return {
        "programs": provenance(),
        "robot": configuration.robot.model,
        "robot_digest": robot_digest(configuration.robot_description),
        "mounting_rad": list(configuration.mounting.angles_rad),
        "gains_nm_per_a": list(configuration.robot.gains_nm_per_a),
        "settings": plain(configuration.assess),
    }


def robot_digest(robot: Robot) -> str:
    """16 hexadecimal digits that identify a robot's parameters: of those, all that an identification depends on."""
    parameters = {name: value for name, value in plain(robot).items() if name not in NOT_IDENTIFIED}
    return hashlib.sha256(json.dumps(parameters, sort_keys=True, default=str).encode()).hexdigest()[:16]


def assess_recording(
    store: Store, configuration: Configuration, state: EstimatorState, ledger_id: int, recording: Recording, now: Callable[[], float]
) -> HistoryEntry:
    """Assess a recording that the store holds, and commit the result; a rejection ends its window with the reason.

    Raises StoreError where the history cannot be written.
    """
    outcome = _outcome(recording, configuration, state, ledger_id)
    if isinstance(outcome, Rejected):
        store.ledger.end(ledger_id, "rejected", outcome.reason, now())
        return HistoryEntry(outcome, [], recording)
    events = store.assessments.commit(
        ledger_id,
        at_unix_s=now(),
        recorded_at_unix_s=recording.context.recorded_at_unix_s or now(),
        assessment=outcome.as_document(),
        friction=[plain(joint) for joint in outcome.friction],
        belief=outcome.belief.as_document(),
        health=outcome.health.as_document(),
        model=outcome.model.as_document(),
        events=[{"kind": transition.kind, **alert_document(transition.alert)} for transition in outcome.transitions],
        made_with=made_with(configuration),
        works=[plain(work) for work in outcome.works],
    )
    return HistoryEntry(outcome, events, recording)


def assess_stored(
    store: Store, configuration: Configuration, state: EstimatorState, ledger_id: int, now: Callable[[], float]
) -> HistoryEntry:
    """Assess a recording that waits on disk, as `assess_recording`. One that cannot be read is rejected."""
    try:
        recording = read_recording(store.recordings.path(ledger_id))
    except BadInput as error:
        store.ledger.end(ledger_id, "rejected", str(error), now())
        return HistoryEntry(Rejected(str(error)), [], None)
    return assess_recording(store, configuration, state, ledger_id, recording, now)


def adopt_orphans(store: Store, at_unix_s: float) -> int:
    """Enter the recordings that the ledger does not hold, as after a restored backup; they wait for their assessment. Returns how many."""
    adopted = 0
    for ledger_id, path in store.ledger.orphans():
        try:
            recorded_at = read_recording(path).context.recorded_at_unix_s
        except BadInput:
            recorded_at = None
        # its window is lost; the recording's own time stands in, which is no other window's
        store.ledger.adopt(ledger_id, path.stat().st_mtime if recorded_at is None else recorded_at, at_unix_s)
        adopted += 1
    return adopted


def _outcome(recording: Recording, configuration: Configuration, state: EstimatorState, ledger_id: int) -> Assessment | Rejected:
    try:
        return assess(
            recording,
            robot=configuration.robot_description,
            mounting=configuration.mounting,
            belief=state.belief,
            health=state.health,
            model=state.model,
            gains=configuration.gains_nm_per_a,
            settings=configuration.assess,
        )
    except BadInput as error:
        return Rejected(str(error))
    except Exception as error:  # an error of this program in one recording must not end the service, now and at every start
        log.exception("replay=%d cannot be assessed", ledger_id)
        return Rejected(f"internal: {type(error).__name__}: {error}")


def state_after(before: EstimatorState, entered: HistoryEntry) -> EstimatorState:
    """The estimator's state after this recording; a rejected one leaves it unchanged."""
    outcome = entered.outcome
    return before if isinstance(outcome, Rejected) else EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model)
