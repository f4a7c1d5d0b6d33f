"""Recompute past assessments from the recordings that the store has kept, and name every difference and its possible causes."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from monitor.errors import ArchiveConflict, ArchiveRefused, ArchiveUnavailable, BadInput
from monitor.judge.alerts.health import Health, alert_from_document, health_from_document
from monitor.judge.alerts.states import with_service_alert
from monitor.judge.assess import Rejected, model_after
from monitor.judge.assessment import Assessment
from monitor.judge.belief import Belief, belief_from_document
from monitor.judge.document import typed
from monitor.judge.friction.prior import FleetPrior, prior_from_plain
from monitor.judge.production import ProductionAssessment, assess_production
from monitor.judge.production_observation import ProductionObservation
from monitor.judge.settings import AssessSettings
from monitor.judge.torque.model import CompensatedModel
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context, Recording
from monitor.service.computing import HERE, Compute
from monitor.service.history.assess_and_store import EstimatorState, Inputs, assessed, robot_digest
from monitor.store.formats.recordings import read_recording
from monitor.store.history.assessments import JudgedReplay
from monitor.store.history.events import AlertEvent
from monitor.store.history.maintenance import Amendment
from monitor.store.history.production import DayOfProduction
from monitor.store.provenance import differences, provenance
from monitor.store.store import Store

MOST_LISTED = 20  # assessments in the list of differences, and figures of each

Change = AlertEvent | Amendment | DayOfProduction  # of the estimator's state between two replays


class Unjudged(NamedTuple):
    """Why a replay has no verdict when it is judged once more."""

    cause: Literal["gone", "changed", "refused", "rejected"]  # its recording: not there any more, another one, cannot be read, not trusted
    why: str

    @property
    def without_recording(self) -> bool:
        """Whether what was recorded is not there any more, or is not what was recorded."""
        return self.cause in ("gone", "changed")


class Repeated(NamedTuple):
    """One replay, judged once more."""

    replay: JudgedReplay
    outcome: Assessment | Unjudged | None  # None: the state before it was not known
    known: bool  # whether the state before it was known


Judge = Callable[[JudgedReplay, EstimatorState], Assessment | Unjudged]
Amend = Callable[[EstimatorState | None, list[Change]], EstimatorState | None]  # the state after what was changed between two replays


def repeat(
    store: Store, replays: Iterable[JudgedReplay], judge: Judge, amend: Amend, *, models: bool = True, go_on: bool = False
) -> Iterator[Repeated]:
    """Judge replays once more in their order, each from the state after the one before it.

    models : whether the torque models are made, whose errors count for the next model and for no verdict.
    go_on : where a replay cannot be judged any more, whether the next one is judged without it; else the state is that of the next
    checkpoint. Before anything is learned, a checkpoint counts in either case.
    """
    state: EstimatorState | None = EstimatorState()  # None: not known until the next checkpoint
    changes = deque(changes_of(store))
    for replay in replays:
        between = []
        while changes and changes[0].at_unix_s < replay.judged_at_unix_s:
            between.append(changes.popleft())
        state = amend(state, between)
        known = state is not None
        outcome = None if state is None else judge(replay, state)
        yield Repeated(replay, outcome, known)
        if isinstance(outcome, Assessment):
            state = EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model if models else None)
        elif replay.assessed and not (go_on and state is not None and state.belief is not None):
            state = None
        if state is None and (kept := store.assessments.checkpoint(replay.ledger_id)) is not None:
            state = EstimatorState(belief=belief_from_document(kept[0]), health=health_from_document(kept[1]))


def recompute(store: Store) -> dict[str, Any]:
    """Repeat every assessment from its recording, with its own settings, in the original order.

    The document counts the assessments that are identical to the last bit, lists the others with their differences, and names what has
    changed since they were made. An assessment whose recording was pruned cannot be repeated; the next checkpoint continues the series.
    """
    tally = Tally(store)
    again = repeat(store, store.assessments.judged(), partial(_repeated, store), partial(amended, store))
    for each in again:
        tally.add(each)
    return tally.document()


class Tally:
    """How many verdicts came out the same to the last bit, which did not, and what has changed since they were made."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._counts = {"identical": 0, "different": 0, "not_recomputable": 0, "unknown_circumstances": 0}
        self._differing: list[dict[str, Any]] = []
        self._other_recordings: list[dict[str, Any]] = []  # that are not those that were made
        self._changed: dict[str, None] = {}
        self._seen: set[str] = set()  # provenances that were compared

    def add(self, each: Repeated) -> None:
        """Count one more verdict."""
        replay = each.replay
        self._note_what_changed(replay)
        if isinstance(each.outcome, Assessment):
            wrong = differences(self._store.assessments.document(replay.ledger_id), each.outcome.as_document())
            self._counts["different" if wrong else "identical"] += 1
            if wrong and len(self._differing) < MOST_LISTED:
                self._differing.append({"replay": replay.ledger_id, "figures": len(wrong), "differs": wrong[:MOST_LISTED]})
        elif each.outcome is not None and not each.outcome.without_recording:
            self._counts["different"] += 1
            self._differing.append({"replay": replay.ledger_id, "figures": 1, "differs": [each.outcome.why]})
        else:
            self._counts["not_recomputable"] += 1
            if each.outcome is not None and each.outcome.cause == "changed":
                self._other_recordings.append({"replay": replay.ledger_id, "why": each.outcome.why})

    def document(self) -> dict[str, Any]:
        """The counts, the differences, and their possible causes."""
        counts = self._counts
        return {
            "assessments": counts["identical"] + counts["different"] + counts["not_recomputable"],
            **counts,
            "changed_since": list(self._changed),
            "differing": self._differing,
            "other_recordings": self._other_recordings,
            "circumstances": provenance(),
        }

    def _note_what_changed(self, replay: JudgedReplay) -> None:
        if replay.made_with is None:
            self._counts["unknown_circumstances"] += 1
        elif replay.made_with not in self._seen:
            self._seen.add(replay.made_with)
            made_with = self._store.assessments.provenance(replay.made_with)
            self._changed |= dict.fromkeys(differences(made_with["programs"], provenance()))
            if made_with["robot_digest"] != robot_digest(load_robot(made_with["robot"])):
                self._changed |= {f"parameters of the {made_with['robot']}": None}


