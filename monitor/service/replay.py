"""The replay cycle: claim a window, replay, record, assess, store, publish. What the figures mean is judged elsewhere."""

import dataclasses
import logging
import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Protocol

import numpy as np

from monitor.acquire.schedule.needed import Need
from monitor.config.schema import Configuration
from monitor.errors import AT_HOST, MonitorError, MotionRefused, ReplayAborted, RobotUnreachable, StoreError
from monitor.judge.alerts.states import stale_joints
from monitor.model.fourier import Excitation
from monitor.publish.compensation import SOUGHT_AGAIN_DAYS, missing_row
from monitor.publish.timestamps import rfc3339
from monitor.reason import INTERNAL, Reason, Sentence
from monitor.recording import DAY_S, Context, Recording
from monitor.service.computing import ComputingFailed
from monitor.service.history.assess_and_store import (
    HistoryEntry,
    Inputs,
    Verdict,
    enter,
    inputs_of,
    judged,
    keep_and_judge,
    state_after,
)
from monitor.service.history.maintenance import maintenance_document
from monitor.service.history.needed import needed
from monitor.service.lending import BorrowedWindow, DueReplay, program_of
from monitor.service.motion import Claimed, ReplayWindow
from monitor.service.plant_prior import Ask, asked, with_prior
from monitor.service.publisher import Publisher
from monitor.service.shared_state import SharedState
from monitor.store.history.ledger import Kind, LedgerRow

log = logging.getLogger(__name__)

HELD_BY_ANOTHER = frozenset({"arm_in_use", "registers_in_use"})  # codes of refusals that end when another client lets go
ASSESSMENTS = 3  # tries to assess one recording, where the process that computes dies
UNREACHABLE = Sentence("unreachable", "{why}")
NEXT_REFUSED = Sentence("next_try_refused", "{earlier}; the next try was refused: {why}")
NEXT_UNREACHABLE = Sentence("next_try_unreachable", "{earlier}; the next try did not reach the arm: {why}")
NOT_ASSESSED = Sentence("not_assessed", "internal: not assessed in {tries} tries: {why}")
WAITS_FOR_ASSESSMENT = Sentence("waits_for_assessment", "replay {replay} waits for its assessment, which is tried again: {why}")
RETRY_S = 30.0  # before the second try; twice as long before the third


class Replay(Protocol):
    """How a recording is made: over RTDE in the service, from a simulation in a study."""

    def __call__(self, excitation: Excitation, context: Context, should_stop: Callable[[], bool], window: ReplayWindow, /) -> Recording:
        """One replay in a window. Raises MotionRefused, RobotUnreachable and ReplayAborted.

        Where a program lends the arm, it is made at the program's next node: the window is entered when the arm is taken, and told why it
        was not taken at the last node.
        """


