"""Rows by ur-rtde, in the process that moves an arm. Import it only there: its constructor may hang with all of its process.

Only variables that ur-rtde decodes are asked for: a variable that it does not know would shift every later one without an error.

The controller sends one packet every tick. A packet's arrival, on the host's clock, differs from its own timestamp by an offset that hardly
changes, so the next arrival can be predicted. The cycle sleeps until shortly before it, and checks every POLL_S from then on. To check
every POLL_S during the whole tick would take much more processor time, and would not find the packet sooner.
"""

import math
import re
from typing import NamedTuple

import numpy as np
from rtde_receive import RTDEReceiveInterface

from monitor.acquire.ur.rtde import COLUMN, SIGNALS, WIDTH, Signal
from monitor.recording import Array

POLL_S = 0.0003  # between two checks around the expected arrival; shorter sleeps take more processor time and hardly gain precision
MARGIN_S = 0.0005  # the cycle wakes so much earlier than the packet is expected: for the jitter of the network and of the search
LARGEST_MARGIN_SHARE = 0.6  # of a tick: on a machine that wakes sleepers very late the cycle still sleeps for a part of each tick
LONGEST_SLEEP_S = 0.008  # one tick at 125 Hz: the parent's words and the connection are checked so often, also at lower rates
OFFSET_RISE = 2e-3  # s per s: twenty times the largest drift of two clocks; a packet that came 1 ms early is forgotten within 0.5 s
MEAN_WEIGHT, DEVIATION_WEIGHT = 1 / 8, 1 / 4  # of the newest delay; Jacobson's estimator as in RFC 6298, section 2
DEVIATIONS = 2.0  # added to the mean delay: then nine wake-ups of ten come in time


class PacketTiming(NamedTuple):
    """When packets arrive, and how late this machine wakes a process that sleeps."""

    timestamp_s: float  # of the newest packet, on the controller's clock
    offset_s: float  # smallest recent difference: host's clock when a packet was seen minus the packet's timestamp
    late_s: float = 0.0  # mean delay of the recent wake-ups
    late_deviation_s: float = 0.0  # mean absolute deviation from it

    def arrived(self, timestamp_s: float, seen_s: float) -> "PacketTiming":
        """The timing after a packet with that timestamp was seen at that time of the host's clock.

        A packet is never seen before it arrives, so the smallest difference is the best estimate. It may rise by OFFSET_RISE only.
        """
        allowed_s = self.offset_s + OFFSET_RISE * max(timestamp_s - self.timestamp_s, 0.0)
        return self._replace(timestamp_s=timestamp_s, offset_s=min(seen_s - timestamp_s, allowed_s))

    def woke(self, late_s: float) -> "PacketTiming":
        """The timing after a sleep that lasted so much longer than asked for."""
        return self._replace(
            late_s=(1.0 - MEAN_WEIGHT) * self.late_s + MEAN_WEIGHT * late_s,
            late_deviation_s=(1.0 - DEVIATION_WEIGHT) * self.late_deviation_s + DEVIATION_WEIGHT * abs(late_s - self.late_s),
        )

    def sleep_s(self, now_s: float, tick_s: float) -> float:
        """How long to sleep now, on the host's clock: until shortly before the next packet; at least POLL_S, at most LONGEST_SLEEP_S.

        Once the packet is due or overdue the answer is POLL_S.
        """
        margin_s = min(MARGIN_S + self.late_s + DEVIATIONS * self.late_deviation_s, LARGEST_MARGIN_SHARE * tick_s)
        expected_s = self.timestamp_s + tick_s + self.offset_s
        return min(max(expected_s - margin_s - now_s, POLL_S), LONGEST_SLEEP_S)


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
