"""Every past verdict once more, from the recordings that the store has kept: identical, or what changed it is said."""

import math
from collections import deque
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from monitor.assess import AssessSettings, Rejected, assess, model_after
from monitor.errors import BadInput
from monitor.judge.alerts.documents import alert_from_document, health_from_document
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

MOST_TOLD = 20  # verdicts that differ, each with what differs


class _Made(NamedTuple):
    """What a verdict was made of."""

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
    """Take every assessment from its recording again, with its own settings, in the order in which they were made.

    The document says how many came out the same to the last bit, which did not and in what, and what has changed since they were made.
    A verdict whose recording retention has removed cannot be recomputed; those after it go on from the next checkpoint.
    """
    held: EstimatorState | None = EstimatorState()  # None: unknown until the next checkpoint
    tally = _Tally()
    differing: list[dict[str, Any]] = []
    changed: dict[str, None] = {}
    words = deque(event for event in store.events.rows() if event.ledger_id is None)
    for verdict in store.assessments.rows():
        told = []
        while words and words[0].at_unix_s < verdict.judged_at_unix_s:
            told.append(words.popleft())
        outcome, why = (None, "") if held is None else _again(store, verdict, _with_words(held, told))
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
            if wrong and len(differing) < MOST_TOLD:
                differing.append({"replay": verdict.ledger_id, "figures": len(wrong), "differs": wrong[:MOST_TOLD]})
            held = EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model)
        elif held is not None and why and not why.startswith("gone"):
            tally.different += 1
            differing.append({"replay": verdict.ledger_id, "figures": 1, "differs": [why]})
            held = None
        else:
            tally.gone += 1
            held = None
        if held is None and (kept := store.assessments.checkpoint(verdict.ledger_id)) is not None:
            held = EstimatorState(belief=belief_from_document(kept[0]), health=health_from_document(kept[1]))
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


def _again(store: Store, verdict: StoredAssessment, held: EstimatorState) -> tuple[Assessment | None, str]:
    """The verdict once more, or why not."""
    made, why = _made(store, verdict)
    if made is None:
        return None, why
    try:
        outcome = assess(
            made.recording,
            robot=made.robot,
            mounting=made.mounting,
            belief=held.belief,
            health=held.health,
            model=held.model,
            gains=made.gains,
            settings=made.settings,
        )
    except BadInput as error:
        return None, f"cannot be assessed any more: {error}"
    return (None, f"is rejected now: {outcome.reason}") if isinstance(outcome, Rejected) else (outcome, "")


def _made(store: Store, verdict: StoredAssessment) -> tuple[_Made | None, str]:
    """What a verdict was made of, or why that is not known any more."""
    try:
        recording = read_recording(store.recordings.path(verdict.ledger_id))
    except BadInput as error:
        return None, f"gone: {error}"
    if verdict.made_with is None:
        return None, "gone: made before the settings of a verdict were kept with it"
    with_ = store.assessments.provenance(verdict.made_with)
    gains = with_["gains_nm_per_a"]
    return _Made(
        recording=recording,
        robot=load_robot(with_["robot"]),
        mounting=Mounting.of(with_["mounting_rad"]),
        gains=np.array(gains) if gains else None,
        settings=settings_from_document(AssessSettings, with_["settings"]),
    ), ""


def _model_of(store: Store, verdict: StoredAssessment, belief: Belief) -> CompensatedModel | None:
    """The model that a checkpoint does not hold; None where the verdict's recording is gone."""
    made, _ = _made(store, verdict)
    if made is None:
        return None
    try:
        return model_after(made.recording, belief, robot=made.robot, mounting=made.mounting, gains=made.gains, settings=made.settings)
    except BadInput:
        return None


def roll_back(store: Store, now_unix_s: float) -> EstimatorState | None:
    """Take back what was learnt while the clock was in the future: those replays become rejected, windows skipped then open again.

    Returns what is held true without them; None, and nothing is changed, where the recordings to find that out are gone.
    """
    verdicts = [verdict for verdict in store.assessments.rows() if verdict.recorded_at_unix_s <= now_unix_s]
    known, start = EstimatorState(), 0
    for k in range(len(verdicts) - 2, -1, -1):  # one at least is judged again: a checkpoint holds no model
        if (kept := store.assessments.checkpoint(verdicts[k].ledger_id)) is not None:
            belief = belief_from_document(kept[0])
            known = EstimatorState(belief=belief, health=health_from_document(kept[1]), model=_model_of(store, verdicts[k], belief))
            start = k + 1
            break
    words = [event for event in store.events.rows() if event.ledger_id is None]
    since = verdicts[start - 1].judged_at_unix_s if start else -math.inf
    for verdict in verdicts[start:]:
        told = [event for event in words if since <= event.at_unix_s < verdict.judged_at_unix_s]
        outcome, _ = _again(store, verdict, _with_words(known, told))
        if outcome is None:
            return None
        known = EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model)
        since = verdict.judged_at_unix_s
    documents = None
    if known.belief is not None and known.health is not None and known.model is not None:
        documents = (known.belief.as_document(), known.health.as_document(), known.model.as_document())
    store.assessments.roll_back(now_unix_s, documents)
    return known


def _with_words(held: EstimatorState, events: list[AlertEvent]) -> EstimatorState:
    """What people, or the monitor itself, said of alerts between two replays is part of the health that the next one begins with."""
    health = held.health
    if health is None or not events:
        return held
    alerts = {alert.key: alert for alert in health.alerts}
    for event in events:
        alert = alert_from_document(event.document)
        alerts[alert.key] = alert
    return EstimatorState(belief=held.belief, health=replace(health, alerts=tuple(alerts.values())), model=held.model)


def settings_from_document(cls: Any, document: dict[str, Any]) -> Any:
    """A room's settings from the plain document of them; what a later version has added takes its default."""
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
