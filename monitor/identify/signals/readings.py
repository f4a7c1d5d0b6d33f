"""Which readings of the temperature sensors are readings."""

from collections.abc import Iterator

import numpy as np

from monitor.identify.signals.clean import Repair
from monitor.recording import Array, Mask, Recording

MAX_TEMPERATURE_C = 200.0  # no reading of a joint's sensor
SWING_K = 25.0  # from the median of one recording: a joint warms by a kelvin a minute
HOT_C = 65.0  # all joints of a working arm are colder: 20–45 °C, which are 68–113 °F


def plausible_temperature(column: Array) -> Mask:
    """(N,) the readings of one joint that may be of its sensor. A sensor that says 0 throughout has none."""
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(column) & (np.abs(column) < MAX_TEMPERATURE_C)
        if not finite.any() or not np.any(column[finite]):
            return np.zeros(len(column), dtype=bool)
        return finite & (np.abs(column - np.median(column[finite])) < SWING_K)


def check_temperatures(recording: Recording) -> Iterator[Repair]:
    """Doubts about the temperatures of a recording as a whole, and single readings that are left out."""
    if recording.temperature_c is None:
        return
    columns = recording.temperature_c.T
    sound = [plausible_temperature(column) for column in columns]
    silent = [str(j + 1) for j, column in enumerate(columns) if not np.any(np.nan_to_num(column))]
    if silent:
        yield Repair("temperature_doubtful", f"the temperature of joints {', '.join(silent)} is 0 throughout: it is taken as unknown")
    medians = [float(np.median(column[on])) for column, on in zip(columns, sound, strict=True) if on.any()]
    if medians and min(medians) > HOT_C:
        yield Repair(
            "temperature_doubtful",
            f"every joint is hotter than {min(medians):.0f} °C: if these are °F, convert them, for friction is compared by temperature",
        )
    torn = sum(int(np.sum(np.isfinite(column) & ~on)) for column, on in zip(columns, sound, strict=True) if on.any())
    if torn:
        yield Repair("temperature_torn", f"{torn} readings of temperature are none of a joint; left out")
