"""The arm's ordinary work in the daemon: rows are gathered into sums, the sums are kept, and each day's work is judged. I/O.

The main thread hands over the rows that it has received; everything else happens in a thread of its own, so that nothing waits for it.
Raw rows are never kept: what a kill costs is the last minutes of sums.
"""

import logging
import math
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from monitor.acquire.rows import columns
from monitor.acquire.schedule.needed import suspicion_asks
from monitor.errors import BadInput, MonitorError, StoreError, Unidentifiable
from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.identify.production.arm import ProductionArm, rows_of_columns
from monitor.identify.production.gather import gather, initial
from monitor.identify.production.information import ProductionInformation, information_from_document
from monitor.identify.settings import ProductionSettings
from monitor.judge.alerts.health import Health, alert_document
from monitor.judge.belief import Belief
from monitor.judge.document import plain
from monitor.judge.drift.contexts import differences
from monitor.judge.production import ProductionAssessment, assess_production, observation_of
from monitor.judge.production_observation import ProductionObservation, context_of_production
from monitor.judge.settings import AssessSettings
from monitor.model.robot import Mounting, Robot
from monitor.recording import DAY_S, Array, Context
from monitor.service.computing import HERE, Compute, ComputingFailed
from monitor.service.history.assess_and_store import EstimatorState, made_with
from monitor.service.publisher import Publisher
from monitor.service.shared_state import SharedState
from monitor.store.formats.recordings import read_recording
from monitor.store.history.production import PINNED, DayOfProduction


class ReplayInputs(NamedTuple):
    """What the model of a kept replay depends on, besides its recording."""

    robot: Robot
    mounting: Mounting
    gains: Array | None
    settings: AssessSettings
    declared: Context  # what the configuration says now of payload, tool and mounting


class ReplayModel(NamedTuple):
    """What a kept replay says of the arm."""

    identification: Identification
    payload_kg: float | None


class DayInputs(NamedTuple):
    """What the verdict of a day of work depends on, besides the sums."""

    identification: Identification
    name: str  # of the replay that gave it
    context: Context  # of the arm that works
    production: ProductionSettings
    settings: AssessSettings
    belief: Belief
    health: Health


def declared_now(known: Context, declared: Context) -> Context:
    """A context with what is declared now of payload, tool and mounting."""
    return replace(known, payload_kg=declared.payload_kg, tool=declared.tool, mounting_rad=declared.mounting_rad)


def replay_model(path: Path, inputs: ReplayInputs) -> ReplayModel | None:
    """The identification of a kept replay; None where its payload, tool or mounting are not the declared ones.

    Raises BadInput and Unidentifiable where it gives none.
    """
    recording = read_recording(path)
    now = declared_now(recording.context, inputs.declared)
    if differences(context_of_production(now), context_of_production(recording.context)):
        return None
    found = identify(
        [recording],
        inputs.robot,
        inputs.mounting,
        method=inputs.settings.method,
        gains=inputs.gains,
        settings=inputs.settings.identify,
        residual_friction=True,
    )
    return ReplayModel(found, recording.context.payload_kg)


def production_verdict(
    information: ProductionInformation, last_day: int, inputs: DayInputs
) -> tuple[ProductionObservation, ProductionAssessment] | None:
    """What the work until the end of a UTC day tells, and what follows; None where nothing was listened to.

    Raises BadInput where these days were judged already.
    """
    belief = inputs.belief
    before = None if belief.production is None else belief.production.learnt_at_unix_s
    found = observation_of(
        information, inputs.identification, inputs.production, learnt_at_unix_s=before, last_day=last_day, arm=inputs.name
    )
    if found is None:
        return None
    verdict = assess_production(
        found,
        inputs.context,
        belief=belief,
        health=inputs.health,
        settings=inputs.settings,
    )
    return found, verdict


# --- the listener ----------------------------------------------------------------------------------

log = logging.getLogger(__name__)

BLOCK_S = 60.0  # of rows that are gathered together
LONGEST_GAP_S = 5.0  # between two rows of one block
BLOCKS = 5  # that may wait for the thread; an older one is left out and counted
KEEP_EVERY_S = 300.0  # between two writes of the sums
PAUSE_S = 1.0  # the thread looks at the clock so often


class Pinned(NamedTuple):
    """The frozen model of the arm."""

    arm: ProductionArm
    name: str
    context: Context