def _repeated(store: Store, verdict: JudgedReplay, state: EstimatorState) -> Assessment | Unjudged:
    """The assessment once more, or why that is not possible."""
    made = _inputs(store, verdict, state)
    if isinstance(made, Unjudged):
        return made
    try:
        outcome = assessed(*made)
    except BadInput as error:
        return Unjudged("refused", f"cannot be assessed any more: {error}")
    return Unjudged("rejected", f"is rejected now: {outcome.reason}") if isinstance(outcome, Rejected) else outcome


def _inputs(store: Store, verdict: JudgedReplay, state: EstimatorState) -> tuple[Recording, Inputs] | Unjudged:
    """Recording and inputs of a past assessment from a state, or why they are not there."""
    try:
        recording = read_recording(store.archived.path(verdict.ledger_id))
    except BadInput as error:
        return Unjudged("gone", str(error))
    except ArchiveConflict as error:
        return Unjudged("changed", str(error))
    if verdict.made_with is None:
        return Unjudged("gone", "made before the settings of a verdict were kept with it")
    with_ = store.assessments.provenance(verdict.made_with)
    gains = with_["gains_nm_per_a"]
    inputs = Inputs(
        robot=load_robot(with_["robot"]),
        mounting=Mounting.of(with_["mounting_rad"]),
        gains=np.array(gains) if gains else None,
        settings=settings_from_document(AssessSettings, with_["settings"]),
        state=state,
    )
    return recording, inputs


def _model_of(store: Store, verdict: JudgedReplay, belief: Belief) -> CompensatedModel | None:
    """The torque model after a past assessment, which a checkpoint does not hold; None where the recording is gone."""
    made = _inputs(store, verdict, EstimatorState(belief=belief))
    if isinstance(made, Unjudged):
        return None
    recording, inputs = made
    try:
        return model_after(recording, belief, robot=inputs.robot, mounting=inputs.mounting, gains=inputs.gains, settings=inputs.settings)
    except BadInput:
        return None


def roll_back(store: Store, now_unix_s: float, compute: Compute = HERE) -> EstimatorState | None:
    """Take back every assessment dated later than now: those replays become rejected, and windows skipped then open again.

    What people, the monitor itself and the arm's ordinary work changed after the last assessment that stays is applied once more.
    Returns the estimator's state without them. Returns None and changes nothing where the recordings that this needs are gone. Raises
    StoreError, and ComputingFailed where nothing was changed.
    """
    known = compute(_known_at, store.directory, now_unix_s)
    if known is None:
        return None
    documents = None
    if known.belief is not None and known.health is not None and known.model is not None:
        documents = (known.belief.as_document(), known.health.as_document(), known.model.as_document())
    store.assessments.roll_back(now_unix_s, documents)
    return known


def _known_at(directory: Path, now_unix_s: float) -> EstimatorState | None:
    """The estimator's state without the assessments dated later; None where recordings that this needs are gone, or cannot be fetched."""
    with Store.reader(directory) as store:
        try:
            return _without_later(store, now_unix_s)
        except (ArchiveUnavailable, ArchiveRefused):  # the problem `archive` says why
            return None


