"""One motion of the arm, subject to guards, history and permit, with a slow first pass after a change.

The daemon's scheduler and `joint-monitor replay` both move an arm through `move`.
"""

import dataclasses
import logging
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from monitor.acquire.driver import Driver, Witness
from monitor.acquire.ending import look, look_after
from monitor.acquire.replay import check, first_pass_key, replay, slowed
from monitor.acquire.safety.gate import AskPermit
from monitor.acquire.safety.inputs import ConditionResult, LastMotion, Permit
from monitor.acquire.safety.way import Left
from monitor.acquire.state import Identity
from monitor.acquire.watch import Caller, ReplayProgress
from monitor.config.schema import Configuration
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable, StoreError
from monitor.judge.torque.model import CompensatedModel
from monitor.model.fourier import Excitation
from monitor.publish import documents
from monitor.publish.documents import made
from monitor.publish.permit import PermitReply
from monitor.reason import INTERNAL, Reason, Sentence, reason_of
from monitor.recording import Context, Recording
from monitor.service.computing import HERE, Compute, ComputingFailed
from monitor.service.left_arm import condition_inputs, left_by, left_in, with_a_person
from monitor.service.torque_basis import learnt_basis
from monitor.store.backup import present
from monitor.store.history.motions import UNKNOWN_END
from monitor.store.store import Store

log = logging.getLogger(__name__)

ANOTHER_ARM_ANSWERS = Sentence(
    "another_arm_answers", "{host}: the controller's serial number is {serial}, expected {expected}, the arm that was moved before"
)
COMPLETE_BUT = Sentence("replay_complete_but", "{host}: the replay was complete; after it {what}")


class ReplayWindow(Protocol):
    """The window of the ledger for a replay: a claimed one, or one whose arm a program lends at a moment that nobody knows before."""

    @property
    def passed_by(self) -> Callable[[Reason], None]:
        """Takes why the arm was not taken at the program's last node."""

    def enter(self) -> int:
        """Enter it, just before the arm may move; its number in the ledger, the same at every call. Raises StoreError, MotionRefused."""

    def taken(self) -> None:
        """The arm was taken, and may move now."""

    def given_back(self) -> None:
        """The program has its arm again."""


class Claimed(NamedTuple):
    """A window that the ledger has. No program lends the arm, so that none is kept waiting for it."""

    ledger_id: int

    @property
    def passed_by(self) -> Callable[[Reason], None]:
        """No node is passed by."""
        return lambda _: None

    def enter(self) -> int:
        """It is entered."""
        return self.ledger_id

    def taken(self) -> None:
        """No program waits."""

    def given_back(self) -> None:
        """No program waits."""


AskAnswer = Callable[[documents.Permit, float], PermitReply | None]


class MotionLog:
    """One motion in the history: entered before the arm may move, ended once it is known how it ended."""

    def __init__(self, store: Store, context: Context, host: str, enter: Callable[[], int | None], *, first_pass: bool) -> None:
        self._store, self._host, self._enter, self._first_pass = store, host, enter, first_pass
        self._configured = context.serial
        self.expected_serial = store.motions.expected_serial()
        self._id: int | None = None  # None: the arm was not allowed to move yet

    def met(self, identity: Identity) -> None:
        """Another arm than the expected one answers: that waits for a person, because nobody has said that it may move."""
        serial, expected = identity.serial, self.expected_serial
        if self._configured is None and None not in {serial, expected} and serial != expected:
            why = ANOTHER_ARM_ANSWERS(host=self._host, serial=serial, expected=expected)
            self._store.stops.add_another_arm(str(serial), why, time.time())

    def begin(self, identity: Identity) -> None:
        """Enter the motion. Raises StoreError, MotionRefused: the arm must not move then."""
        self._id = self._store.motions.begin(
            ledger_id=self._enter(),
            host=self._host,
            serial=identity.serial,
            configured=self._configured is not None,
            first_pass=self._first_pass,
            at_unix_s=time.time(),
        )

    def end(self, cause: str, reason: Reason | None, *, needs_a_person: bool, left: Left | None = None, moved: bool = True) -> None:
        """Note how the motion ended, and how it `left` the arm if it `moved` it; None: it brought it back.

        Where the disk refuses, it stays without an end, which waits for a person too.
        """
        if self._id is None:
            return
        document = None if left is None else left.as_document()
        try:
            if needs_a_person:
                self._store.motions.end_in_stop(self._id, cause, reason or cause, time.time(), left=document, moved=moved)
            else:
                self._store.motions.end(self._id, cause, reason, time.time(), left=document, moved=moved)
        except StoreError as error:
            log.error("the end of a motion cannot be stored, a person must look at the arm before the next one: %s", error)


