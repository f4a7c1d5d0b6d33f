"""Operating hours and stops of the arm in the daemon: counted as rows come, kept every few minutes, a stop at once. I/O."""

import logging
from collections.abc import Sequence
from typing import NamedTuple

from monitor.acquire.driver import Reported, ReportedError, ReportedMode
from monitor.acquire.duty import TOGETHER_S, DutyCounter, ReportedStops, Seconds
from monitor.acquire.listen import LiveState
from monitor.errors import StoreError
from monitor.recording import DAY_S
from monitor.service.publisher import Publisher
from monitor.service.shared_state import SharedState

log = logging.getLogger(__name__)

KEEP_EVERY_S = 300.0  # between two writes of the hours: what a kill costs at most
SAY_EVERY_S = 600.0  # between two documents without a stop


class HeardEdge(NamedTuple):
    """A stop that has begun, or the end of one (`kind` is None), as it was heard."""

    at_unix_s: float
    heard_unix_s: float
    kind: str | None
    during_replay: bool
    ended_unix_s: float | None = None  # of a stop that is over already


class Duty:
    """Counts one arm's duty where [inspection] asks for it. `take` and `step` are for the main thread."""

    def __init__(self, state: SharedState, publisher: Publisher) -> None:
        self._state, self._store, self._publisher, self._now = state, state.store, publisher, state.now
        self._counter = DutyCounter(state.store.duties.standing())  # one that stood when the last run ended is counted already
        self._reported = ReportedStops()
        self._untold: tuple[int, float] | None = None  # number and time of the last stop, while nobody has told its cause
        self._told: tuple[ReportedError, float] | None = None  # the last error, while it belongs to no stop
        self._seconds: dict[int, Seconds] = {}  # not yet kept, by UTC day
        self._edges: list[HeardEdge] = []  # likewise, oldest first
        self._kept_at = self._said_at = 0.0

    def take(self, states: Sequence[LiveState]) -> None:
        """Count the rows that have come since the last call. A stop is stored and published at once."""
        if not states or not self._state.configuration.inspection.wanted:
            return
        now = self._now()
        seconds, edges = self._counter.take(states)
        day = int(now // DAY_S)
        self._seconds[day] = self._seconds.get(day, Seconds()) + seconds
        for edge in edges:
            self._edges.append(HeardEdge(now - edge.age_s, now, edge.kind, self._state.replaying.locked()))
            if edge.kind is not None:
                self._reported.shown(edge.kind, now)
                log.warning("the arm's safety system stopped it: %s", edge.kind)
        if edges:
            self._say(now)

    def hear(self, reported: Sequence[Reported]) -> None:
        """Take what the controller has reported: the first error near a stop tells its cause; a stop that no row shows was short."""
        if not self._state.configuration.inspection.wanted:
            return
        now = self._now()
        for each in reported:
            if isinstance(each, ReportedMode):
                self._reported.reported(each.mode, now)
        if missed := self._reported.missed(self._counter.standing, now):
            during = self._state.replaying.locked()
            self._edges += [HeardEdge(stop.began_unix_s, stop.began_unix_s, stop.kind, during, stop.ended_unix_s) for stop in missed]
            log.warning("the arm's safety system stopped it %d times, each shorter than the rows show", len(missed))
            self._say(now)
        errors = [each for each in reported if isinstance(each, ReportedError)]
        if not errors:
            return
        if self._told is None or now - self._told[1] > TOGETHER_S:
            self._told = next((each for each in errors if each.joint is not None), errors[0]), now
        if self._explain():
            self._say(now)

    def _explain(self) -> bool:
        """Whether the last stop and the last error belong together; the history has it then."""
        if self._untold is None or self._told is None or abs(self._untold[1] - self._told[1]) > TOGETHER_S:
            return False
        (number, _), (told, _) = self._untold, self._told
        self._untold = self._told = None
        try:
            self._store.duties.stop_explained(number, told.joint, told.code)
        except StoreError as error:
            log.warning("the cause of a stop could not be stored: %s", error)
            return False
        return True

    def step(self) -> None:
        """Keep the hours and publish the document where it is time to."""
        if not self._state.configuration.inspection.wanted:
            return
        now = self._now()
        if not 0.0 <= now - self._kept_at < KEEP_EVERY_S:
            self.keep()
            self._kept_at = now
        if not 0.0 <= now - self._said_at < SAY_EVERY_S:
            self._say(now)

    def keep(self) -> None:
        """Write the stops and the seconds that are not yet in the history; where it refuses them they wait."""
        self._keep_stops()
        for day in sorted(self._seconds):
            seconds = self._seconds[day]
            try:
                if seconds.heard_s:
                    self._store.duties.add(day, *seconds)
            except StoreError as error:
                log.warning("operating hours wait for the history: %s", error)
                return
            del self._seconds[day]

    def _keep_stops(self) -> None:
        while self._edges:
            at, heard_at, kind, during_replay, ended_at = self._edges[0]
            try:
                if ended_at is None:
                    self._store.duties.stop_ended(at)
                if kind is not None:
                    number = self._store.duties.stop_began(
                        at, int(at // DAY_S), kind, during_replay=during_replay, ended_at_unix_s=ended_at
                    )
                    self._untold = number, heard_at
            except StoreError as error:  # reported as a problem by those who need the history more
                log.warning("a stop waits for the history: %s", error)
                return
            del self._edges[0]
        self._explain()

    def _say(self, now: float) -> None:
        self._said_at = now
        self.keep()
        try:
            self._publisher.inspection()
        except StoreError as error:
            log.warning("inspection duties cannot be read: %s", error)
