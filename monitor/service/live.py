"""The arm's present motion against the torque model, sample by sample: `torque/live`, revolutions, evidence of more friction."""

import logging
import threading
import time
from collections.abc import Sequence
from typing import Protocol

from monitor.acquire.listen import LiveState
from monitor.publish.bus import Bus
from monitor.publish.timestamps import utc
from monitor.reason import Reason
from monitor.recording import Array
from monitor.service.production_motion import Sample
from monitor.service.publisher import Publisher
from monitor.service.shared_state import SharedState

log = logging.getLogger(__name__)

LONGEST_PAUSE_S = 0.5  # the link to the arm is checked so often, however seldom live torque is published
EARLY = 0.25  # of a period: so much earlier than it is due a row may come and is published


class ArmLink(Protocol):
    """The arm's state as it is received between replays."""

    @property
    def reachable(self) -> bool:
        """Whether the controller answers."""

    @property
    def problem(self) -> Reason | None:
        """Why it does not; None where it does."""

    @property
    def rows(self) -> Sequence[Array]:
        """The rows (WIDTH,) of the last `poll`."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until a state may have come, at most so long; False at once where nothing would tell."""

    def poll(self) -> Sequence[LiveState]:
        """The states received since the last call, oldest first."""

    def latest(self) -> LiveState | None:
        """The newest state; None before the first."""


class LiveComparison:
    """Compares predicted with measured torque while the arm is received."""

    def __init__(self, state: SharedState, publisher: Publisher) -> None:
        self._state, self._publisher = state, publisher

    @property
    def rate_hz(self) -> float:
        """How often live torque is published: `[bus] live_rate_hz`."""
        return self._state.configuration.bus.live_rate_hz

    def sample(self, q: Array, qd: Array, qdd: Array, current: Array, temperature_c: Array) -> None:
        """Publish predicted against measured torque of one sample; all (J,) [rad, rad/s, rad/s², A, °C]."""
        self._state.temperature_c = temperature_c
        now, live = self._state.now(), self._state.live_torque
        dt_s = self._state.production_motion.moved(now, qd)
        if live is None:
            return
        predicted, measured = live.compared(q, qd, qdd, current, temperature_c)
        if not self._state.replaying.locked():  # a replay is judged by its own recording
            self._state.production_motion.worked(live.model, predicted, Sample(now, qd, qdd, measured), dt_s)
            self._request_earlier_replay(now)
        self._publisher.say(live.document(utc(now), q, qd, temperature_c, predicted, measured))

    def _request_earlier_replay(self, now: float) -> None:
        """Where production work indicates more friction, the next replay may come sooner; windows, permission and guard still decide."""
        requests = self._state.requests
        why = None if requests is None else self._state.production_motion.pull_forward()
        if why is not None and requests is not None and self._state.configuration.replay.allow_motion is True:
            log.info("evidence for an earlier replay: %s", why)
            requests.evidence(now)


class Worker(Protocol):
    """What takes the rows of the arm's ordinary work."""

    def take(self, rows: Sequence[Array]) -> None:
        """The rows that have come since the last call."""


class Counter(Protocol):
    """What counts the arm's hours and stops."""

    def take(self, states: Sequence[LiveState]) -> None:
        """The states that have come since the last call."""


class LiveFeed:
    """Hands the newest state of the arm's link to the comparison at its rate, and says on the bus whether the arm is received."""

    def __init__(
        self, comparison: LiveComparison, bus: Bus, link: ArmLink, production: Worker | None = None, duty: Counter | None = None
    ) -> None:
        """Work : None where nobody learns from ordinary work. duty : None where nobody counts hours and stops."""
        self._comparison, self._bus, self._link, self._production, self._duty = comparison, bus, link, production, duty
        self._due = 0.0  # monotonic

    def wait(self, stopping: threading.Event) -> bool:
        """Wait until the next sample is due and a row has come; whether `stopping` is set. Each wait costs more than what it waits for."""
        early_s = self._due - EARLY / self._comparison.rate_hz - time.monotonic()
        if early_s > 0.0 and stopping.wait(min(early_s, LONGEST_PAUSE_S)):
            return True
        if early_s < LONGEST_PAUSE_S and not self._link.wait(LONGEST_PAUSE_S):
            return stopping.wait(LONGEST_PAUSE_S)
        return stopping.is_set()

    def step(self) -> None:
        """Compare the newest sample, unless none has come or the next one is not due."""
        period_s = 1.0 / self._comparison.rate_hz
        fresh = self._link.poll()
        if self._production is not None:
            self._production.take(self._link.rows)
        if self._duty is not None:
            self._duty.take(fresh)
        # a row may come a little early, and is not left out for it
        if fresh and (now := time.monotonic()) >= self._due - EARLY * period_s:
            following = self._due + period_s
            self._due = following if following > now else now + period_s  # after a pause, and at first, the periods begin anew
            newest = fresh[-1]
            self._comparison.sample(newest.q, newest.qd, newest.target_qdd, newest.current, newest.temperature_c)
        self._bus.robot_alive(self._link.reachable)
