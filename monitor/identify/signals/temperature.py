"""The joints' temperatures: which readings are of a sensor, their means, and how fast they rise."""

from collections.abc import Sequence

import numpy as np

from monitor.recording import Array, Mask, Recording

MAX_TEMPERATURE_C = 200.0  # no reading of a joint's sensor
SWING_K = 25.0  # from the median of one recording: a joint warms by a kelvin a minute


def plausible_temperatures(temperature_c: Array) -> Mask:
    """(N, J) the readings (N, J) that may be of their joints' sensors. A sensor that says 0 throughout has none."""
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(temperature_c) & (np.abs(temperature_c) < MAX_TEMPERATURE_C)
        given = np.any(finite & (temperature_c != 0.0), axis=0)
        plausible: Mask = finite & given
        for j in np.flatnonzero(given):
            plausible[:, j] &= np.abs(temperature_c[:, j] - np.median(temperature_c[finite[:, j], j])) < SWING_K
    return plausible


def temperatures_at(t_s: Array, measured_s: Array, measured_c: Array) -> Array:
    """(n, J) temperatures measured at times (N,) as (N, J) [°C], at the times t_s (n,); NaN for a joint without a plausible reading."""
    temperature_c = np.full((len(t_s), measured_c.shape[1]), np.nan)
    for j, sensible in enumerate(plausible_temperatures(measured_c).T):
        if sensible.any():
            temperature_c[:, j] = np.interp(t_s, measured_s[sensible], measured_c[sensible, j])
    return temperature_c


def mean_temperature(temperatures: Sequence[Array | None]) -> Array | None:
    """(J,) mean over the samples of all motions, (N, J) each [°C]; None where one of them has no temperatures."""
    known = [each for each in temperatures if each is not None]
    if len(known) < len(temperatures):
        return None
    mean: Array = np.mean(np.concatenate(known), axis=0)
    return mean


def warming(recordings: Sequence[Recording]) -> Array | None:
    """(J,) slope of temperature over time [K/min], the mean over the recordings; None where one of them does not determine it."""
    slopes = []
    for recording in recordings:
        if recording.temperature_c is None:
            return None
        good = plausible_temperatures(recording.temperature_c) & np.isfinite(recording.t_s)[:, None]
        slope = np.array([_slope(recording.t_s[on], column[on]) for column, on in zip(recording.temperature_c.T, good.T, strict=True)])
        if np.any(np.isnan(slope)):
            return None
        slopes.append(slope)
    mean: Array = np.mean(slopes, axis=0)
    return mean


def constant(recordings: Sequence[Recording]) -> Array | None:
    """(J,) 1 where a joint's readings are one and the same number in all recordings, else 0; None where one has no temperatures."""
    known = [each.temperature_c for each in recordings if each.temperature_c is not None]
    return np.all(np.concatenate(known) == known[0][0], axis=0).astype(float) if len(known) == len(recordings) else None


def _slope(t_s: Array, temperature_c: Array) -> float:
    """Slope of a column (N,) over time [K/min]; NaN where no time passes."""
    if len(t_s) < 2 or not np.ptp(t_s) > 0.0:
        return float("nan")
    t = t_s - np.mean(t_s)
    return float(60.0 * (t @ temperature_c) / (t @ t))