class Monitor:
    """Performs windows one at a time. Its methods may be called from any thread."""

    def __init__(
        self,
        state: SharedState,
        publisher: Publisher,
        *,
        play: Replay,
        alive: Callable[[], None],
        ask_plant: Ask = lambda _: None,
    ) -> None:
        """`alive` is called often while a replay or an assessment is under way. ask_plant : for a prior, before the first verdict."""
        self._state, self._store, self._publisher, self._now = state, state.store, publisher, state.now
        self._play, self._alive, self._ask_plant = play, alive, ask_plant
        self.unassessed: Reason | None = None  # why a recording waits for its assessment
        self._failed: dict[int, int] = {}  # tries to assess a recording that ended without an outcome, by its window
        self._retry_at = 0.0  # monotonic

    @property
    def configuration(self) -> Configuration:
        """The settings in force."""
        return self._state.configuration

    @property
    def health_state(self) -> str | None:
        """NE 107 state of the arm, with STALE where it is too old; None until a replay has been assessed."""
        health = self._state.health  # one read: a replay may put another in its place meanwhile
        if health is None:
            return None
        return f"{health.state} (STALE)" if any(stale_joints(health, self._now(), self.configuration.assess.health)) else health.state

    def perform(self, window_unix_s: float, kind: Kind = "scheduled", closes_unix_s: float | None = None) -> LedgerRow | None:
        """One window: claim it, replay, record, assess, publish. Returns its row; None where the ledger has the window already.

        A replay that this machine or the network ended is tried again while the window is open, until `closes_unix_s`; None: it is not.

        Raises nothing for what a robot may do: the row says how the window ended, and why. Raises StoreError.
        """
        with self._state.replaying:
            ledger_id = self._store.ledger.claim(window_unix_s, kind, self._now())
            if ledger_id is None:
                return None
            log.info("replay=%d begins: %s, window %s", ledger_id, kind, rfc3339(window_unix_s), extra={"replay": ledger_id})
            self._assess_waiting(self._store.ledger.repair(self._now(), but=ledger_id))
            self._perform(ledger_id, -math.inf if closes_unix_s is None else closes_unix_s)
        return self._ended(ledger_id)  # whoever hears of the end may ask for the next one

    def borrow(self, due: DueReplay, waits: Callable[[], bool], passed: Callable[[Reason], None]) -> LedgerRow | Reason:
        """Wait for the program's node, and replay there: the row of that, or why the arm was not taken while `waits` was true.

        passed : takes why the arm was not taken at the last node. The program gets its arm back between a first pass and its replay, and
        has a window's time to reach the next node.

        Raises nothing for what a robot may do, as `perform`. Raises StoreError.
        """

        def ask_program() -> str | None:
            return program_of(self.configuration.driver, self.configuration.robot.host)

        with BorrowedWindow(self._store, self._state.replaying, due, self._now, passed, ask_program=ask_program) as window:

            def should_stop() -> bool:
                if window.ledger_id is None:
                    return self._should_stop() or not waits()
                return self._should_stop() or window.back_for_s > self.configuration.schedule.grace_s

            try:
                recording = self._play(self.configuration.excitation, self.configuration.context, should_stop, window)
            except Exception as error:
                needs_a_person = isinstance(error, ReplayAborted) and error.needs_a_person
                if window.ledger_id is None and isinstance(error, MonitorError) and not needs_a_person:
                    return error.reason
                number = window.enter()
                if isinstance(error, ReplayAborted) and error.borrowed:
                    window.lost()
                else:
                    window.given_back()
                self._end(number, error)
            else:
                self._learn(window.enter(), recording)
        return self._ended(window.enter())

    def note_due(self, due: DueReplay | None) -> None:
        """Take which replay waits for the program's node; None where none does."""
        self._state.due = due

    def skip(self, window_unix_s: float, reason: Reason, kind: Kind = "scheduled") -> None:
        """Enter a missed window as skipped; it is never replayed later. Raises StoreError."""
        with self._state.replaying:
            ledger_id = self._store.ledger.claim(window_unix_s, kind, self._now())
            if ledger_id is not None:
                self._store.ledger.end(ledger_id, "skipped", reason, self._now())
                log.warning("window=%s verdict=skipped reason=%r", rfc3339(window_unix_s), reason.text)
                if kind == "requested":  # whoever asked waits for its end
                    self._publisher.replay_ended(self._store.ledger.row(ledger_id))

    def recover(self, at_most: int | None = None) -> None:
        """Finish what a crash or a full disk left half-way: each such window is aborted, or assessed now. Raises StoreError.

        at_most : recordings that are assessed now; the others wait for the next call.
        """
        with self._state.replaying:
            for motion in self._store.motions.give_up_left_over(self._now()):
                log.warning("%s; a person must look at the arm", motion.end_unknown)
            before = {row.id for row in self._store.ledger.rows(states=("started",))}
            waiting = self._store.ledger.repair(self._now())
            for row in self._store.ledger.rows(states=("aborted",), limit=len(before) + 1) if before else ():
                if row.id in before:
                    self._ended(row.id)  # it was announced, and people nearby, the cell and campaigns wait for its end
            self._assess_waiting(waiting[:at_most])

    def roll_back(self) -> bool:
        """Take back what was learned from replays dated in the future; False where the recordings that this needs are gone."""
        from monitor.service.history.recompute import roll_back  # and with it all that judges

        with self._state.replaying, self._state.revising:
            try:
                known = roll_back(self._store, self._now(), self._state.compute)
            except ComputingFailed as error:  # nothing was changed
                log.warning("what was learnt from the future is computed here: %s", error)
                known = roll_back(self._store, self._now())
            if known is not None:
                self._state.take(known, self._state.sample_var(known))
        if known is not None:
            self._publisher.everything()
        return known is not None

    def needed(self) -> Need:
        """From when the next replay is needed, and why. Raises StoreError."""
        estimator = self._state.estimator  # one read: a replay may put another in its place meanwhile
        return needed(self.configuration.schedule, self._store, estimator.belief, self._state.health)

    def missing_row(self, temperature_c: Sequence[float]) -> int | None:
        """The row of the document `compensation` of these (J,) temperatures [°C], where half of the joints had no replay there of late.

        None where they had, and before the first replay. Raises StoreError.
        """
        if self._state.estimator.belief is None:
            return None
        joints, since = range(1, len(temperature_c) + 1), self._now() - SOUGHT_AGAIN_DAYS * DAY_S
        rows, _ = self._store.assessments.history(from_unix_s=since, limit=1000 * len(joints))
        of_joints = [np.array([row.get("temperature_c") for row in rows if row["joint"] == joint], dtype=float) for joint in joints]
        return missing_row(of_joints, np.array(temperature_c))

    def next_due(self, unix_s: float | None) -> None:
        """Note when the schedule will replay next, and publish it with `health`."""
        self._state.next_due_unix_s = unix_s
        self._publisher.health()

    def reconfigure(self, configuration: Configuration) -> None:
        """Take other settings from now on; `info` is published with their digest."""
        self._state.use(with_prior(configuration, self._store))
        with self._state.revising:
            self._state.prepare_live(self._state.sample_var(self._state.estimator))
        self._publisher.info()
        self._publisher.health()

    def _ended(self, ledger_id: int) -> LedgerRow:
        """Say how a window ended; its row."""
        row = self._store.ledger.row(ledger_id)
        self._publisher.replay_ended(row)
        self._state.replay_ended.set()  # the main loop looks at once whether it was a stop
        fields = {"replay": row.id, "verdict": row.state}
        health = self._state.health
        if row.state == "assessed" and health is not None:
            log.info("replay=%d verdict=assessed health=%s why=%r", row.id, health.state, health.why.text, extra=fields)
        else:
            log.warning("replay=%d verdict=%s reason=%r", row.id, row.state, row.reason_text, extra=fields)
        return row

    def _perform(self, ledger_id: int, closes_unix_s: float) -> None:
        try:
            recording = self._replayed(ledger_id, closes_unix_s)
        except Exception as error:
            self._end(ledger_id, error)
        else:
            self._learn(ledger_id, recording)

    def _end(self, ledger_id: int, error: Exception) -> None:
        """End a window whose replay an error has ended."""
        reason = error.reason if isinstance(error, MonitorError) else INTERNAL(error=type(error).__name__, text=str(error))
        state, stop = "aborted", None
        if isinstance(error, RobotUnreachable):
            state, reason = "skipped", UNREACHABLE(why=reason)
        elif isinstance(error, MotionRefused):
            state = "skipped"
        elif isinstance(error, ReplayAborted):
            stop = error.cause if error.needs_a_person else None
        elif not isinstance(error, StoreError):  # that one came before the arm moved or after it came to rest
            # an error of this program: the child is dead and the arm was stopped; the row says what happened
            log.error("replay=%d ended by a fault of the monitor's own", ledger_id, exc_info=error)
            stop = "internal"
        self._store.ledger.end(ledger_id, state, reason, self._now(), stop=stop)

    def _learn(self, ledger_id: int, recording: Recording) -> None:
        """Keep a window's recording, and assess it."""
        # the host's clock, not the controller's, dates a recording; a study's clock is its host's
        now = self._now()
        context = dataclasses.replace(recording.context, recorded_at_unix_s=now, revolutions=self._state.production_motion.revolutions(now))
        recording = dataclasses.replace(recording, context=context)
        path = self._store.recordings.path(ledger_id)
        recording = dataclasses.replace(recording, source=path.name)
        with self._state.revising:
            inputs = self._inputs()
            with closing(self._state.compute.steps(keep_and_judge, path, recording, inputs)) as steps:
                outcome: Verdict | Reason | None = None
                try:
                    try:
                        next(steps)
                    except ComputingFailed as error:
                        from monitor.store.formats.recordings import write_recording

                        log.warning("replay=%d is written here: %s", ledger_id, error)
                        write_recording(path, recording)  # nothing of a replay is lost
                except StoreError as error:
                    self._store.ledger.end(ledger_id, "aborted", error.reason, self._now())
                    return
                self._store.ledger.mark_recorded(ledger_id)
                older = any(row.id < ledger_id for row in self._store.ledger.rows(states=("recorded",)))
                try:
                    outcome = None if older else next(steps, None)  # in time order, as they wait
                except ComputingFailed as error:
                    outcome = self._later(ledger_id, error)
            entry = self._taken(ledger_id, outcome)
        if entry is not None:
            self._publish(*entry)

    def _replayed(self, ledger_id: int, closes_unix_s: float) -> Recording:
        """The recording, at one of several tries. Raises as `_play`, for the last of them."""
        aborted: ReplayAborted | None = None
        number = 0
        while True:
            number += 1
            try:
                return self._play(self.configuration.excitation, self.configuration.context, self._should_stop, Claimed(ledger_id))
            except (ReplayAborted, RobotUnreachable) as error:
                if isinstance(error, ReplayAborted):
                    aborted = error
                if not self._tries_again(ledger_id, number, error, closes_unix_s):
                    raise _after(aborted, error) from error
            except MotionRefused as error:
                if _code(error) not in HELD_BY_ANOTHER or not self._tries_again(ledger_id, number, error, closes_unix_s):
                    raise _after(aborted, error) from error

    def _tries_again(
        self, ledger_id: int, number: int, error: ReplayAborted | MotionRefused | RobotUnreachable, closes_unix_s: float
    ) -> bool:
        """Whether a try that ended so is followed by another; the pause between the two is over then.

        Only this machine, the network or another client of the controller ended it, and the window is still open.
        """
        settings, cause = self.configuration.schedule, "unreachable"
        if isinstance(error, MotionRefused):
            cause = _code(error)
        if isinstance(error, ReplayAborted):
            cause = error.cause
            if error.needs_a_person or cause not in error.TRANSIENT:
                return False
        if number == settings.tries or self._now() + settings.try_again_after_s >= closes_unix_s:
            return False
        self._store.ledger.add_try(ledger_id, cause, error.reason, self._now())
        log.warning("replay=%d try=%d ended early, again in %g s: %s", ledger_id, number, settings.try_again_after_s, error)
        return not self._stopped_within(settings.try_again_after_s)

    def _stopped_within(self, pause_s: float) -> bool:
        """Wait before the next try; whether the monitor was asked to stop meanwhile."""
        until = time.monotonic() + pause_s
        while (left_s := until - time.monotonic()) > 0.0:
            if self._should_stop() or self._state.stopping.wait(min(left_s, 1.0)):
                return True
        return False

    def _assess_waiting(self, rows: Sequence[LedgerRow]) -> None:
        """Assess recordings that wait, oldest first; those after one that has failed wait with it.

        An older one could not be learned from afterwards.
        """
        for row in rows:
            if time.monotonic() < self._retry_at:
                return
            self._assess_stored(row.id)
            self._alive()

    def _assess_stored(self, ledger_id: int) -> None:
        """Assess a recording that waits on disk; where that fails for another reason than the recording, it waits on."""
        with self._state.revising:
            path, inputs = self._store.recordings.path(ledger_id), self._inputs()
            try:
                outcome: Verdict | Reason | None = self._state.compute(judged, path, inputs)
            except ComputingFailed as error:
                outcome = self._later(ledger_id, error)
            entry = self._taken(ledger_id, outcome)
        if entry is not None:
            self._publish(*entry)

    def _inputs(self) -> Inputs:
        """What the next verdict depends on; before the first one, the plant is asked for its prior."""
        if self.configuration.prior_of_plant and self._state.estimator.belief is None:
            self._state.use(asked(self.configuration, self._store, self._ask_plant, self._now()))
            self._publisher.info()
        return inputs_of(self.configuration, self._state.estimator)

    def _later(self, ledger_id: int, error: ComputingFailed) -> Reason | None:
        """None: the recording waits for another try. After several it is rejected, so that later replays are learnt from."""
        self._failed[ledger_id] = failed = self._failed.get(ledger_id, 0) + 1
        log.warning("replay=%d is not assessed yet: %s", ledger_id, error, extra={"replay": ledger_id})
        if failed >= ASSESSMENTS:
            return NOT_ASSESSED(tries=failed, why=error.reason)
        self._retry_at = time.monotonic() + failed * RETRY_S
        self.unassessed = WAITS_FOR_ASSESSMENT(replay=ledger_id, why=error.reason)
        return None

    def _taken(self, ledger_id: int, outcome: Verdict | Reason | None) -> tuple[Verdict, HistoryEntry, bool] | None:
        """Commit an outcome and take the state after it; the verdict, its entry, and whether it is another arm's or firmware's.

        None where nothing was learnt. The caller holds `revising`.
        """
        if outcome is None:
            return None
        entry = enter(self._store, self.configuration, ledger_id, outcome, self._now)
        self._failed.pop(ledger_id, None)
        self.unassessed, self._retry_at = None, 0.0
        if isinstance(outcome, Reason):
            return None
        belief = self._state.estimator.belief
        known, context = belief.context if belief else None, outcome.belief.context
        self._state.take(state_after(self._state.estimator, entry), outcome.sample_var)
        return outcome, entry, known is None or (known.serial, known.firmware) != (context.serial, context.firmware)

    def _publish(self, verdict: Verdict, entry: HistoryEntry, another: bool) -> None:
        """Publish what follows from a verdict. another : of an arm or a firmware that was not known before."""
        self._alive()
        if verdict.temperature_c is not None:
            self._state.temperature_c = verdict.temperature_c
        if another:
            self._publisher.info()
        for joint in verdict.friction:
            self._publisher.friction(joint)
        for act in verdict.maintenance:
            self._publisher.say(maintenance_document(act))
        self._publisher.judgement()
        for event in entry.events:
            self._publisher.event(event)

    def _should_stop(self) -> bool:
        self._alive()
        return self._state.stopping.is_set()


def _code(refused: MotionRefused) -> str:
    """The code of what was found; a session puts its host before it."""
    why = refused.reason.parameters.get("why") if refused.reason.code == AT_HOST.code else None
    return why.code if isinstance(why, Reason) else refused.reason.code


def _after(aborted: ReplayAborted | None, error: ReplayAborted | MotionRefused | RobotUnreachable) -> Exception:
    """How a window ended: as its last try, or as an earlier one that moved the arm, where the last did not come so far."""
    if aborted is None or aborted is error:
        return error
    sentence = NEXT_REFUSED if isinstance(error, MotionRefused) else NEXT_UNREACHABLE
    return ReplayAborted(sentence(earlier=aborted.reason, why=error.reason), aborted.cause)
