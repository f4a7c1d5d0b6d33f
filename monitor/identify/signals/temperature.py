"""The joints' temperatures over whole recordings."""

from collections.abc import Sequence

import numpy as np

from monitor.identify.signals.motion import Motion
from monitor.identify.signals.readings import plausible_temperatures
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
        slope = np.full(recording.joints, np.nan)
        plausible = plausible_temperatures(recording.temperature_c)
        for j, column in enumerate(recording.temperature_c.T):
            good = np.isfinite(recording.t_s) & plausible[:, j]
            t = recording.t_s[good] - np.mean(recording.t_s[good]) if good.any() else np.zeros(0)
            if len(t) < 2 or not np.ptp(t) > 0:
                return None
            slope[j] = 60.0 * (t @ column[good]) / (t @ t)
        slopes.append(slope)
    mean: Array = np.mean(slopes, axis=0)
    return mean
