"""Recompute past assessments from the recordings that the store has kept, and name every difference and its possible causes."""

import math
from collections import deque
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from monitor.assess import AssessSettings, Rejected, assess, model_after
from monitor.errors import BadInput
from monitor.judge.alerts.documents import alert_from_document, health_from_document
from monitor.judge.alerts.health import Health
from monitor.judge.alerts.states import with_service_alert
from monitor.judge.assessment import Assessment
from monitor.judge.belief import Belief, belief_from_document
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.model.robot import Mounting, Robot, load_robot
from monitor.recording import Array, Recording
from monitor.service.history.assess_and_store import EstimatorState, robot_digest
from monitor.store.assessments import StoredAssessment
from monitor.store.events import AlertEvent
from monitor.store.provenance import differences, provenance
from monitor.store.recordings import read_recording
from monitor.store.store import Store
from monitor.store.works import Amendment

MOST_LISTED = 20  # assessments in the list of differences, and figures of each


class _Inputs(NamedTuple):
    """The inputs of one past assessment."""

    recording: Recording
    robot: Robot
    mounting: Mounting
    gains: Array | None
    settings: AssessSettings


@dataclass(slots=True)
class _Tally:
    identical: int = 0
    different: int = 0
    gone: int = 0
    unknown: int = 0


def recompute(store: Store) -> dict[str, Any]:
    """Repeat every assessment from its recording, with its own settings, in the original order.

    The document counts the assessments that are identical to the last bit, lists the others with their differences, and names what has
    changed since they were made. An assessment whose recording was pruned cannot be repeated; the next checkpoint continues the series.
    """
    state: EstimatorState | None = EstimatorState()  # None: not known until the next checkpoint
    tally = _Tally()
    differing: list[dict[str, Any]] = []
    changed: dict[str, None] = {}
    changes = deque(_changes(store))
    for verdict in store.assessments.rows():
        between = []
        while changes and changes[0].at_unix_s < verdict.judged_at_unix_s:
            between.append(changes.popleft())
        state = _amended(store, state, between)
        outcome, why = (None, "") if state is None else _repeated(store, verdict, state)
        if verdict.made_with is None:
            tally.unknown += 1
        else:
            made_with = store.assessments.provenance(verdict.made_with)
            changed |= dict.fromkeys(differences(made_with["programs"], provenance()))
            if made_with["robot_digest"] != robot_digest(load_robot(made_with["robot"])):
                changed |= {f"parameters of the {made_with['robot']}": None}
        if isinstance(outcome, Assessment):
            wrong = differences(verdict.document, outcome.as_document())
            tally.identical += not wrong
            tally.different += bool(wrong)
            if wrong and len(differing) < MOST_LISTED:
                differing.append({"replay": verdict.ledger_id, "figures": len(wrong), "differs": wrong[:MOST_LISTED]})
            state = EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model)
        elif state is not None and why and not why.startswith("gone"):
            tally.different += 1
            differing.append({"replay": verdict.ledger_id, "figures": 1, "differs": [why]})
            state = None
        else:
            tally.gone += 1
            state = None
        if state is None and (kept := store.assessments.checkpoint(verdict.ledger_id)) is not None:
            state = EstimatorState(belief=belief_from_document(kept[0]), health=health_from_document(kept[1]))
    return {
        "assessments": tally.identical + tally.different + tally.gone,
        "identical": tally.identical,
        "different": tally.different,
        "not_recomputable": tally.gone,
        "unknown_circumstances": tally.unknown,
        "changed_since": list(changed),
        "differing": differing,
        "circumstances": provenance(),
    }


def _repeated(store: Store, verdict: StoredAssessment, state: EstimatorState) -> tuple[Assessment | None, str]:
    """The assessment once more; None with the reason where that is not possible."""
    made, why = _inputs(store, verdict)
    if made is None:
        return None, why
    try:
        outcome = assess(
            made.recording,
            robot=made.robot,
            mounting=made.mounting,
            belief=state.belief,
            health=state.health,
            model=state.model,
            gains=made.gains,
            settings=made.settings,
        )
    except BadInput as error:
        return None, f"cannot be assessed any more: {error}"
    return (None, f"is rejected now: {outcome.reason}") if isinstance(outcome, Rejected) else (outcome, "")


def _inputs(store: Store, verdict: StoredAssessment) -> tuple[_Inputs | None, str]:
    """The inputs of a past assessment; None with the reason where they are gone."""
    try:
        recording = read_recording(store.recordings.path(verdict.ledger_id))
    except BadInput as error:
        return None, f"gone: {error}"
    if verdict.made_with is None:
        return None, "gone: made before the settings of a verdict were kept with it"
    with_ = store.assessments.provenance(verdict.made_with)
    gains = with_["gains_nm_per_a"]
    return _Inputs(
        recording=recording,
        robot=load_robot(with_["robot"]),
        mounting=Mounting.of(with_["mounting_rad"]),
        gains=np.array(gains) if gains else None,
        settings=settings_from_document(AssessSettings, with_["settings"]),
    ), ""


