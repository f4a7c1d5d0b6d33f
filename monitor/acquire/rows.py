"""What ur-rtde is asked for, and how one controller tick travels from a child process to the daemon.

Only names that ur-rtde decodes: one it does not know would shift every later variable without an error.
"""

import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from monitor.recording import Array, Context, Recording

if TYPE_CHECKING:
    from rtde_receive import RTDEReceiveInterface

JOINTS = 6  # a Universal Robots arm


class Signal(NamedTuple):
    """One RTDE variable: its name, its place in the row, the getter of ur-rtde that reads it."""

    variable: str
    width: int
    getter: str
    optional: bool = False  # not every generation reports it; NaN in the row then


SIGNALS: tuple[Signal, ...] = (
    Signal("timestamp", 1, "getTimestamp"),
    Signal("actual_q", JOINTS, "getActualQ"),
    Signal("actual_qd", JOINTS, "getActualQd"),
    Signal("actual_current", JOINTS, "getActualCurrent"),
    Signal("joint_temperatures", JOINTS, "getJointTemperatures"),
    Signal("target_q", JOINTS, "getTargetQ"),
    Signal("target_qd", JOINTS, "getTargetQd"),
    Signal("target_qdd", JOINTS, "getTargetQdd"),
    Signal("target_current", JOINTS, "getTargetCurrent"),
    Signal("target_moment", JOINTS, "getTargetMoment"),
    Signal("robot_mode", 1, "getRobotMode"),
    Signal("safety_mode", 1, "getSafetyMode"),
    Signal("runtime_state", 1, "getRuntimeState"),
    Signal("safety_status_bits", 1, "getSafetyStatusBits"),
    Signal("speed_scaling", 1, "getSpeedScaling", optional=True),
    Signal("target_speed_fraction", 1, "getTargetSpeedFraction", optional=True),  # the slider; speed_scaling is the limiter's
    Signal("payload", 1, "getPayload", optional=True),  # not before 3.11 and 5.6
    Signal("payload_cog", 3, "getPayloadCog", optional=True),
    Signal("actual_tool_accelerometer", 3, "getActualToolAccelerometer", optional=True),
    Signal("actual_digital_input_bits", 1, "getActualDigitalInputBits", optional=True),
)
# what the child adds to a row of the stream
ADDED = (("commanded_q", JOINTS), ("host_monotonic_s", 1))


def _places() -> dict[str, slice]:
    places, at = {}, 0
    for name, width in [*((signal.variable, signal.width) for signal in SIGNALS), *ADDED]:
        places[name] = slice(at, at + width)
        at += width
    return places


COLUMN = _places()
WIDTH = COLUMN["host_monotonic_s"].stop


class Torn(Exception):
    """A getter did not deliver what its variable holds: the connection went away while reading."""


def connect_receiver(host: str, rate_hz: float) -> tuple["RTDEReceiveInterface", tuple[Signal, ...]]:
    """A receiving connection, and what of SIGNALS this controller reports. Call it only in a child process.

    A controller that lacks a variable refuses the whole request and names the variable: what is optional is then left out.
    Raises RuntimeError as ur-rtde does.
    """
    from rtde_receive import RTDEReceiveInterface

    signals = SIGNALS
    while True:
        try:
            return RTDEReceiveInterface(host, rate_hz, [signal.variable for signal in signals]), signals
        except RuntimeError as error:
            words = set(re.findall(r"\w+", str(error)))
            fewer = tuple(signal for signal in signals if not (signal.optional and signal.variable in words))
            if len(fewer) == len(signals):
                raise
            signals = fewer


def snapshot(receive: "RTDEReceiveInterface", signals: tuple[Signal, ...] = SIGNALS, attempts: int = 5) -> tuple[Array, int]:
    """One complete row (WIDTH,) of one tick, and how often it had to be read again.

    ur-rtde's getters are not atomic together: a row counts only if the timestamp is the same before and after.
    Raises Torn where a getter returns nothing or every attempt met a new tick.
    """
    row = np.full(WIDTH, np.nan)
    for attempt in range(attempts):
        for signal in signals:
            value = getattr(receive, signal.getter)()
            if signal.width > 1 and len(value) != signal.width:
                raise Torn(f"{signal.variable} has {len(value)} values; expected {signal.width}")
            # NaN is what is not reported; what is reported and is no number must not pass for that
            row[COLUMN[signal.variable]] = np.where(np.isnan(value), np.inf, value) if signal.optional else value
        if receive.getTimestamp() == row[0]:
            return row, attempt
    raise Torn(f"no row was complete within {attempts} readings")


def columns(rows: Array) -> dict[str, Array]:
    """Rows (N, WIDTH) by the name of the variable: (N,) or (N, J)."""
    return {name: rows[:, place.start] if place.stop - place.start == 1 else rows[:, place] for name, place in COLUMN.items()}


def recording_from_columns(table: dict[str, Array], *, context: Context, quality: dict[str, Any], source: str) -> Recording:
    """The recording whose signals these columns are."""
    return Recording(
        t_s=table["timestamp"],
        q=table["actual_q"],
        qd=table["actual_qd"],
        current=table["actual_current"],
        temperature_c=table["joint_temperatures"],
        target_q=table["target_q"],
        target_qd=table["target_qd"],
        target_qdd=table["target_qdd"],
        target_current=table["target_current"],
        target_moment=table["target_moment"],
        robot_mode=table["robot_mode"],
        safety_mode=table["safety_mode"],
        runtime_state=table["runtime_state"],
        speed_scaling=table["speed_scaling"],
        context=context,
        quality=quality,
        source=source,
    )
