"""Recording a motion that somebody else's program makes: receive-only, nothing is sent to the arm but the request for its data.

ur-rtde lives in the listening child, here asked for every tick.
"""

import dataclasses
import time
from collections.abc import Callable

import numpy as np

from monitor import __version__
from monitor.acquire.rows import columns, recording_from_columns
from monitor.acquire.ur import dashboard
from monitor.acquire.ur.child import Child, ChildLost
from monitor.errors import MotionRefused, RobotUnreachable
from monitor.recording import Array, Context, Recording

QUIET_S = 1.0  # no row for so long: the controller is gone, or stands still itself


def record(
    host: str,
    *,
    rate_hz: float,
    context: Context,
    seconds: float | None = None,
    should_stop: Callable[[], bool] | None = None,
    startup_timeout_s: float = 10.0,
    on_progress: Callable[[float, int], None] | None = None,
) -> Recording:
    """Listen for so many seconds of the controller's clock, or until asked to stop; one row a tick.

    Raises RobotUnreachable where no data comes, or less than two rows came; MotionRefused where the arm is another than the context says.
    """
    who = dashboard.identity(host)
    if who.serial is not None and context.serial is not None and who.serial != context.serial:
        raise MotionRefused(f"{host}: the controller's serial number is {who.serial}, expected {context.serial}")
    child = Child("monitor.acquire.listen", {"host": host, "rate_hz": rate_hz, "every_tick": True})
    rows: list[Array] = []
    began_unix_s: float | None = None
    heard_at = time.monotonic()
    ended = None
    try:
        while ended is None:
            try:
                for frame in child.frames(0.05):
                    if isinstance(frame, dict):
                        ended = str(frame["text"])
                        break
                    began_unix_s = began_unix_s or time.time()
                    heard_at = time.monotonic()
                    rows.append(frame)
            except ChildLost:
                ended = f"{host}: the listening process died"
            lasted_s = rows[-1][0] - rows[0][0] if rows else 0.0
            if on_progress is not None:
                on_progress(lasted_s, len(rows))
            if seconds is not None and lasted_s >= seconds - 0.5 / rate_hz:
                ended = "seconds"
            elif should_stop is not None and should_stop():
                ended = "asked"
            elif ended is None and time.monotonic() - heard_at > (QUIET_S if rows else startup_timeout_s):
                ended = f"{host}: no RTDE data for {QUIET_S if rows else startup_timeout_s:g} s"
    finally:
        child.end()
    if len(rows) < 2:
        raise RobotUnreachable(ended if ended not in {"seconds", "asked"} else f"{host}: nothing was heard before the end was asked for")
    known = dataclasses.replace(
        context,
        serial=who.serial or context.serial,
        firmware=who.firmware or context.firmware,
        trajectory_digest=None,  # somebody else's motion
        software=f"joint-monitor {__version__}",
        recorded_at_unix_s=began_unix_s,
    )
    return _recording(np.array(rows), known, rate_hz, ended, began_unix_s)


def _recording(rows: Array, context: Context, rate_hz: float, ended: str, began_unix_s: float | None) -> Recording:
    table = columns(rows)
    t_s, host_s = table["timestamp"], table["host_monotonic_s"]
    ticks = np.diff(t_s) * rate_hz
    latency_ms = 1000.0 * (host_s - t_s - np.min(host_s - t_s))
    payload = table["payload"][0]
    if context.payload_kg is None and np.isfinite(payload):
        context = dataclasses.replace(context, payload_kg=float(payload))
    return recording_from_columns(
        table,
        context=context,
        quality={
            "missed_ticks": int(np.sum(np.maximum(np.round(ticks) - 1, 0))),
            "duplicated_ticks": int(np.sum(ticks < 0.5)),
            "latency_p99_ms": float(np.quantile(latency_ms, 0.99)),
            "rate_hz": rate_hz,
            "controller_clock_at_start_s": float(t_s[0]),
            "host_clock_at_start_unix_s": began_unix_s,
            "ended": ended,
        },
        source=f"recorded on {context.robot or 'an arm'}",
    )
