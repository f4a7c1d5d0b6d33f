"""Which readings of the temperature sensors are readings."""

from collections.abc import Iterator, Sequence

import numpy as np

from monitor.identify.signals.cleaning.clean import Repair
from monitor.identify.signals.order import median
from monitor.recording import Array, Mask, Recording

MAX_TEMPERATURE_C = 200.0  # no reading of a joint's sensor
SWING_K = 25.0  # from the median of one recording: a joint warms by a kelvin a minute
COLD_C = -20.0  # in which no arm works
APART_K = 35.0  # of one joint from the median joint: in warm-up curves of real arms 17 K
HOT_C = 65.0  # all joints of a working arm are colder: 20–45 °C, which are 68–113 °F


def plausible_temperatures(temperature_c: Array) -> Mask:
    """(N, J) the readings (N, J) that may be of their joints' sensors. A sensor that says 0 throughout has none."""
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(temperature_c) & (np.abs(temperature_c) < MAX_TEMPERATURE_C)
        given = np.any(finite & (temperature_c != 0.0), axis=0)
        plausible: Mask = finite & given
        # what differs by less than the swing throughout is as near to its median
        swing = np.max(temperature_c, axis=0, initial=-np.inf) - np.min(temperature_c, axis=0, initial=np.inf)
        for j in np.flatnonzero(~(swing < SWING_K)):  # NaN too
            column = temperature_c[:, j]
            plausible[:, j] &= np.abs(column - median(column[finite[:, j]])) < SWING_K
    return plausible


def check_temperatures(recording: Recording) -> Iterator[Repair]:
    """Doubts about the temperatures of a recording as a whole, and single readings that are left out."""
    if recording.temperature_c is None:
        return
    columns, sound = recording.temperature_c.T, plausible_temperatures(recording.temperature_c).T
    coldest, hottest = np.min(columns, initial=np.inf), np.max(columns, initial=-np.inf)
    if sound.all() and coldest >= COLD_C and hottest <= min(HOT_C, coldest + APART_K):
        return  # most often: no joint's median can then be doubtful
    usual = [median(column[on]) for column, on in zip(columns, sound, strict=True)]  # NaN where no reading is sound
    numbers = [column[np.isfinite(column)] for column in columns]
    silent = [str(j + 1) for j, given in enumerate(numbers) if not np.any(given)]
    if silent:
        yield Repair("temperature_doubtful", f"the temperature of joints {', '.join(silent)} is 0 throughout: it is taken as unknown")
    foreign = [j for j, given in enumerate(numbers) if np.any(given) and np.isnan(usual[j])]
    if foreign:
        size = median(numbers[foreign[0]])
        joints = ", ".join(str(j + 1) for j in foreign)
        yield Repair(
            "temperature_doubtful",
            f"{size:.0f} is no temperature of joint {joints} in °C: it is taken as unknown; if it is in kelvin, subtract 273.15",
        )
    known = [value for value in usual if np.isfinite(value)]
    yield from _apart(usual, known)
    if known and min(known) > HOT_C:
        yield Repair(
            "temperature_doubtful",
            f"every joint is hotter than {min(known):.0f} °C: if these are °F, convert them, for friction is compared by temperature",
        )
    torn = sum(int(np.sum(np.isfinite(column) & ~on)) for column, on in zip(columns, sound, strict=True) if on.any())
    if torn:
        yield Repair("temperature_torn", f"{torn} readings of temperature are none of a joint; left out")


def _apart(usual: Sequence[float], known: Sequence[float]) -> Iterator[Repair]:
    """Doubts about single joints, by each joint's median [°C], NaN where it is unknown, and those that are known."""
    middle = median(np.array(known))
    for j, value in enumerate(usual):
        if value < COLD_C or (len(known) > 2 and abs(value - middle) > APART_K):
            yield Repair(
                "temperature_doubtful",
                f"joint {j + 1} says {value:.0f} °C, the median joint {middle:.0f} °C: check its sensor or unit",
            )