def move(
    configuration: Configuration,
    store: Store,
    excitation: Excitation,
    context: Context,
    *,
    caller: Caller,
    window: ReplayWindow | None = None,
    first_pass_path: Path = Path("first-pass.parquet"),
    model: CompensatedModel | None = None,
    driver: Driver | None = None,
    compute: Compute = HERE,
) -> Recording:
    """One replay. A slow first pass precedes it where something has changed since the last one; its recording has a file of its own.

    window : None: a replay by hand; `first_pass_path` is where the recording of its first pass goes. caller : whom to ask and to tell
    meanwhile; its `met` and `begin` are not used, because who answers and that the motion begins go into the history. compute : how what
    was learnt for the torque band is read.

    Each motion is in the history before the arm moves. An end after which the arm was not seen at rest and in order is stored as a stop.

    Raises as `acquire.replay.replay`, and StoreError where the motion or the first pass cannot be stored.
    """
    settings, robot = configuration.replay, configuration.robot_description
    chosen: Driver = driver or configuration.driver

    def enter() -> int | None:
        if window is None:
            return None
        window.taken()
        return window.enter()

    def given_back() -> None:
        if window is not None:
            window.given_back()

    def play(played: Excitation, *, slowly: bool) -> Recording:
        with closing(chosen.witness(settings.host)) as witness:
            return play_before(witness, played, slowly=slowly)

    def play_before(witness: Witness, played: Excitation, *, slowly: bool) -> Recording:
        basis = learnt_basis(store, configuration, played, context, model, compute)
        log.debug(
            "%s at %g of the pace, torque within the band of %s", "first pass" if slowly else "replay", played.time_scale, basis.description
        )
        motion = MotionLog(store, context, settings.host, enter, first_pass=slowly)
        before = left_in(store)
        try:
            recording = replay(
                played,
                robot,
                settings,
                context=context,
                installation=configuration.installation,
                last=LastMotion(stopped_before=_waiting(store), expected_serial=motion.expected_serial, left=before),
                basis=basis,
                caller=dataclasses.replace(caller, met=motion.met, begin=motion.begin, on_progress=_named(caller.on_progress, slow=slowly)),
                driver=chosen,
                witness=witness,
            )
        except ReplayAborted as error:
            if not error.borrowed:
                given_back()
            ended, after = error, None
            with_us = settings.lent is None or error.borrowed  # else the program has its arm, and moves it
            if with_us and error.moved and error.cause in ReplayAborted.HARMLESS:
                ended, after = look_after(chosen, settings, error, witness=witness, should_stop=caller.should_stop)
            left = left_by(ended, after, played, before)
            if error.phase:
                ended = with_a_person(ended, left, after, condition_inputs(configuration, played, context))
            motion.end(ended.cause, ended.reason, needs_a_person=ended.needs_a_person, left=left, moved=bool(error.phase))
            raise ended from error
        except (MotionRefused, RobotUnreachable) as error:
            given_back()
            motion.end("refused", error.reason, needs_a_person=False, moved=False)  # it was told to go, and found a reason not to move
            raise
        except BaseException as error:
            motion.end("internal", INTERNAL(error=type(error).__name__, text=str(error)), needs_a_person=True)
            raise
        given_back()
        after = look(chosen, settings, clean=True, should_stop=caller.should_stop)
        if after.unknown is None:
            motion.end("done", None, needs_a_person=False)
        else:
            cause = UNKNOWN_END if after.stop is None else after.stop.cause
            motion.end(cause, COMPLETE_BUT(host=settings.host, what=after.unknown), needs_a_person=True)
        return recording

    with store.motions.turn(time.time()):
        digest = first_pass_key(excitation, settings, context)
        if settings.first_pass and not store.first_passes.is_latest(digest):
            slow = play(slowed(excitation, settings), slowly=True)
            note = "first pass, slow: not assessed"
            path = store.recordings.first_pass_path(window.enter()) if window is not None else first_pass_path
            written_apart(compute, path, dataclasses.replace(slow, context=dataclasses.replace(slow.context, note=note)))
            store.first_passes.add(digest, _load(context) | {"recording": path.name, "quality": dict(slow.quality)}, time.time())
            if caller.should_stop():
                raise ReplayAborted("stopped on request after the first pass; the arm stands", "parent_asked_to_stop")
        return play(excitation, slowly=False)


