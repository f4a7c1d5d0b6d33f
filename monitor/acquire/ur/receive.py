"""What ur-rtde is asked for, and how one tick becomes a row. Import this module only in a child process.

Only variables that ur-rtde decodes are asked for: a variable that it does not know would shift every later one without an error.
"""

import math
import re

import numpy as np
from rtde_receive import RTDEReceiveInterface

from monitor.acquire.rows import COLUMN, WIDTH
from monitor.acquire.ur.signals import SIGNALS, Signal
from monitor.recording import Array


class TornRow(Exception):
    """A getter did not deliver what its variable holds, because the connection was lost while the row was read."""


def connect_receiver(host: str, rate_hz: float, beside: tuple[str, ...] = ()) -> tuple[RTDEReceiveInterface, tuple[Signal, ...]]:
    """A receiving connection, and those of SIGNALS that this controller reports. `beside`: variables that are received too, in no row.

    A controller that lacks a variable refuses the whole request and names the variable; if it is optional, the request is repeated
    without it. Raises RuntimeError as ur-rtde does.
    """
    signals = SIGNALS
    while True:
        try:
            return RTDEReceiveInterface(host, rate_hz, [*(signal.variable for signal in signals), *beside]), signals
        except RuntimeError as error:
            words = set(re.findall(r"\w+", str(error)))
            fewer = tuple(signal for signal in signals if not (signal.optional and signal.variable in words))
            if len(fewer) == len(signals):
                raise
            signals = fewer


def read_row(receive: RTDEReceiveInterface, signals: tuple[Signal, ...] = SIGNALS, attempts: int = 5) -> tuple[Array, int]:
    """One complete row (WIDTH,) of one tick, and how often it had to be read again.

    ur-rtde's getters are not atomic together: a row counts only if the timestamp is the same before and after.
    Raises TornRow where a getter returns nothing, or where a new tick came during every attempt.
    """
    row = np.full(WIDTH, np.nan)
    for attempt in range(attempts):
        for signal in signals:
            value = getattr(receive, signal.getter)()
            if signal.width > 1 and len(value) != signal.width:
                raise TornRow(f"{signal.variable} has {len(value)} values; expected {signal.width}")
            row[COLUMN[signal.variable]] = _without_nan(value) if signal.optional else value
        if receive.getTimestamp() == row[0]:
            return row, attempt
    raise TornRow(f"no row was complete within {attempts} readings")


def _without_nan(value: float | list[float]) -> float | list[float]:
    """The value with inf in place of NaN: in a row NaN means "not reported", and no check takes inf for a missing value.

    In plain Python, because numpy needs ten times as long for one to three numbers.
    """
    if isinstance(value, list):
        return [math.inf if math.isnan(each) else each for each in value]
    return math.inf if math.isnan(value) else value
