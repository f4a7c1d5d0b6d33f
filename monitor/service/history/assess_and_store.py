"""Assess a recording with the estimator's present state, and commit the result with everything that follows from it.

The daemon and `import` both use these functions, and the recomputation repeats them: it recomputes what was run. What only a verdict needs
is imported where it is made: in the daemon, a process of its own.
"""

import base64
import hashlib
import json
import logging
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.judge.alerts.health import Alert, Health, Transition, alert_document, alert_from_document, health_from_document
from monitor.judge.belief import Belief, belief_from_document
from monitor.judge.document import plain, typed
from monitor.judge.drift.maintenance import Maintenance
from monitor.judge.settings import AssessSettings
from monitor.judge.torque.model import CompensatedModel, model_from_document
from monitor.model.robot import Mounting, Robot
from monitor.publish.torque import sample_var
from monitor.reason import INTERNAL, Reason, Sentence
from monitor.recording import Array, Context, Recording
from monitor.service.computing import HERE, Compute
from monitor.store.history.database import packed, unpacked
from monitor.store.history.events import AlertEvent
from monitor.store.provenance import provenance
from monitor.store.store import Store

if TYPE_CHECKING:
    from monitor.identify.identification import Identification
    from monitor.judge.assess import Rejected
    from monitor.judge.assessment import Assessment, JointFriction

log = logging.getLogger(__name__)

BEGIN_ANEW = "or begin a new history with another [store] directory"
OF_ANOTHER_MODEL = Sentence(
    "history_of_another_model",
    "it is of a {model}, robot.model is {robot}: every replay would be rejected; set robot.model back, " + BEGIN_ANEW,
)
AT_ANOTHER_SPEED = Sentence(
    "history_at_another_speed",
    "its friction refers to {its_rad_s:g} rad/s, drift.reference_speed_rad_s is {speed_rad_s:g}: every replay would be rejected; "
    "set it back to {its_rad_s:g}, " + BEGIN_ANEW,
)
NOT_IDENTIFIED = frozenset({"endless"})  # came later: with it the digests of stored verdicts would all differ


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatorState:
    """The estimator's state of one arm; each part is None before the first assessment, but for a health with early alerts alone."""

    belief: Belief | None = None
    health: Health | None = None
    model: CompensatedModel | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """What follows from one recording, as it is stored and published; it travels between processes."""

    recorded_at_unix_s: float
    samples_digest: str  # of the recording
    document: dict[str, Any]  # of the assessment
    friction: "tuple[JointFriction, ...]"
    temperature_c: Array | None  # (J,) of the joints during the replay
    belief: Belief
    health: Health
    model: CompensatedModel
    sample_var: Array | None  # (J,) what the recording says of the noise of samples, where the model does not
    transitions: tuple[Transition, ...]
    maintenance: tuple[Maintenance, ...]
    identified: bytes  # see `kept_parts`


class Inputs(NamedTuple):
    """What a verdict depends on, besides its recording."""

    robot: Robot
    mounting: Mounting
    gains: Array | None
    settings: AssessSettings
    state: EstimatorState


class HistoryEntry(NamedTuple):
    """The outcome of one recording, as it entered the history."""

    outcome: Verdict | Reason  # why nothing is learnt from it
    events: list[AlertEvent]


def load_state(store: Store) -> EstimatorState:
    """The state after the last assessment, with the alerts as people and the service have changed them since."""
    state = store.assessments.state()
    if state is None:
        early = early_alerts(store)
        return EstimatorState(health=Health(joints=(), alerts=early) if early else None)
    return EstimatorState(
        belief=belief_from_document(state.belief), health=health_from_document(state.health), model=model_from_document(state.model)
    )


def misfit(configuration: Configuration, model: str | None, speed_rad_s: float | None) -> Reason | None:
    """Why a history of this model and reference speed cannot be continued with this configuration; None where it can."""
    robot, speed = configuration.robot_description.name, configuration.assess.drift.reference_speed_rad_s
    if model is not None and model != robot:
        return OF_ANOTHER_MODEL(model=model, robot=robot)
    if speed_rad_s is not None and speed_rad_s != speed:
        return AT_ANOTHER_SPEED(its_rad_s=speed_rad_s, speed_rad_s=speed)
    return None


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
    if robot.coupling is None:  # later than the digests of stored verdicts, and none of an arm whose motors turn one joint each
        del parameters["coupling"], parameters["recorded_at_motors"]
    return hashlib.sha256(json.dumps(parameters, sort_keys=True, default=str).encode()).hexdigest()[:16]


def inputs_of(configuration: Configuration, state: EstimatorState) -> Inputs:
    """What the next verdict depends on."""
    return Inputs(configuration.robot_description, configuration.mounting, configuration.gains_nm_per_a, configuration.assess, state)


def assess_stored(
    store: Store, configuration: Configuration, state: EstimatorState, ledger_id: int, now: Callable[[], float], compute: Compute = HERE
) -> HistoryEntry:
    """Assess a recording that waits on disk, and commit the result; a rejection ends its window with the reason.

    One that cannot be read is rejected. Raises StoreError where the history cannot be written, ComputingFailed where the recording has
    to wait.
    """
    outcome = compute(judged, store.recordings.path(ledger_id), inputs_of(configuration, state))
    return enter(store, configuration, ledger_id, outcome, now)