def check_conditions(configuration: Configuration, *, ask: AskAnswer | None = None) -> tuple[ConditionResult, ...]:
    """Every condition as it is now. Nothing is sent to the arm but requests for its state; the history adds its stops."""
    last = LastMotion()
    try:
        with Store.reader(configuration.state_directory) as store:
            last = LastMotion(stopped_before=_waiting(store), expected_serial=store.motions.expected_serial(), left=left_in(store))
    except StoreError:
        if present(configuration.state_directory):
            raise  # a history that cannot be read is not an empty one
    return check(
        configuration.replay,
        configuration.excitation,
        configuration.robot_description,
        configuration.context,
        installation=configuration.installation,
        last=last,
        ask=None if ask is None else permit_by(ask),
        driver=configuration.driver,
    )


def _waiting(store: Store) -> Reason | None:
    """What waits for a person: the newest stop, or a motion whose end nobody knows."""
    found = [stop.said for stop in store.stops.waiting()] + [motion.end_unknown for motion in store.motions.left_over()]
    return found[-1] if found else None


def _named(on_progress: Callable[[ReplayProgress], None] | None, *, slow: bool) -> Callable[[ReplayProgress], None] | None:
    """The same display, which is told whether this is a slow first pass."""
    if on_progress is None:
        return None
    return lambda at: on_progress(at._replace(slow=slow))


def permit_by(ask: AskAnswer) -> AskPermit:
    """A permit by the answer of whoever answers on the bus."""

    def asking(about: Mapping[str, Any], timeout_s: float) -> Permit | None:
        answer = ask(made(documents.Permit, about), timeout_s)
        return None if answer is None else Permit(answer.allowed, reason_of(answer.text))

    return asking


def _load(context: Context) -> dict[str, Any]:
    """The load and mounting that a torque model holds for: with another load the torque is another."""
    mounting = None if context.mounting_rad is None else list(context.mounting_rad)
    return {"payload_kg": context.payload_kg, "tool": context.tool, "mounting_rad": mounting}


# --- the progress in the log -----------------------------------------------------------------------

EVERY_S = 5.0
NODE = "node"  # the phase in which a replay waits for the program's node


def progress_log(monotonic: Callable[[], float] = time.monotonic) -> Callable[[ReplayProgress], None]:
    """Logs where a replay is, a line every EVERY_S, e.g. `slow first pass, 40 s of 52`."""
    logged_at = monotonic()
    passed_by: Reason | None = None

    def show(at: ReplayProgress) -> None:
        nonlocal logged_at, passed_by
        if at.phase == NODE:  # that may last for days: a line where something is new
            if at.passed_by != passed_by:
                passed_by = at.passed_by
                log.info("the program's node was passed by: %s", passed_by)
        elif monotonic() - logged_at >= EVERY_S:
            logged_at = monotonic()
            total = f" of {at.duration_s:.0f}" if at.duration_s else ""
            log.debug("%s, %.0f s%s", at.text, at.elapsed_s, total)

    return show


def written_apart(compute: Compute, path: Path, recording: Recording) -> None:
    """Write a recording. Raises StoreError where the disk refuses."""
    from monitor.store.formats.recordings import write_recording

    try:
        compute(write_recording, path, recording)
    except ComputingFailed as error:
        log.warning("%s is written here: %s", path.name, error)
        write_recording(path, recording)
