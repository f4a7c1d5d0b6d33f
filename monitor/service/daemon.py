"""One robot's daemon, put together from its parts: shared state, bus, publisher, replay cycle, alerts, queries, production."""

import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from monitor.config.schema import Configuration
from monitor.errors import BadConfiguration, StoreUnavailable
from monitor.publish.bus import Bus
from monitor.reason import Reason
from monitor.service.alert_changes import AlertChanges
from monitor.service.computing import HERE, Compute
from monitor.service.duty import Duty
from monitor.service.handlers import Handlers
from monitor.service.history.assess_and_store import adopt_orphans, load_state
from monitor.service.learning import ArmHeard, nothing_learnt, situation
from monitor.service.live import LiveComparison
from monitor.service.plant_prior import with_prior
from monitor.service.publisher import Publisher
from monitor.service.replay import Monitor, Replay
from monitor.service.shared_state import ReplayRequests, SharedState
from monitor.store.store import Store

if TYPE_CHECKING:
    from monitor.service.production import ProductionListener

log = logging.getLogger(__name__)

PORT_WAIT_S = 5.0  # a command of this machine that asks for a permit has the port for a moment
AT_START = 3  # recordings that wait are assessed before the service is ready; more of them, after a restored history, afterwards


class Daemon:
    """A context manager: entering it takes up what the last run left, leaving it closes the bus.

    The clock and the way to make a recording are handed in: the service gives the host's clock and a replay over RTDE, a study its own.
    """

    def __init__(
        self,
        configuration: Configuration,
        store: Store,
        *,
        now: Callable[[], float],
        play: Replay,
        requests: ReplayRequests | None = None,
        alive: Callable[[], None] = lambda: None,
        compute: Compute = HERE,
        compute_production: Compute = HERE,
    ) -> None:
        """Open the bus. Raises BusError where an endpoint cannot be opened, BadConfiguration where another program keeps it.

        now : UTC, seconds since 1970. requests : where a scheduler serves requests for a replay. alive : called often while a replay or an
        assessment is under way. compute, compute_production : how verdicts of replays and of production are computed; the service gives
        processes of their own.
        """
        self._store, self._now = store, now
        configuration = with_prior(configuration, store)
        self.state = SharedState(configuration, store, now, requests, compute)
        self.bus = _bus(configuration)
        self.publisher = Publisher(self.bus, self.state)
        self.alerts = AlertChanges(self.state, self.publisher)
        self.monitor = Monitor(self.state, self.publisher, play=play, alive=alive, ask_plant=self.bus.ask_plant)
        self.live = LiveComparison(self.state, self.publisher)
        self.listener = _listener(self.state, self.publisher, compute_production) if configuration.production.listen else None
        self.duty = Duty(self.state, self.publisher)
        self.heard = ArmHeard(store, now)
        self.bus.answer(Handlers(self.state, self.alerts).by_key())

    def __enter__(self) -> "Daemon":
        """Take up what the last run left: nothing is replayed, what was recorded is assessed, what is known is published."""
        try:
            self._take_up()
        except BaseException:
            self.bus.close()  # a session left open would keep a failed daemon alive
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.state.stopping.set()
        self.duty.keep()
        self.bus.close()

    def look(self) -> Reason | None:
        """Look at the monitor itself and at its own alerts; returns for how long nothing was learnt, where that is too long.

        Call it often while the host's clock is believed. Raises StoreError.
        """
        now, configuration = self._now(), self.state.configuration
        due = self.state.due
        why = nothing_learnt(configuration, self._store, now, due)
        self.state.nothing_learnt = why
        self.alerts.look(situation(configuration, self._store, now, self.heard, due))
        return why

    def _take_up(self) -> None:
        known = load_state(self._store)
        self.state.take(known, self.state.sample_var(known))
        if self.state.estimator.belief is not None:
            self.state.production_motion.continue_from(self.state.estimator.belief.usage)
        restored = self._store.restored
        if restored is not None:
            log.error("%s", restored.reason)
        self.alerts.read_restored()
        if self.alerts.restored is not None:  # also where the last start ended in the middle of it
            adopted = adopt_orphans(self._store, self._now())
            if adopted:
                log.warning("%d recordings that the restored history does not know wait for their assessment", adopted)
        try:
            self.monitor.recover(at_most=AT_START)
            self.alerts.raise_restored()
        except StoreUnavailable as error:  # the scheduler's thread tries again, and reports it
            log.warning("what the last run left half-way is finished later: %s", error)
        self.publisher.everything()
        for event in self._store.events.rows(unpublished=True):
            self.publisher.event(event)


def _bus(configuration: Configuration) -> Bus:
    """The open bus. Raises as `Bus`; a port that another program has is tried again for PORT_WAIT_S."""
    until_s = time.monotonic() + PORT_WAIT_S
    while True:
        try:
            return Bus(configuration.bus, configuration.key_prefix)
        except BadConfiguration:
            if time.monotonic() >= until_s:
                raise
            time.sleep(0.25)


def _listener(state: SharedState, publisher: Publisher, compute: Compute) -> "ProductionListener":
    from monitor.service.production import ProductionListener  # and with it what identifies

    return ProductionListener(state, publisher, compute=compute)