def keep_and_judge(path: Path, recording: Recording, inputs: Inputs) -> Generator[Verdict | Reason | None, None, None]:
    """Write a recording, and judge what was written: None once it is on disk, then its verdict.

    What was written and not what was measured is judged, so that a recomputation sees the very same. Raises StoreError where the disk
    refuses.
    """
    from monitor.store.formats.recordings import write_recording

    write_recording(path, recording)
    yield None
    yield judged(path, inputs)


def judged(path: Path, inputs: Inputs) -> Verdict | Reason:
    """The verdict of a recording on disk, or why there is none."""
    from monitor.judge.assess import Rejected
    from monitor.store.formats.recordings import read_recording

    try:
        recording = read_recording(path)
        assessment = assessed(recording, inputs)
        return assessment.reason if isinstance(assessment, Rejected) else _verdict(assessment, recording, inputs)
    except BadInput as error:
        return error.reason
    except Exception as error:  # an error of this program in one recording must not end the service, now and at every start
        log.exception("%s cannot be assessed", path.name)
        return INTERNAL(error=type(error).__name__, text=str(error))


def assessed(recording: Recording, inputs: Inputs) -> "Assessment | Rejected":
    """The assessment of a recording. Raises BadInput where it does not fit the arm."""
    from monitor.judge.assess import assess

    return assess(
        recording,
        robot=inputs.robot,
        mounting=inputs.mounting,
        belief=inputs.state.belief,
        health=inputs.state.health,
        model=inputs.state.model,
        gains=inputs.gains,
        settings=inputs.settings,
    )


def _verdict(assessment: "Assessment", recording: Recording, inputs: Inputs) -> Verdict:
    return Verdict(
        recorded_at_unix_s=assessment.recorded_at_unix_s,
        samples_digest=recording.samples_digest,
        document=assessment.as_document(),
        friction=assessment.friction,
        temperature_c=assessment.identification.temperature_c,
        belief=assessment.belief,
        health=assessment.health,
        model=assessment.model,
        sample_var=sample_var(assessment.model, inputs.robot, inputs.gains, recording),
        transitions=assessment.transitions,
        maintenance=assessment.maintenance,
        identified=kept_parts(assessment.identification, recording),
    )


class Kept(NamedTuple):
    """What a verdict is made of, besides settings and state."""

    identification: "Identification"
    context: Context
    quality: dict[str, Any]
    samples: int
    source: str


def kept_parts(identification: "Identification", recording: Recording) -> bytes:
    """What a verdict is made of, as a history keeps it: with it, another one is made without the recording."""
    from monitor.identify.kept import parts_of

    flat: list[Array] = []
    parts = parts_of(identification, flat)
    document = {"samples": recording.samples, "source": recording.source, "context": recording.context, "quality": dict(recording.quality)}
    numbers = np.concatenate([np.ravel(part) for part in flat]).astype("<f8").tobytes()
    return packed({**plain(document), "identification": plain(parts), "numbers": base64.b64encode(numbers).decode()})


def read_parts(kept: bytes) -> Kept:
    """What `kept_parts` has kept. Raises BadInput where it cannot be read."""
    from monitor.identify.kept import from_parts

    document = unpacked(kept)
    numbers = np.frombuffer(base64.b64decode(document["numbers"]), dtype="<f8")
    context = typed(Context, document["context"], where="context")
    return Kept(from_parts(document["identification"], numbers), context, document["quality"], document["samples"], document["source"])


def enter(store: Store, configuration: Configuration, ledger_id: int, outcome: Verdict | Reason, now: Callable[[], float]) -> HistoryEntry:
    """Commit a verdict with everything that follows from it, or the reason why there is none. Raises StoreError."""
    if isinstance(outcome, Reason):
        store.ledger.end(ledger_id, "rejected", outcome, now())
        return HistoryEntry(outcome, [])
    events = store.assessments.commit(
        ledger_id,
        at_unix_s=now(),
        recorded_at_unix_s=outcome.recorded_at_unix_s or now(),
        samples_digest=outcome.samples_digest,
        assessment=outcome.document,
        friction=[plain(joint) for joint in outcome.friction],
        belief=outcome.belief.as_document(),
        health=outcome.health.as_document(),
        model=outcome.model.as_document(),
        events=[{"kind": transition.kind, **alert_document(transition.alert)} for transition in outcome.transitions],
        made_with=made_with(configuration),
        maintenance=[plain(act) for act in outcome.maintenance],
        identified=outcome.identified,
    )
    return HistoryEntry(outcome, events)


def adopt_orphans(store: Store, at_unix_s: float) -> int:
    """Enter the recordings that the ledger does not hold, as after a restored backup; they wait for their assessment. Returns how many."""
    from monitor.store.formats.recordings import read_recording

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


def state_after(before: EstimatorState, entered: HistoryEntry) -> EstimatorState:
    """The estimator's state after this recording; a rejected one leaves it unchanged."""
    outcome = entered.outcome
    return before if isinstance(outcome, Reason) else EstimatorState(belief=outcome.belief, health=outcome.health, model=outcome.model)
