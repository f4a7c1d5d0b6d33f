"""Filters of the signals: single spikes removed, one even clock, one zero-phase low-pass for all signals."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from monitor.errors import Unidentifiable
from monitor.model.friction import smooth_sign
from monitor.recording import Array

SPIKE_WINDOW = 7  # samples of the running median: three spikes in a row are still a minority
SPIKE_STD = 8.0  # deviation of a spike in standard deviations; ripple and noise of a real drive stay below 6
MOST_EVEN = 4.0  # samples of an even clock for each row: half of the ticks may be missing at random, and half of these again
SPIKE_FLOOR = 0.01  # fraction of the largest reading: without noise, a bend of the signal is no spike


def despike(measured: dict[str, Array]) -> int:
    """Replace spikes of current and torque, in place, by the median of the seven readings around; returns the number of spikes.

    The low-pass would distribute each spike over its neighbours, where no weighting of rows can find it. A step remains as it is, since
    a running median follows it.
    """
    from scipy.ndimage import median_filter

    repaired = 0
    for key in measured.keys() & {"current", "torque"}:
        value = measured[key]
        middle = median_filter(value, size=(SPIKE_WINDOW, 1), mode="nearest")  # (N, J)
        off = np.abs(value - middle)
        # (J,) the 90 % quantile, not the median: on a steep stretch a reading is itself the median, and half of the deviations are 0
        spread = np.quantile(off, 0.9, axis=0) / 1.645
        spikes = off > SPIKE_STD * np.maximum(spread, SPIKE_FLOOR * np.max(np.abs(middle), axis=0))
        measured[key] = np.where(spikes, middle, value)
        repaired += int(np.sum(spikes))
    return repaired


def refuse_uneven(name: str, t_s: Array, stretches: Sequence[tuple[int, int]], rate_hz: float) -> None:
    """Raises Unidentifiable where an even clock would have many times as many samples as there are rows.

    t_s : (N,) increasing times. stretches : first row of each, and the row after its last one. Every signal is resampled, so this bounds
    what is made of a file by its own size.
    """
    even = sum(float(t_s[end - 1] - t_s[begin]) * rate_hz + 1.0 for begin, end in stretches if end > begin)
    if even > MOST_EVEN * len(t_s):
        raise Unidentifiable(
            f"{name}: times are uneven: most rows are {1.0 / rate_hz:.2g} s apart, and in the mean they are "
            f"{even / rate_hz / len(t_s):.2g} s apart, as where a host's times of arrival are written; "
            f"expected the controller's clock, or --rate with the rows a second"
        )


def uniform(t_s: Array, signals: dict[str, Array], rate_hz: float) -> dict[str, Array]:
    """The signals on an even clock, all by the same cubic spline, so that none is smoothed or delayed more than another.

    t_s : (N,) increasing times. signals : (N, …) each. The result holds `t_s` too; it has no samples where N is less than four.
    """
    even_s = t_s[0] + np.arange(int((t_s[-1] - t_s[0]) * rate_hz + 1e-6) + 1) / rate_hz
    if len(even_s) == len(t_s) and np.max(np.abs(even_s - t_s)) < 0.01 / rate_hz:
        return {"t_s": t_s, **signals}
    if len(t_s) < 4:
        return {"t_s": even_s[:0], **{key: value[:0] for key, value in signals.items()}}
    from scipy.interpolate import CubicSpline

    return {"t_s": even_s, **{key: np.asarray(CubicSpline(t_s, value)(even_s)) for key, value in signals.items()}}


@lru_cache(maxsize=64)  # one identification asks for the same few a dozen times
def low_pass(rate_hz: float, order: int, cutoff_hz: float) -> Callable[[Array], Array]:
    """A Butterworth filter that is applied forward and backward along axis 0, so that it delays nothing."""
    from scipy.signal import butter, sosfiltfilt  # takes 1 s to import: only where a recording is identified

    sos = butter(order, cutoff_hz, fs=rate_hz, output="sos")
    pad = round(3 * rate_hz / cutoff_hz)

    def smooth(x: Array) -> Array:
        smoothed: Array = sosfiltfilt(sos, x, axis=0, padlen=min(len(x) - 1, pad))
        return smoothed

    return smooth


def filtered(part: dict[str, Array], rate_hz: float, smooth: Callable[[Array], Array], trim: int) -> dict[str, Array]:
    """Every signal through the same filter, with `trim` + 1 samples less at each end.

    q̇ and q̈ are central differences where they were not recorded. `direction` is s(q̇) through the filter.
    """
    signals = {key: value for key, value in part.items() if key != "t_s"}
    ends = np.cumsum([value.shape[1] for value in signals.values()])[:-1]
    together = np.split(smooth(np.concatenate(list(signals.values()), axis=1)), ends, axis=1)
    result = dict(zip(signals, together, strict=True))
    if "qd" not in result:
        result["qd"] = np.gradient(result["q"], 1.0 / rate_hz, axis=0)
    if "qdd" not in result:
        result["qdd"] = np.gradient(result["qd"], 1.0 / rate_hz, axis=0)
    result["direction"] = smooth(smooth_sign(result["qd"]))
    # one more sample at each end: the differences there are one-sided
    inner = slice(trim + 1, len(part["t_s"]) - trim - 1)
    return {"t_s": part["t_s"][inner], **{key: value[inner] for key, value in result.items()}}
