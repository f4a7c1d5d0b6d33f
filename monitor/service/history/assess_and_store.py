"""A recording becomes history: assessed with what is held true, and committed with everything that follows from it.

The daemon, `import` and the recomputation all go through here, so that what is recomputed is what ran.
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
from monitor.judge.alerts.documents import alert_document, health_from_document
from monitor.judge.alerts.health import Health
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatorState:
    """What is held true of the arm now; None before its first assessment."""

    belief: Belief | None = None
    health: Health | None = None
    model: CompensatedModel | None = None


class HistoryEntry(NamedTuple):
    """What one recording became."""

    outcome: Assessment | Rejected
    events: list[AlertEvent]
    recording: Recording | None  # None where it cannot be read


def load_state(store: Store) -> EstimatorState:
    """As the last assessment, and what people said since, left it."""
    state = store.assessments.state()
    if state is None:
        return EstimatorState()
    return EstimatorState(
        belief=belief_from_document(state.belief), health=health_from_document(state.health), model=model_from_document(state.model)
    )


def made_with(configuration: Configuration) -> dict[str, Any]:
    """Everything beside the recordings that can change a verdict: programs, processor, threads, arm and settings."""
    return {
        "programs": provenance(),
        "robot": configuration.robot.model,
        "robot_digest": robot_digest(configuration.robot_description),
        "mounting_rad": list(configuration.mounting.angles_rad),
        "gains_nm_per_a": list(configuration.robot.gains_nm_per_a),
        "settings": plain(configuration.assess),
    }


def robot_digest(robot: Robot) -> str:
    """Identifies a robot's parameters."""
    return hashlib.sha256(json.dumps(plain(robot), sort_keys=True, default=str).encode()).hexdigest()[:16]


def assess_recording(
    store: Store, configuration: Configuration, held: EstimatorState, ledger_id: int, recording: Recording, now: Callable[[], float]
) -> HistoryEntry:
    """Assess a recording that the store has, and commit what follows; a rejection ends its window with the reason.

    Raises StoreError where the history does not take it.
    """
    outcome = _outcome(recording, configuration, held, ledger_id)
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
    )
    return HistoryEntry(outcome, events, recording)


def assess_stored(
    store: Store, configuration: Configuration, held: EstimatorState, ledger_id: int, now: Callable[[], float]
) -> HistoryEntry:
    """The same for a recording that waits on disk; one that cannot be read is rejected."""
    try:
        recording = read_recording(store.recordings.path(ledger_id))
    except BadInput as error:
        store.ledger.end(ledger_id, "rejected", str(error), now())
        return HistoryEntry(Rejected(str(error)), [], None)
    return assess_recording(store, configuration, held, ledger_id, recording, now)


def adopt_orphans(store: Store, at_unix_s: float) -> int:
    """After a restored backup: recordings that the ledger does not know are entered, and wait for their assessment. Returns how many."""
    adopted = 0
    for ledger_id, path in store.ledger.orphans():
        try:
            recorded_at = read_recording(path).context.recorded_at_unix_s
        except BadInput:
            recorded_at = None
        # its window is lost; the time of the recording is its own, and no other window's
        store.ledger.adopt(ledger_id, path.stat().st_mtime if recorded_at is None else recorded_at, at_unix_s)
        adopted += 1
    return adopted


def _outcome(recording: Recording, configuration: Configuration, held: EstimatorState, ledger_id: int) -> Assessment | Rejected:
    try:
        return assess(
            recording,
            robot=configuration.robot_description,
            mounting=configuration.mounting,
            belief=held.belief,
            health=held.health,
            model=held.model,
            gains=configuration.gains_nm_per_a,
            settings=configuration.assess,
        )
    except BadInput as error:
        return Rejected(str(error))
    except Exception as error:  # a fault of ours in one recording must not end the service, now and at every start
        log.exception("replay=%d cannot be assessed", ledger_id)
        return Rejected(f"internal: {type(error).__name__}: {error}")


def state_after(before: EstimatorState, entered: HistoryEntry) -> EstimatorState:
    """What is held true after it."""
    outcome = entered.outcome
    return before if isinstance(outcome, Rejected) else EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model)
