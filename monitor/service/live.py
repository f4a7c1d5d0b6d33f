"""The arm's present motion against the torque model, sample by sample: `torque/live`, revolutions, evidence of more friction."""

import logging
from collections.abc import Callable

from monitor.publish.timestamps import rfc3339
from monitor.recording import Array
from monitor.service.bus.publisher import Publisher
from monitor.service.production import Production, Sample
from monitor.service.replay_requests import ReplayRequests
from monitor.service.shared_state import SharedState

log = logging.getLogger(__name__)


class LiveComparison:
    """Compares predicted with measured torque while the arm is received."""

    def __init__(
        self,
        state: SharedState,
        publisher: Publisher,
        production: Production,
        requests: ReplayRequests | None,
        now: Callable[[], float],
    ) -> None:
        self._state, self._publisher, self._production, self._requests, self._now = state, publisher, production, requests, now

    def sample(self, q: Array, qd: Array, qdd: Array, current: Array, temperature_c: Array) -> None:
        """Publish predicted against measured torque of one sample; all (J,) [rad, rad/s, rad/s², A, °C]."""
        self._state.temperature_c = temperature_c
        now, live = self._now(), self._state.live_torque
        dt_s = self._production.moved(now, qd)
        if live is None:
            return
        predicted, measured = live.compared(q, qd, qdd, current, temperature_c)
        if not self._state.replaying.locked():  # a replay is judged by its own recording
            self._production.worked(live.model, predicted, Sample(now, qd, qdd, measured), dt_s)
            self._request_earlier_replay(now)
        self._publisher.live({"at": rfc3339(now), **live.document(q, qd, temperature_c, predicted, measured)})

    def _request_earlier_replay(self, now: float) -> None:
        """Where production work indicates more friction, the next replay may come sooner; windows, permission and guard still decide."""
        why = None if self._requests is None else self._production.pull_forward()
        if why is not None and self._requests is not None and self._state.configuration.replay.allow_motion is True:
            log.info("evidence for an earlier replay: %s", why)
            self._requests.evidence(now)
