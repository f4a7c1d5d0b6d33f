"""What the daemon hears between replays: how much the joints work, and whether work says that friction has risen.

The judging is `judge.usage`'s and `judge.residual`'s; here is what is remembered from one sample to the next.
"""

import threading
from typing import NamedTuple

import numpy as np

from monitor.judge.drift.usage import Usage
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.judge.torque.predictor import TorquePrediction
from monitor.judge.torque.production_residual import (
    ProductionEvidence,
    ProductionResiduals,
    ResidualSettings,
    WorkSample,
    earlier_replay_reason,
    production_evidence,
    update,
)
from monitor.recording import Array

LONGEST_STEP_S = 2.0  # between two samples that belong together; a longer pause was not heard
HEARD_ENOUGH = 0.5  # of the time since the last replay: less, and nobody knows how much it has worked


class Sample(NamedTuple):
    """The arm at work, (J,) each."""

    at_unix_s: float
    qd: Array
    qdd: Array
    measured_nm: Array


class Production:
    """Revolutions counted and residuals gathered since the last replay.

    For several threads at once: the one that listens counts, the one that replays asks for the count and begins it anew, and any
    that says how the arm is asks for the evidence. A count that is taken is never half of one and half of the next.
    """

    def __init__(self, settings: ResidualSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._residuals: ProductionResiduals | None = None
        self._total: Array | None = None  # revolutions until the last replay
        self._since: Array | None = None
        self._heard_s = 0.0
        self._last_unix_s: float | None = None
        self._counting_since_unix_s: float | None = None
        self._asked_for_revision = -1

    def use(self, settings: ResidualSettings) -> None:
        """Judge by other settings from now on. What was gathered by the old ones is no look by the new: it begins anew."""
        with self._lock:
            if settings != self._settings:
                self._settings, self._residuals = settings, None

    def continue_from(self, usage: Usage) -> None:
        """Count on from what an earlier run had counted."""
        with self._lock:
            self._total = np.nan_to_num(usage.revolutions)

    def moved(self, at_unix_s: float, qd: Array) -> float:
        """Count what the joints turned; returns the seconds since the last sample, 0 where there was none."""
        with self._lock:
            dt = 0.0 if self._last_unix_s is None else at_unix_s - self._last_unix_s
            self._last_unix_s = at_unix_s
            if self._since is None or self._counting_since_unix_s is None:
                self._since, self._heard_s, self._counting_since_unix_s = np.zeros(len(qd)), 0.0, at_unix_s
            if not 0.0 < dt <= LONGEST_STEP_S:
                return 0.0
            self._since = self._since + np.where(np.isfinite(qd), np.abs(qd), 0.0) * dt / (2.0 * np.pi)
            self._heard_s += dt
            return dt

    def worked(self, model: CompensatedModel, predicted: TorquePrediction, sample: Sample, dt_s: float) -> None:
        """Compare one sample of work with what the model foresees."""
        with self._lock:
            one = WorkSample(sample.measured_nm, sample.qd, sample.qdd, dt_s)
            self._residuals = update(self._residuals, model.revision, predicted, one, self._settings)

    def revolutions(self, at_unix_s: float) -> tuple[float, ...] | None:
        """Of every joint until now, for a replay's context; None where too little was heard. What was not heard counts as the rest."""
        with self._lock:
            if self._since is None or self._counting_since_unix_s is None:
                return None
            span = at_unix_s - self._counting_since_unix_s
            share = self._heard_s / span if span > 0 else 0.0
            since, self._since = self._since, None
            if share < HEARD_ENOUGH:
                return None
            total = np.zeros(len(since)) if self._total is None else self._total
            self._total = total + since / min(share, 1.0)
            return tuple(float(count) for count in self._total)

    def evidence(self) -> tuple[ProductionEvidence, ...]:
        """What work says of every joint."""
        with self._lock:
            return production_evidence(self._residuals, self._settings)

    def pull_forward(self) -> str | None:
        """Why the next replay should not wait: said once for each model."""
        with self._lock:
            if self._residuals is None or self._residuals.revision == self._asked_for_revision:
                return None
            why = earlier_replay_reason(self._residuals, self._settings)
            if why is not None:
                self._asked_for_revision = self._residuals.revision
            return why
