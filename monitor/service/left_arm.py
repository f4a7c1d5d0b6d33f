"""An arm that a motion left before it was back: what the next motion does about it, and when a person is asked.

Where nothing but us stopped the arm, the next motion brings it back over the way that it came. Otherwise, or where that has failed, an arm
that stands too far from the start of its trajectory would be refused at every window, so a person is asked at once.
"""

import time
from dataclasses import replace

from monitor.acquire.ending import ArmAfter
from monitor.acquire.safety.conditions import named_conditions
from monitor.acquire.safety.inputs import ConditionInputs, LastMotion
from monitor.acquire.safety.way import JOIN_RAD, Left, left_from_document, nearest_place
from monitor.config.schema import Configuration
from monitor.errors import DOES_NOT_HOLD, BadInput, ReplayAborted, RobotUnreachable
from monitor.model.fourier import Excitation
from monitor.publish.timestamps import rfc3339
from monitor.reason import Reason, Sentence
from monitor.recording import Context
from monitor.store.store import Store

ON_PATH = frozenset({"play", "way_back"})  # phases in which the arm is on its trajectory
MOST_FAILED = 3  # motions in succession that ended while they brought the arm back: then something speaks against it
COUNTED = 100  # newest windows that are looked through
LOOK_S = 5.0  # for the arm's state, when a person lets it be brought back
AWAY = Sentence("away", "nothing is learnt: since {since} the window was refused: {why}")
AWAY_LONG = Sentence("away_for_windows", "nothing is learnt: since {since} each of {windows} windows was refused: {why}")
NEAR = ("approach_near", "approach_clear")  # the conditions that an arm far from its start does not fulfil


def left_by(error: ReplayAborted, after: ArmAfter | None, excitation: Excitation, before: Left | None) -> Left:
    """How a motion that ended early left the arm. `after`: what was seen of the arm then; `before`: how the motion before had left it."""
    state = None if after is None else after.state
    failed = 0 if error.phase != "way_back" else 1 + (0 if before is None else before.failed)
    return Left(
        path_digest=excitation.path_digest,
        on_path=error.phase in ON_PATH,
        q=() if state is None or error.needs_a_person else tuple(state.q.tolist()),
        home_q=error.home_q,
        free=not error.needs_a_person and error.cause in ReplayAborted.BROUGHT_BACK and failed < MOST_FAILED,
        cause=error.cause,
        failed=failed,
    )


PLACE_NOT_KNOWN = Sentence("place_not_known", "{host}: no RTDE data: whether the arm stands on its trajectory is not known")
IN_VAIN = Sentence("brought_back_in_vain", "it was brought back {times} times in vain")
NOT_BROUGHT_BACK = Sentence("not_brought_back", "after {cause} it is not brought back")
NOWHERE_TO_BEGIN = Sentence("nowhere_to_begin", "the arm stands where no motion may begin, and {why}: {condition}: {found}")


def with_a_person(error: ReplayAborted, left: Left, after: ArmAfter | None, known: ConditionInputs) -> ReplayAborted:
    """The same end; a person is asked where the next motion could not begin from where the arm stands."""
    if error.needs_a_person or after is None or after.state is None:
        return error
    found = named_conditions(replace(known, state=after.state, last=LastMotion(left=left)), NEAR)
    refused = next((each for each in found if not each.holds), None)
    if refused is None:
        return error
    why = IN_VAIN(times=left.failed) if left.failed >= MOST_FAILED else NOT_BROUGHT_BACK(cause=error.cause)
    return error.known(NOWHERE_TO_BEGIN(why=why, condition=refused.name, found=refused.reason))


def let_back(configuration: Configuration, store: Store) -> str:
    """Let the next motion bring the arm back along its trajectory: a person says that this way is free. Returns what was found.

    Raises BadInput where the arm does not stand on its trajectory, RobotUnreachable where it does not answer.
    """
    settings, excitation = configuration.replay, configuration.excitation
    state = configuration.driver.state(settings.host, settings.rate_hz, LOOK_S)
    if state is None:
        raise RobotUnreachable(PLACE_NOT_KNOWN(host=settings.host))
    before = left_in(store)
    if before is None or before.path_digest != excitation.path_digest:
        before = Left(path_digest=excitation.path_digest, on_path=True)
    left = replace(before, on_path=True, free=True, failed=0, q=tuple(state.q.tolist()))
    known = replace(condition_inputs(configuration, excitation, configuration.context), state=state, last=LastMotion(left=left))
    if known.way_from(state).back_from_s is None:
        off_rad, _ = nearest_place(known.played, state.q)
        raise BadInput(
            f"--way-back: the arm stands {off_rad:.2f} rad from its trajectory, at most {JOIN_RAD:g}: there is no way back along it; "
            "jog it near the start"
        )
    store.motions.set_left(left.as_document())
    return named_conditions(known, NEAR)[0].text


def away(store: Store) -> Reason | None:
    """The problem that the newest windows were refused because the arm stands too far from its start: that does not pass by itself.

    None where it is not so. Raises StoreError.
    """
    refused = []
    for row in reversed(store.ledger.rows(limit=COUNTED)):
        reason = row.reason
        if row.state != "skipped" or reason is None or reason.code != DOES_NOT_HOLD.code or reason.parameters["condition"] not in NEAR:
            break
        refused.append(row)
    if not refused:
        return None
    sentence = AWAY if len(refused) == 1 else AWAY_LONG
    return sentence(since=rfc3339(refused[-1].started_at_unix_s), windows=len(refused), why=refused[0].reason)


def condition_inputs(configuration: Configuration, excitation: Excitation, context: Context) -> ConditionInputs:
    """What the conditions on where the arm stands are asked of, before its state is known."""
    return ConditionInputs(
        settings=configuration.replay,
        excitation=excitation,
        robot=configuration.robot_description,
        context=context,
        now_unix_s=time.time(),
    )


def left_in(store: Store) -> Left | None:
    """How the last motion left the arm; None where it brought it back. Raises StoreError."""
    document = store.motions.left()
    return None if document is None else left_from_document(document)
