"""Recording and belief → assessment: the whole flow as one function, for the daemon, the commands and the torque study."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.identify.quality import not_of_the_arm, quality_problem
from monitor.identify.settings import QualitySettings
from monitor.judge import prediction_error
from monitor.judge.alerts.health import Health
from monitor.judge.alerts.rules import judge
from monitor.judge.assessment import Assessment
from monitor.judge.belief import Belief
from monitor.judge.drift.contexts import differences, with_lasting_declarations
from monitor.judge.learn import begin, learn
from monitor.judge.settings import AssessSettings
from monitor.judge.torque.evaluation import measure_prediction_error
from monitor.judge.torque.model import CompensatedModel, build_model
from monitor.model.robot import Mounting, Robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Context, Recording


class Rejected(NamedTuple):
    """A replay that must not be learned from. This is an ordinary outcome: it is stored and published with its reason."""

    reason: Reason


NOT_TRUSTED = Sentence("recording_not_trusted", "the recording is not to be trusted: {why}")
WITHOUT_TIME = Sentence(
    "recording_without_time",
    "the recording does not say when it was made (context.recorded_at_unix_s): replays are judged in time order",
)
LEARNT_LAST = Sentence("replay_learnt_last", "this replay is the one learnt last: replays are learnt once, in time order")
OLDER = Sentence("replay_older", "this replay is {older_s:.0f} s older than the last: replays are learnt once, in time order")


def assess(
    recording: Recording,
    *,
    robot: Robot,
    mounting: Mounting,
    belief: Belief | None,
    health: Health | None,
    gains: Array | None = None,
    settings: AssessSettings | None = None,
    model: CompensatedModel | None = None,
) -> Assessment | Rejected:
    """The verdict of one recording, with the belief and health for the next one.

    belief, health : from the assessment before; None before the first recording.
    gains : (J,) [N·m/A] drive gains; None for the published torque constants.
    model : from the assessment before. Its prediction error determines the uncertainty of the next model, and no verdict.

    A recording without enough motion, without a time or older than the belief is Rejected.
    Raises BadInput where recording, robot and belief do not belong together.
    """
    settings = settings or AssessSettings()
    refused = refusal(recording.context, recording.quality, recording.samples, belief, settings.quality)
    if refused:
        return refused
    try:
        identification = identified(recording, robot, mounting, gains, settings)
    except Unidentifiable as why:
        return Rejected(why.reason)
    if belief is not None and model is not None and _same_context(belief, recording.context):
        error = measure_prediction_error(recording, model, robot, gains)
        if error is not None:
            belief = replace(belief, prediction_error=prediction_error.update(belief.prediction_error, error, model.residual_rms_nm))
    return judge_identification(identification, recording.context, belief=belief, health=health, settings=settings, source=recording.source)


def refusal(
    context: Context, quality: Mapping[str, Any], samples: int, belief: Belief | None, settings: QualitySettings
) -> Rejected | None:
    """Why a recording must not be learned from, as far as that is known before it is identified; None where it may be."""
    refused = _refusal(context.recorded_at_unix_s, belief)
    if refused:
        return refused
    why_not = quality_problem(quality, samples, settings)
    return None if why_not is None else Rejected(NOT_TRUSTED(why=why_not))


def identified(recording: Recording, robot: Robot, mounting: Mounting, gains: Array | None, settings: AssessSettings) -> Identification:
    """The identification of one recording, with its residual friction: the first half of `assess`.

    Raises BadInput where the recording does not fit the robot, and Unidentifiable where it has too little motion.
    """
    return identify([recording], robot, mounting, method=settings.method, gains=gains, settings=settings.identify, residual_friction=True)


def judge_identification(
    identification: Identification,
    context: Context,
    *,
    belief: Belief | None,
    health: Health | None,
    settings: AssessSettings | None = None,
    source: str = "",
) -> Assessment | Rejected:
    """The second half of `assess`, from an identification on. The time of the replay is `context.recorded_at_unix_s`."""
    settings = settings or AssessSettings()
    at = context.recorded_at_unix_s
    refused = _refusal(at, belief)
    if refused or at is None:
        return refused or Rejected(WITHOUT_TIME())
    if (other := not_of_the_arm(identification)) is not None:
        return Rejected(NOT_TRUSTED(why=other))
    if belief is None:
        belief = begin(identification.robot, context, identification, at, settings)
    _belong_together(identification, belief, health, settings)
    learnt = learn(belief, identification, context, at, settings)
    belief = learnt.belief
    judged = judge(health, belief, settings, learnt.undeclared, maintenance=learnt.maintenance)
    return Assessment(
        robot=identification.robot,
        recorded_at_unix_s=at,
        source=source,
        identification=identification,
        belief=belief,
        health=judged.health,
        transitions=judged.transitions,
        maintenance=learnt.maintenance,
        warnings=(*identification.warnings, *learnt.warnings),
        settings=settings,
    )


def model_after(
    recording: Recording, belief: Belief, *, robot: Robot, mounting: Mounting, gains: Array | None, settings: AssessSettings
) -> CompensatedModel:
    """The model after a recording, from the belief after it.

    Raises BadInput where the recording does not fit the robot, and Unidentifiable where it has too little motion.
    """
    identification = identified(recording, robot, mounting, gains, settings)
    coulomb, viscous = belief.lines(settings.temperature)
    return build_model(identification, belief, settings.friction, coulomb=coulomb, viscous=viscous)


def _same_context(belief: Belief, context: Context) -> bool:
    """Whether a replay in this context compares with those of the belief."""
    return not differences(belief.context, with_lasting_declarations(belief.context, context))


def _refusal(at_unix_s: float | None, belief: Belief | None) -> Rejected | None:
    """Why a recording of this time must not be learned from; None where it may be."""
    if at_unix_s is None or not math.isfinite(at_unix_s):
        return Rejected(WITHOUT_TIME())
    if belief is not None and belief.replays and at_unix_s <= belief.at_unix_s:
        older_s = belief.at_unix_s - at_unix_s
        return Rejected(OLDER(older_s=older_s) if older_s > 0.0 else LEARNT_LAST())
    return None


def _belong_together(identification: Identification, belief: Belief, health: Health | None, settings: AssessSettings) -> None:
    """Raises BadInput where the belief or the health is of another arm, or the belief of another reference speed."""
    if identification.robot != belief.robot:
        raise BadInput(f"the belief is of {belief.robot}, the recording of {identification.robot}: each arm has its own state")
    if len(identification.coulomb_nm) != belief.joints or (health is not None and health.joints and len(health.joints) != belief.joints):
        raise BadInput(f"the belief has {belief.joints} joints, the identification {len(identification.coulomb_nm)}; they must agree")
    if belief.reference_speed_rad_s != settings.drift.reference_speed_rad_s:
        was, now = belief.reference_speed_rad_s, settings.drift.reference_speed_rad_s
        raise BadInput(
            f"the belief refers friction to {was:g} rad/s, drift.reference_speed_rad_s is {now:g}: keep it, or begin a new history"
        )
