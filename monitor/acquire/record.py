"""Recording a motion that another program makes: the arm is only listened to, one row a tick."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from monitor import __version__
from monitor.acquire.driver import Driver, SessionEnded
from monitor.acquire.rows import columns, latency_p99_ms, recording_from_columns, tick_quality
from monitor.acquire.ur.driver import UNIVERSAL_ROBOTS
from monitor.errors import MotionRefused, RobotUnreachable
from monitor.recording import Array, Context, Recording

POLL_S = 0.05  # how often the caller is asked whether to stop
SILENCE_S = 1.0  # no row for so long: the connection is gone, or the controller's clock stands still
BY_DURATION, BY_REQUEST = "seconds", "asked"  # how a recording ended as planned; anything else is a message


def record(
    host: str,
    *,
    rate_hz: float,
    context: Context,
    seconds: float | None = None,
    should_stop: Callable[[], bool] | None = None,
    startup_timeout_s: float = 10.0,
    on_progress: Callable[[float, int], None] | None = None,
    driver: Driver = UNIVERSAL_ROBOTS,
) -> Recording:
    """Listen for so many seconds of the controller's clock, or until `should_stop` returns true; one row a tick.

    `on_progress` receives the duration so far [s] and the count of rows.

    Raises RobotUnreachable where fewer than two rows come; MotionRefused where the arm has another serial number than the context.
    """
    identity = driver.identity(host)
    if identity.serial is not None and context.serial is not None and identity.serial != context.serial:
        raise MotionRefused(f"{host}: the controller's serial number is {identity.serial}, expected {context.serial}")
    session = driver.listen(host, rate_hz, every_tick=True)
    rows: list[Array] = []
    began_unix_s: float | None = None
    received_at = time.monotonic()
    ended = None
    try:
        while ended is None:
            try:
                for frame in session.frames(POLL_S):
                    if isinstance(frame, dict):
                        ended = str(frame["text"])
                        break
                    began_unix_s = began_unix_s or time.time()
                    received_at = time.monotonic()
                    rows.append(frame)
            except SessionEnded:
                ended = f"{host}: the listening process died"
            lasted_s = rows[-1][0] - rows[0][0] if rows else 0.0
            if on_progress is not None:
                on_progress(lasted_s, len(rows))
            if seconds is not None and lasted_s >= seconds - 0.5 / rate_hz:
                ended = BY_DURATION
            elif should_stop is not None and should_stop():
                ended = BY_REQUEST
            elif ended is None and time.monotonic() - received_at > (SILENCE_S if rows else startup_timeout_s):
                ended = f"{host}: no RTDE data for {SILENCE_S if rows else startup_timeout_s:g} s"
    finally:
        session.end()
    if len(rows) < 2:
        raise RobotUnreachable(
            ended if ended not in {BY_DURATION, BY_REQUEST} else f"{host}: nothing was heard before the end was asked for"
        )
    known = dataclasses.replace(
        context,
        serial=identity.serial or context.serial,
        firmware=identity.firmware or context.firmware,
        trajectory_digest=None,  # the motion is another program's
        software=f"joint-monitor {__version__}",
        recorded_at_unix_s=began_unix_s,
    )
    return _recording(np.array(rows), known, rate_hz, {"host_clock_at_start_unix_s": began_unix_s, "ended": ended})


def _recording(rows: Array, context: Context, rate_hz: float, ending: dict[str, Any]) -> Recording:
    """The recording of rows (N, WIDTH), with the payload that the controller reports where the context names none."""
    table = columns(rows)
    payload = table["payload"][0]
    if context.payload_kg is None and np.isfinite(payload):
        context = dataclasses.replace(context, payload_kg=float(payload))
    quality = {
        **tick_quality(table, rate_hz),
        "latency_p99_ms": latency_p99_ms(table),
        "rate_hz": rate_hz,
        "controller_clock_at_start_s": float(table["timestamp"][0]),
        **ending,
    }
    return recording_from_columns(table, context=context, quality=quality, source=f"recorded on {context.robot or 'an arm'}")
