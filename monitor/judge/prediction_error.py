"""How far predicted torque is from measured torque, with the model's own error separated from the noise of the measurement.

Measured minus predicted torque is the sum of the model's error and the measurement's noise. The error changes slowly and the noise is
uncorrelated after a few samples, so the covariance of the residual with itself `NOISE_S` later belongs to the error alone (compare the
difference-based noise estimate of Rice, 1984). After a reversal of a joint its servo overshoots and swings back: the residual is then
large and of either sign, so samples within `SETTLED_S` of a reversal count for the measurement only. The estimate from one replay is
uncertain, so replays are averaged. Until several replays are in the mean, the residual of the model's own fit stands for both figures.
"""

from typing import Annotated, NamedTuple

import numpy as np

from monitor.recording import Array

MOVING_RAD_S = 0.02  # below this speed a joint may be in static friction, whose value no model predicts
NOISE_S = 0.08  # the drives' noise has a correlation of 0.3 over one sample of 8 ms and of less than 0.01 over ten samples
SETTLED_S = 0.1  # time since the last reversal; a simulated servo has settled after 70 ms
MIN_PAIRS = 100  # pairs of moving samples `NOISE_S` apart; a joint with fewer has no estimate
MAX_REPLAYS = 40.0  # replays that the running mean holds; older replays lose weight beyond that
FIT_REPLAYS = 3.0  # the residual of the fit, noise included, has the weight of so many replays
MIN_SHARE = 0.04  # of the squared residual of the fit: the error's RMS is never estimated below a fifth of that residual
MAX_RATIO = 4.0  # to the present mean square: one replay with a larger value is limited to it


class PredictionError(NamedTuple):
    """Prediction error in one replay, (J,) each; NaN where too few samples of a joint were usable."""

    error_nm2: Array  # mean square of the model's error [N²·m²]; the estimate may be negative
    measured_nm2: Array  # mean square of the residual of single measured samples [N²·m²]


class PredictionErrorStatistics(NamedTuple):
    """Running mean of the prediction error over replays, (J,) each."""

    replays: Annotated[Array, "J"]  # number of replays in the mean, `MAX_REPLAYS` at most
    error_nm2: Annotated[Array, "J"]  # mean square of the model's error [N²·m²]; after few replays it may be negative
    measured_nm2: Annotated[Array, "J"]  # mean square of the residual of single measured samples [N²·m²]


def measure(t_s: Array, qd: Array, residual_nm: Array) -> PredictionError:
    """Prediction error of one replay.

    t_s : (N,) [s]; qd : (N, J) [rad/s]; residual_nm : (N, J) measured minus predicted torque [N·m], NaN where a sample is not to be used.
    """
    settled = np.where(_since_reversal_s(t_s, qd) > SETTLED_S, residual_nm, np.nan)
    lag = max(1, round(NOISE_S / float(np.median(np.diff(t_s)))))
    products = settled[lag:] * settled[:-lag]
    enough = np.isfinite(products).sum(axis=0) >= MIN_PAIRS
    return PredictionError(*(_mean(np.where(enough, part, np.nan)) for part in (products, residual_nm**2)))


def update(before: PredictionErrorStatistics | None, error: PredictionError, residual_rms_nm: Array) -> PredictionErrorStatistics:
    """The statistics with one more replay.

    before : None before the first replay; residual_rms_nm : (J,) RMS residual of the model's fit [N·m], which limits how far one replay
    can move the mean. A joint with a NaN keeps its statistics.
    """
    J = len(residual_rms_nm)
    before = before or PredictionErrorStatistics(np.zeros(J), np.zeros(J), np.zeros(J))
    usable = np.isfinite(error.error_nm2) & np.isfinite(error.measured_nm2) & np.isfinite(residual_rms_nm)
    n = np.minimum(before.replays + usable, MAX_REPLAYS)
    error_rms, measured_rms = rms(before, residual_rms_nm)
    error_nm2 = np.clip(np.where(usable, error.error_nm2, 0.0), -MAX_RATIO * error_rms**2, MAX_RATIO * error_rms**2)
    measured_nm2 = np.where(usable, error.measured_nm2, 0.0)
    measured_nm2 = np.where(before.replays > 0, np.minimum(measured_nm2, MAX_RATIO * measured_rms**2), measured_nm2)
    weight = np.where(usable, 1.0 / np.maximum(n, 1.0), 0.0)
    return PredictionErrorStatistics(
        replays=n,
        error_nm2=before.error_nm2 + weight * (error_nm2 - before.error_nm2),
        measured_nm2=before.measured_nm2 + weight * (measured_nm2 - before.measured_nm2),
    )


def rms(statistics: PredictionErrorStatistics | None, residual_rms_nm: Array) -> tuple[Array, Array]:
    """Root mean square of the model's error and of the residual of single measured samples, (J,) each [N·m].

    residual_rms_nm : (J,) RMS residual of the model's fit [N·m]. It stands for both figures before the first replay. Afterwards it
    counts for the model's error as `FIT_REPLAYS` replays.
    """
    if statistics is None:
        return residual_rms_nm, residual_rms_nm
    fit_nm2 = residual_rms_nm**2
    error = (FIT_REPLAYS * fit_nm2 + statistics.replays * statistics.error_nm2) / (FIT_REPLAYS + statistics.replays)
    error = np.sqrt(np.maximum(error, MIN_SHARE * fit_nm2))
    measured = np.where(statistics.replays > 0, np.sqrt(statistics.measured_nm2), residual_rms_nm)
    return error, np.maximum(measured, error)


def _since_reversal_s(t_s: Array, qd: Array) -> Array:
    """(N, J) time since each joint last stood still or changed direction [s]; infinite before the first such sample."""
    reversed_ = np.abs(qd) <= MOVING_RAD_S
    reversed_[1:] |= np.sign(qd[1:]) != np.sign(qd[:-1])
    last: Array = np.maximum.accumulate(np.where(reversed_, t_s[:, None], -np.inf), axis=0)
    return t_s[:, None] - last


def _mean(values: Array) -> Array:
    """(J,) mean of the finite values of each column; NaN where there is none."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    mean: Array = np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    return mean