class ProductionListener:
    """Gathers and judges the work of one arm. `take` is for the main thread, the rest for one thread of its own."""

    def __init__(
        self,
        state: SharedState,
        publisher: Publisher,
        *,
        compute: Compute = HERE,
    ) -> None:
        """`compute`: how model and verdicts are computed; the service gives a process of their own."""
        self._compute = compute
        self._state, self._store, self._publisher, self._now, self._requests = state, state.store, publisher, state.now, state.requests
        configuration = state.configuration
        self._settings = ProductionSettings(
            deviation=configuration.production.deviation,
            period_days=configuration.production.period_days,
            reference_speed_rad_s=configuration.assess.drift.reference_speed_rad_s,
        )
        self._rows: list[Array] = []
        self._blocks: queue.Queue[tuple[Array, float]] = queue.Queue(BLOCKS)
        self._information: ProductionInformation | None = None
        self._pinned: Pinned | None = None
        self._useless: dict[int, Context | None] = {}  # replays that give no model: in this context of the work; None: in any
        self._kept_at, self._failed_at = state.now(), -math.inf  # the latter: when a day could not be judged last
        self._judged_day = self._newest_day(math.floor(state.now() / DAY_S) - 1)
        self.left_out = 0  # blocks, because the thread was late

    # --- the main thread -------------------------------------------------------------------------

    def take(self, rows: Sequence[Array]) -> None:
        """Take the rows (WIDTH,) that have come since the last call. Those of a replay are not work."""
        if self._state.replaying.locked():
            self._rows = []
            return
        for row in rows:
            if self._rows and not 0.0 <= row[0] - self._rows[-1][0] <= LONGEST_GAP_S:
                self._hand_over()
            self._rows.append(row)
            if row[0] - self._rows[0][0] >= BLOCK_S:
                self._hand_over()

    def _hand_over(self) -> None:
        block, self._rows = np.stack(self._rows), []
        try:
            self._blocks.put_nowait((block, self._now() - float(block[-1, 0] - block[0, 0])))
        except queue.Full:
            self.left_out += 1

    # --- the thread ------------------------------------------------------------------------------

    def run(self, stopping: threading.Event, alive: Callable[[], None] = lambda: None) -> None:
        """Gather and judge until `stopping`; then keep the sums. An error is logged, and the next block tries again.

        alive : is called in every turn, so that a thread that hangs is missed.
        """
        while not stopping.is_set():
            alive()
            try:
                self.step(PAUSE_S)
            except MonitorError as error:
                log.warning("ordinary work: %s", error)
            except Exception:  # the thread must survive an error of this program
                log.exception("ordinary work met a fault")
        try:
            self._keep(self._now())
        except StoreError as error:
            log.warning("ordinary work: %s", error)

    def step(self, timeout_s: float = 0.0) -> None:
        """Gather the next block, if one comes in this time; keep the sums and judge the last day where it is time to. Raises StoreError."""
        try:
            block, at = self._blocks.get(timeout=timeout_s) if timeout_s else self._blocks.get_nowait()
        except queue.Empty:
            pass
        else:
            self.gather(block, at)
        now = self._now()
        last_day = math.floor(now / DAY_S) - 1
        if self._judged_day > last_day:  # the clock was set back, and what was judged in the future is taken back
            self._judged_day = self._newest_day(last_day)
        # a replay that waits for its assessment comes first: what is older than the belief cannot be learned from
        if last_day > self._judged_day and abs(now - self._failed_at) >= KEEP_EVERY_S and not self._store.ledger.unfinished():
            try:
                self.judge(last_day, now)
            except ComputingFailed:  # a host without memory for it is asked again later
                self._failed_at = now
                raise
            self._judged_day = last_day
        elif now - self._kept_at >= KEEP_EVERY_S or now < self._kept_at:
            self._keep(now)

    def gather(self, block: Array, at_unix_s: float) -> None:
        """Add what rows (N, WIDTH) tell; at_unix_s : of the first."""
        pinned = self._model()
        if pinned is None:
            return
        rows = rows_of_columns(columns(block), at_unix_s=at_unix_s)
        before = self._gathered(pinned)
        try:
            self._information = before + gather(rows, pinned.arm, self._settings, before)
        except (BadInput, Unidentifiable) as why:
            log.info("a minute of work is left out: %s", why)

    def judge(self, last_day: int, now: float) -> None:
        """Judge the work until the end of a UTC day, and publish what follows. Raises StoreError."""
        pinned = self._model()
        if pinned is None:
            return
        information = self._gathered(pinned)
        # no day after today: one that a wrong clock has dated would count when it comes
        kept = information.of_days(math.floor(last_day + 1 - self._settings.period_days), last_day + 1)
        with self._state.revising:
            estimator, configuration = self._state.estimator, self._state.configuration
            belief, health = estimator.belief, self._state.health
            if belief is None or health is None:
                return
            inputs = DayInputs(pinned.arm.identification, pinned.name, pinned.context, self._settings, configuration.assess, belief, health)
            try:
                judged = self._compute(production_verdict, information, last_day, inputs)
            except BadInput as why:  # a clock that was set back: these days were judged
                log.warning("the work of day %d is not judged: %s", last_day, why)
                return
            if judged is None:
                return
            found, verdict = judged
            learnt = tuple(int(j) + 1 for j in np.flatnonzero(verdict.learnt))
            day = DayOfProduction(
                day=last_day, at_unix_s=now, document=plain(found), context=plain(pinned.context), learnt=learnt, made_with=""
            )
            events = self._store.production.commit(
                day,
                information=kept.to_document(),
                belief=verdict.belief.as_document(),
                health=verdict.health.as_document(),
                events=[{"kind": transition.kind, **alert_document(transition.alert)} for transition in verdict.transitions],
                made_with=made_with(configuration),
            )
            self._information, self._kept_at = kept, now
            self._state.estimator = EstimatorState(belief=verdict.belief, health=verdict.health, model=estimator.model)
        self._publisher.health()
        for transition in verdict.transitions:
            self._publisher.alert(transition.alert)
        for event in events:
            self._publisher.event(event)
        self._publisher.from_production()
        log.info("work of a day judged: learnt of joints %s", list(learnt))
        if (verdict.asks or verdict.suspects) and self._requests is not None:
            found_by_production, likely = list(verdict.asks), list(verdict.suspects)
            log.info("work alone has found wear of joints %s, and makes it likely of %s: a replay shall tell", found_by_production, likely)
            self._requests.wake()
            asks = bool(verdict.asks) or suspicion_asks(configuration.schedule, self._store.ledger.learnt_at_unix_s(), now)
            if asks and configuration.replay.allow_motion is True:
                self._requests.evidence(now)

    def _newest_day(self, last_day: int) -> int:
        """The newest day that was judged, this one at most; where none was, the day before the sums that are kept begin."""
        newest = self._store.production.newest_day(last_day)
        if newest is None:
            kept = self._store.production.information() or {}
            newest = min((int(cell["day"]) - 1 for cell in kept.get("cells", ())), default=last_day)
        return min(newest, last_day)

    def _keep(self, now: float) -> None:
        self._kept_at = now
        if self._information is not None:
            self._store.production.keep_information(self._information.to_document(), now)

    def _gathered(self, pinned: Pinned) -> ProductionInformation:
        """The sums so far; those that were kept, where they are of this model."""
        empty = initial(pinned.arm, self._settings)
        if self._information is None:
            document = self._store.production.information()
            try:
                self._information = empty if document is None else information_from_document(document, pinned.arm.joints)
            except BadInput as wrong:
                log.warning("the sums of earlier work cannot be read, and are gathered anew: %s", wrong)
                self._information = empty
        try:
            self._information = self._information + empty
        except BadInput:  # of another model
            self._information = empty
        return self._information

    def _model(self) -> Pinned | None:
        """The frozen model of the arm: that of one replay as long as arm and payload stay, so that work keeps its level.

        None where no replay of this arm and payload is kept.
        """
        belief = self._state.estimator.belief
        if belief is None:
            return None
        context = declared_now(belief.context, self._state.configuration.context)
        if self._pinned is not None and not differences(context_of_production(self._pinned.context), context_of_production(context)):
            return self._pinned
        assessed = self._store.ledger.rows(states=("assessed",), limit=1)
        noted = self._store.notes.get(PINNED)
        for number in dict.fromkeys([*([int(noted)] if noted else []), *(row.id for row in assessed)]):
            if number in self._useless and self._useless[number] in (None, context_of_production(context)):
                continue
            pinned = self._of_replay(number, context)
            if pinned is not None:
                self._pinned, self._information = pinned, None
                self._store.notes.set(PINNED, str(number))
                return pinned
        self._pinned = None
        return None

    def _of_replay(self, number: int, context: Context) -> Pinned | None:
        """The model of one replay; None where its recording is gone, or was made in another context."""
        configuration = self._state.configuration
        inputs = ReplayInputs(
            self._state.robot, configuration.mounting, configuration.gains_nm_per_a, configuration.assess, configuration.context
        )
        try:
            model = self._compute(replay_model, self._store.recordings.path(number), inputs)
        except (BadInput, Unidentifiable) as why:
            log.info("replay=%d gives no model for work: %s", number, why)
            self._useless[number] = None
            return None
        if model is None:
            self._useless[number] = context_of_production(context)
            return None
        cog = configuration.robot.payload_cog_m
        arm = ProductionArm(
            robot=self._state.robot,
            mounting=configuration.mounting,
            identification=model.identification,
            gains=configuration.gains_nm_per_a,
            payload_kg=model.payload_kg,
            payload_com_m=(cog[0], cog[1], cog[2]) if len(cog) == 3 else None,
        )
        return Pinned(arm, f"replay {number}", context)