def _without_later(store: Store, now_unix_s: float) -> EstimatorState | None:
    verdicts = [verdict for verdict in store.assessments.judged() if verdict.recorded_at_unix_s <= now_unix_s]
    known, start = EstimatorState(), 0
    for k in range(len(verdicts) - 2, -1, -1):  # at least one assessment is repeated, since a checkpoint holds no torque model
        if (kept := store.assessments.checkpoint(verdicts[k].ledger_id)) is not None:
            belief = belief_from_document(kept[0])
            known = EstimatorState(belief=belief, health=health_from_document(kept[1]), model=_model_of(store, verdicts[k], belief))
            start = k + 1
            break
    changes = changes_of(store)
    since = verdicts[start - 1].judged_at_unix_s if start else -math.inf
    for verdict in verdicts[start:]:
        between = [change for change in changes if since <= change.at_unix_s < verdict.judged_at_unix_s]
        outcome = _repeated(store, verdict, amended(store, known, between) or known)
        if isinstance(outcome, Unjudged):
            return None
        known = EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model)
        since = verdict.judged_at_unix_s
    return amended(store, known, [change for change in changes if since <= change.at_unix_s <= now_unix_s]) or known


def repeated_since(directory: Path, start: EstimatorState, since_unix_s: float, most: int) -> tuple[EstimatorState, int]:
    """As `_repeated_since`, of the history in a directory: for a process of its own."""
    with Store.reader(directory) as store:
        return _repeated_since(store, start, since_unix_s, most)


def _repeated_since(store: Store, start: EstimatorState, since_unix_s: float, most: int) -> tuple[EstimatorState, int]:
    """The state after the replays that were judged since a time, judged once more from `start`; and how many they are.

    Raises BadInput where there are more than `most`, or a recording that this needs is gone.
    """
    verdicts = [verdict for verdict in store.assessments.judged() if verdict.judged_at_unix_s >= since_unix_s]
    if len(verdicts) > most:
        raise BadInput(
            f"{len(verdicts)} replays have been learnt from since, too many to judge them once more (at most {most}): it cannot "
            "be taken back. The joint's friction counts from then; what was found before stays in the history"
        )
    state = start
    for verdict in verdicts:
        outcome = _repeated(store, verdict, state)
        if isinstance(outcome, Unjudged):
            raise BadInput(f"replay {verdict.ledger_id} has been learnt from since, and cannot be judged once more: {outcome.why}")
        state = EstimatorState(belief=outcome.belief, health=outcome.health, model=start.model)
    return state, len(verdicts)


def changes_of(store: Store) -> list[Change]:
    """What people and the monitor itself changed between replays, in order: a state is amended before the transitions that followed."""
    changes: list[Change] = [event for event in store.events.rows() if event.ledger_id is None]
    return sorted([*store.maintenance.amendments(), *store.production.rows(), *changes], key=lambda change: change.at_unix_s)


def amended(store: Store, state: EstimatorState | None, changes: list[Change]) -> EstimatorState | None:
    """The state after changes between two replays; None where it is not known. An amendment holds it as it was."""
    for change in changes:
        if isinstance(change, Amendment):
            belief, health = store.maintenance.amended(change)
            model = None if state is None else state.model
            state = EstimatorState(belief=belief_from_document(belief), health=health_from_document(health), model=model)
        elif isinstance(change, DayOfProduction):
            state = None if state is None else _with_production(store, state, change)
        elif state is not None:
            state = _with_alert_changes(state, [change])
    return state


def _with_production(store: Store, state: EstimatorState, day: DayOfProduction) -> EstimatorState:
    """The state after a day of ordinary work, judged once more."""
    if state.belief is None or state.health is None or not state.health.joints:
        return state
    settings: AssessSettings = settings_from_document(AssessSettings, store.assessments.provenance(day.made_with)["settings"])
    verdict = judge_day(day, state.belief, state.health, settings)
    return EstimatorState(belief=verdict.belief, health=verdict.health, model=state.model)


def judge_day(day: DayOfProduction, belief: Belief, health: Health, settings: AssessSettings) -> ProductionAssessment:
    """The verdict of a stored day of ordinary work upon a belief and a health. Raises BadInput where the belief has learnt of later."""
    return assess_production(
        typed(ProductionObservation, day.document, where="observation from production"),
        typed(Context, day.context, where="context"),
        belief=belief,
        health=health,
        settings=settings,
    )


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
        elif hint == FleetPrior | None:
            value = None if value is None else prior_from_plain(value)
        elif get_origin(hint) is tuple and get_args(hint):
            value = tuple(value)
        values[field.name] = value
    return cls(**values)