def _model_of(store: Store, verdict: StoredAssessment, belief: Belief) -> CompensatedModel | None:
    """The torque model after a past assessment, which a checkpoint does not hold; None where the recording is gone."""
    made, _ = _inputs(store, verdict)
    if made is None:
        return None
    try:
        return model_after(made.recording, belief, robot=made.robot, mounting=made.mounting, gains=made.gains, settings=made.settings)
    except BadInput:
        return None


def roll_back(store: Store, now_unix_s: float) -> EstimatorState | None:
    """Take back every assessment dated later than now: those replays become rejected, and windows skipped then open again.

    Returns the estimator's state without them. Returns None and changes nothing where the recordings that this needs are gone.
    """
    verdicts = [verdict for verdict in store.assessments.rows() if verdict.recorded_at_unix_s <= now_unix_s]
    known, start = EstimatorState(), 0
    for k in range(len(verdicts) - 2, -1, -1):  # at least one assessment is repeated, since a checkpoint holds no torque model
        if (kept := store.assessments.checkpoint(verdicts[k].ledger_id)) is not None:
            belief = belief_from_document(kept[0])
            known = EstimatorState(belief=belief, health=health_from_document(kept[1]), model=_model_of(store, verdicts[k], belief))
            start = k + 1
            break
    changes = _changes(store)
    since = verdicts[start - 1].judged_at_unix_s if start else -math.inf
    for verdict in verdicts[start:]:
        between = [change for change in changes if since <= change.at_unix_s < verdict.judged_at_unix_s]
        outcome, _ = _repeated(store, verdict, _amended(store, known, between) or known)
        if outcome is None:
            return None
        known = EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model)
        since = verdict.judged_at_unix_s
    documents = None
    if known.belief is not None and known.health is not None and known.model is not None:
        documents = (known.belief.as_document(), known.health.as_document(), known.model.as_document())
    store.assessments.roll_back(now_unix_s, documents)
    return known


def repeated_since(store: Store, start: EstimatorState, since_unix_s: float, most: int) -> tuple[EstimatorState, int]:
    """The state after the replays that were judged since a time, judged once more from `start`; and how many they are.

    Raises BadInput where there are more than `most`, or a recording that this needs is gone.
    """
    verdicts = [verdict for verdict in store.assessments.rows() if verdict.judged_at_unix_s >= since_unix_s]
    if len(verdicts) > most:
        raise BadInput(
            f"{len(verdicts)} replays have been learnt from since, too many to judge them once more (at most {most}): it cannot "
            "be taken back. The joint's friction counts from then; what was found before stays in the history"
        )
    state = start
    for verdict in verdicts:
        outcome, why = _repeated(store, verdict, state)
        if outcome is None:
            raise BadInput(f"replay {verdict.ledger_id} has been learnt from since, and cannot be judged once more: {why}")
        state = EstimatorState(belief=outcome.belief, health=outcome.health, model=start.model)
    return state, len(verdicts)


def _changes(store: Store) -> list[AlertEvent | Amendment]:
    """What people and the monitor itself changed between replays, in order: a state is amended before the transitions that followed."""
    changes: list[AlertEvent | Amendment] = [event for event in store.events.rows() if event.ledger_id is None]
    return sorted([*store.works.amendments(), *changes], key=lambda change: change.at_unix_s)


def _amended(store: Store, state: EstimatorState | None, changes: list[AlertEvent | Amendment]) -> EstimatorState | None:
    """The state after changes between two replays; None where it is not known. An amendment holds it as it was."""
    for change in changes:
        if isinstance(change, Amendment):
            belief, health = store.works.amended(change)
            model = None if state is None else state.model
            state = EstimatorState(belief=belief_from_document(belief), health=health_from_document(health), model=model)
        elif state is not None:
            state = _with_alert_changes(state, [change])
    return state


def _with_alert_changes(state: EstimatorState, events: list[AlertEvent]) -> EstimatorState:
    """The state with the alerts as people and the monitor itself changed them between two replays: the next assessment starts from it."""
    if not events:
        return state
    health = state.health or Health(joints=())
    for event in events:
        health = with_service_alert(health, alert_from_document(event.document), event.at_unix_s)
    return EstimatorState(belief=state.belief, health=health, model=state.model)


def settings_from_document(cls: Any, document: dict[str, Any]) -> Any:
    """A room's settings from their plain document; a setting that a later version has added takes its default."""
    hints = get_type_hints(cls)
    values: dict[str, Any] = {}
    for field in fields(cls):
        if field.name not in document:
            continue
        hint, value = hints[field.name], document[field.name]
        if isinstance(hint, type) and is_dataclass(hint):
            value = settings_from_document(hint, value)
        elif get_origin(hint) is tuple and get_args(hint):
            value = tuple(value)
        values[field.name] = value
    return cls(**values)
