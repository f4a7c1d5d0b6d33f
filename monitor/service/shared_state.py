"""The state that the threads of one daemon share: settings, estimator, newest temperatures, requests for a replay, and two locks."""

import logging
import queue
import threading
from collections.abc import Callable
from pathlib import Path

from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.judge.alerts.health import Health
from monitor.judge.torque.model import CompensatedModel
from monitor.model.robot import Robot
from monitor.publish.torque import LiveTorque, sample_var
from monitor.reason import Reason
from monitor.recording import Array
from monitor.service.computing import HERE, Compute, ComputingFailed
from monitor.service.history.assess_and_store import EstimatorState
from monitor.service.lending import DueReplay
from monitor.service.production_motion import ProductionMotion
from monitor.store.store import Store


class ReplayRequests:
    """Requests for a replay, passed safely between threads. The daemon adds them, the scheduler takes them."""

    def __init__(self) -> None:
        self._requested: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._evidence: queue.SimpleQueue[float] = queue.SimpleQueue()
        self._awake = threading.Event()

    def request(self, why: str = "asked for") -> None:
        """Request one replay as soon as possible, whatever the schedule says."""
        self._requested.put(why)
        self.wake()

    def evidence(self, unix_s: float) -> None:
        """Production work at this time indicates more friction: the next replay may be moved forward within what the site allows."""
        self._evidence.put(unix_s)

    def take_request(self) -> bool:
        """Whether a replay was requested since the last call; several requests become one replay."""
        found = not self._requested.empty()
        while not self._requested.empty():
            self._requested.get()
        return found

    def take_evidence(self) -> float | None:
        """The time of the newest evidence since the last call; None where there is none."""
        newest = None
        while not self._evidence.empty():
            newest = self._evidence.get()
        return newest

    def wake(self) -> None:
        """End the scheduler's present wait."""
        self._awake.set()

    def wait(self, timeout_s: float) -> None:
        """Wait until `wake`, at most so long."""
        self._awake.wait(timeout_s)
        self._awake.clear()


log = logging.getLogger(__name__)


class SharedState:
    """Each value in it is frozen and is replaced as a whole: a reader sees the value before a change or the one after it.

    replaying : held during one window, so that windows come one after the other. revising : held while the estimator's state changes,
    by an assessment or by what a person does to an alert.
    """

    def __init__(
        self,
        configuration: Configuration,
        store: Store,
        now: Callable[[], float],
        requests: ReplayRequests | None = None,
        compute: Compute = HERE,
    ) -> None:
        """`now`: UTC, seconds since 1970. requests : None where no scheduler serves them. compute : how what is heavy is computed."""
        self.configuration, self.store, self.now, self.requests, self.compute = configuration, store, now, requests, compute
        self.robot = configuration.robot_description  # a change of it needs a restart
        self.estimator = EstimatorState()  # the torque model in it is that of the last replay, also where belief or health changed since
        self.live_torque: LiveTorque | None = None
        self.temperature_c: Array | None = None  # (J,) the newest known, from a replay or from the arm's state
        self.next_due_unix_s: float | None = None
        self.due: DueReplay | None = None  # what waits for the node of the program that lends the arm
        self.nothing_learnt: Reason | None = None  # for how long, where that is too long
        self.production_motion = ProductionMotion(configuration.assess.residual)  # since the last replay
        self.stopping = threading.Event()
        self.replaying = threading.Lock()
        self.replay_ended = threading.Event()  # since the main loop looked last
        self.revising = threading.Lock()

    @property
    def health(self) -> Health | None:
        """Of arm and joints; None before the first assessment."""
        health = self.estimator.health
        return health if health is not None and health.joints else None

    @property
    def alerts(self) -> Health:
        """The health with its alerts: before the first assessment one without joints, with at most alerts of the service's own."""
        return self.estimator.health or Health(joints=())

    @property
    def torque_model(self) -> CompensatedModel | None:
        """The temperature-compensated torque model; None before the first assessment."""
        return self.estimator.model

    def take(self, estimator: EstimatorState, more_var: Array | None) -> None:
        """Replace the estimator's state. more_var : what the replay that it was updated with last says of the noise of samples."""
        self.estimator = estimator
        self.prepare_live(more_var)

    def use(self, configuration: Configuration) -> None:
        """Take other settings from now on."""
        self.configuration = configuration
        self.production_motion.use(configuration.assess.residual)

    def prepare_live(self, more_var: Array | None) -> None:
        """Prepare live predictions for the present model, so that no query waits for that. more_var : as `LiveTorque` takes it."""
        if self.torque_model is not None:
            self.live_torque = LiveTorque(self.torque_model, self.robot, self.configuration.gains_nm_per_a, more_var)

    def sample_var(self, estimator: EstimatorState) -> Array | None:
        """What the last assessed replay says of the noise of samples; None where the model says it, or the recording is gone."""
        model, gains = estimator.model, self.configuration.gains_nm_per_a
        assessed = [] if model is None or model.measured_rms_nm is not None else self.store.ledger.rows(states=("assessed",), limit=1)
        if model is None or not assessed:
            return None
        try:
            return self.compute(_sample_var_of, self.store.recordings.path(assessed[0].id), model, self.robot, gains)
        except (BadInput, ComputingFailed) as error:
            log.warning("live torque: its noise is not known until the next replay: %s", error)
            return None


def _sample_var_of(path: Path, model: CompensatedModel, robot: Robot, gains: Array | None) -> Array | None:
    from monitor.store.formats.recordings import read_recording

    return sample_var(model, robot, gains, read_recording(path))
