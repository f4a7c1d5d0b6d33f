"""The arm's motion between replays: how far the joints turn, and whether the work indicates more friction.

`judge` decides; this module keeps what must be remembered from one sample to the next.
"""

import threading
from typing import NamedTuple

import numpy as np

from monitor.judge.drift.usage import Usage
from monitor.judge.settings import ResidualSettings
from monitor.judge.torque.model import CompensatedModel
from monitor.judge.torque.predictor import TorquePrediction
from monitor.judge.torque.production_residual import (
    ProductionEvidence,
    ProductionResiduals,
    ProductionSample,
    earlier_replay_reason,
    production_evidence,
    update,
)
from monitor.recording import Array

LONGEST_STEP_S = 2.0  # [s] between two samples that belong together; what happened in a longer pause is unknown
ENOUGH_RECEIVED = 0.5  # share of the time since the last replay: with less received, the work done is unknown


class Sample(NamedTuple):
    """One sample of the arm at work; arrays are (J,) [rad/s, rad/s², N·m]."""

    at_unix_s: float
    qd: Array
    qdd: Array
    measured_nm: Array


class ProductionMotion:
    """Counts revolutions and collects torque residuals since the last replay.

    Several threads use it: the main loop counts, the scheduler's thread takes the count and starts a new one, and any thread that
    publishes health reads the evidence. A lock keeps each of these whole.
    """

    def __init__(self, settings: ResidualSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._residuals: ProductionResiduals | None = None
        self._total: Array | None = None  # revolutions until the last replay
        self._since: Array | None = None
        self._received_s = 0.0
        self._last_unix_s: float | None = None
        self._counting_since_unix_s: float | None = None
        self._asked_for_revision = -1

    def use(self, settings: ResidualSettings) -> None:
        """Use other settings from now on. Residuals collected with the old settings are dropped."""
        with self._lock:
            if settings != self._settings:
                self._settings, self._residuals = settings, None

    def continue_from(self, usage: Usage) -> None:
        """Continue the count of an earlier run."""
        with self._lock:
            self._total = np.nan_to_num(usage.revolutions)

    def moved(self, at_unix_s: float, qd: Array) -> float:
        """Count how far the joints turned, from qd (J,) [rad/s]. Returns the time since the last sample [s]; 0 where there was none."""
        with self._lock:
            dt = 0.0 if self._last_unix_s is None else at_unix_s - self._last_unix_s
            self._last_unix_s = at_unix_s
            if self._since is None or self._counting_since_unix_s is None:
                self._since, self._received_s, self._counting_since_unix_s = np.zeros(len(qd)), 0.0, at_unix_s
            if not 0.0 < dt <= LONGEST_STEP_S:
                return 0.0
            self._since = self._since + np.where(np.isfinite(qd), np.abs(qd), 0.0) * dt / (2.0 * np.pi)
            self._received_s += dt
            return dt

    def worked(self, model: CompensatedModel, predicted: TorquePrediction, sample: Sample, dt_s: float) -> None:
        """Compare one sample of work with the model's prediction."""
        with self._lock:
            one = ProductionSample(sample.measured_nm, sample.qd, sample.qdd, dt_s)
            self._residuals = update(self._residuals, model.revision, predicted, one, self._settings)

    def revolutions(self, at_unix_s: float) -> tuple[float, ...] | None:
        """Revolutions of every joint until now, for a replay's context, and start a new count. Gaps are filled at the mean rate.

        None where less than half of the time since the last replay was received.
        """
        with self._lock:
            if self._since is None or self._counting_since_unix_s is None:
                return None
            span = at_unix_s - self._counting_since_unix_s
            share = self._received_s / span if span > 0 else 0.0
            since, self._since = self._since, None
            if share < ENOUGH_RECEIVED:
                return None
            total = np.zeros(len(since)) if self._total is None else self._total
            self._total = total + since / min(share, 1.0)
            return tuple(float(count) for count in self._total)

    def evidence(self) -> tuple[ProductionEvidence, ...]:
        """The evidence of production work for every joint that has any."""
        with self._lock:
            return production_evidence(self._residuals, self._settings)

    def pull_forward(self) -> str | None:
        """Why the next replay should come earlier; returned once for each model, then None."""
        with self._lock:
            if self._residuals is None or self._residuals.revision == self._asked_for_revision:
                return None
            why = earlier_replay_reason(self._residuals, self._settings)
            if why is not None:
                self._asked_for_revision = self._residuals.revision
            return why
