"""The Butterworth low-pass of scipy, without the rest of `scipy.signal`: its import takes ten times as long as an identification."""

from collections.abc import Callable
from functools import lru_cache
from importlib.machinery import PathFinder
from importlib.util import module_from_spec

import numpy as np
import scipy

from monitor.recording import Array


@lru_cache(maxsize=64)
def butterworth(rate_hz: float, order: int, cutoff_hz: float) -> tuple[Array, Array]:
    """The second-order sections (n, 6) of the filter, and their state (n, 2) in a signal that is 1: asked for a dozen times.

    They are those of `scipy.signal.butter` and `scipy.signal.sosfilt_zi` to the last bit, by the same steps: poles of the analogue
    filter, bilinear transform, pairs of poles, of which that nearest to the unit circle comes last. Where a real pole is left over
    beside pairs, scipy itself decides which zeros go to which section.
    """
    if order > 1 and order % 2:
        from scipy.signal import butter

        sos = np.asarray(butter(order, cutoff_hz, fs=rate_hz, output="sos"))
        return sos, _steady(sos)
    twice_rate = 4.0  # of a signal with two samples a second, whose Nyquist frequency is 1
    warped = twice_rate * np.tan(np.pi * (cutoff_hz / (rate_hz / 2.0)) / 2.0)
    analogue = warped * -np.exp(1j * np.pi * np.arange(-order + 1.0, order, 2.0) / (2 * order))
    poles = (twice_rate + analogue) / (twice_rate - analogue)
    gain = warped**order * np.real(1.0 / np.prod(twice_rate - analogue))
    half = order // 2
    pairs = 0.5 * (poles[:half] + poles[::-1][:half].conj())  # rounding makes them no exact pairs
    pairs = pairs[np.argsort(np.abs(pairs))]
    sections = [[1.0, 2.0, 1.0, 1.0, -2.0 * pole.real, pole.real * pole.real + pole.imag * pole.imag] for pole in pairs]
    sos = np.array(sections or [[1.0, 1.0, 0.0, 1.0, -poles[0].real, 0.0]])
    sos[0, :3] *= gain
    return sos, _steady(sos)


def _steady(sos: Array) -> Array:
    """The state (n, 2) of each section in a signal that is 1 at the filter's input."""
    state, level = np.empty((len(sos), 2)), 1.0
    for of_section, (b0, b1, b2, _, a1, a2) in zip(state, sos, strict=True):
        of_section[:] = level * np.linalg.solve(np.array([[1.0 + a1, -1.0], [a2, 1.0]]), np.array([b1 - a1 * b0, b2 - a2 * b0]))
        level *= (b0 + b1 + b2) / (1.0 + a1 + a2)
    return state


@lru_cache
def filter_in_place() -> Callable[[Array, Array, Array], None]:
    """The compiled function of `scipy.signal.sosfilt` alone; where scipy has another layout, that of the package.

    Its arguments are sections (n, 6), rows (M, N) and states (M, n, 2). Rows and states become those behind the filter.
    """
    spec = PathFinder.find_spec("scipy.signal._sosfilt", [f"{scipy.__path__[0]}/signal"])
    if spec is not None and spec.loader is not None:
        compiled = module_from_spec(spec)
        spec.loader.exec_module(compiled)
        found: Callable[[Array, Array, Array], None] = compiled._sosfilt
        return found
    from scipy.signal import sosfilt

    def by_the_package(sos: Array, rows: Array, states: Array) -> None:
        rows[:], after = sosfilt(sos, rows, axis=1, zi=states.transpose(1, 0, 2))
        states[:] = after.transpose(1, 0, 2)

    return by_the_package
