"""The joints' temperatures over whole recordings."""

from collections.abc import Sequence

import numpy as np

from monitor.identify.signals.cleaning.readings import plausible_temperatures
from monitor.identify.signals.motion import Motion
from monitor.recording import Array, Recording


def mean_temperature(motions: Sequence[Motion]) -> Array | None:
    """(J,) mean over all samples of all motions [°C]; None where one of them has no temperatures."""
    measured = [moved.temperature_c for moved in motions if moved.temperature_c is not None]
    if len(measured) < len(motions):
        return None
    mean: Array = np.mean(np.concatenate(measured), axis=0)
    return mean


def warming(recordings: Sequence[Recording]) -> Array | None:
    """(J,) slope of temperature over time [K/min], the mean over the recordings; None where one of them does not determine it."""
    slopes = []
    for recording in recordings:
        if recording.temperature_c is None:
            return None
        good = plausible_temperatures(recording.temperature_c) & np.isfinite(recording.t_s)[:, None]
        if good.all():  # most often
            slope = _slopes(recording.t_s, recording.temperature_c)
        else:
            each = zip(recording.temperature_c.T, good.T, strict=True)
            slope = np.concatenate([_slopes(recording.t_s[on], column[on, None]) for column, on in each])
        if np.any(np.isnan(slope)):
            return None
        slopes.append(slope)
    mean: Array = np.mean(slopes, axis=0)
    return mean


def _slopes(t_s: Array, temperature_c: Array) -> Array:
    """(J,) slope of each column (N, J) over time [K/min]; NaN where no time passes."""
    if len(t_s) < 2 or not np.ptp(t_s) > 0.0:
        return np.full(temperature_c.shape[1], np.nan)
    t = t_s - np.mean(t_s)
    slopes: Array = 60.0 * (t @ temperature_c) / (t @ t)
    return slopes
