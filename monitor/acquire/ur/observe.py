"""A look at an arm: a few rows by a plain socket, as one state. No process is started for it, so it takes a fifth of a second."""

import time

import numpy as np

from monitor.acquire.driver import SessionEnded
from monitor.acquire.rows import COLUMN
from monitor.acquire.state import ArmState, arm_state
from monitor.acquire.ur.listening import Listening
from monitor.recording import Array

ROWS = 13  # the accelerometer is averaged over so many: 0.1 s at 125 Hz


def observe(session: Listening, timeout_s: float) -> ArmState | None:
    """The state of the arm in the last of ROWS ticks, with the mean of their accelerometer readings; None where they do not all come.

    The session is ended. A row that repeats the time of the one before is no new tick: a controller that hangs is not in any state.
    """
    rows: list[Array] = []
    until = time.monotonic() + timeout_s
    try:
        while len(rows) < ROWS and (left_s := until - time.monotonic()) > 0.0:
            for frame in session.frames(left_s):
                if isinstance(frame, dict):
                    return None  # the connection was lost
                if not rows or frame[0] != rows[-1][0]:
                    rows.append(frame)
    except SessionEnded:
        return None
    finally:
        session.end()
    if len(rows) < ROWS:
        return None
    accelerometer = COLUMN["actual_tool_accelerometer"]
    last = rows[-1].copy()
    last[accelerometer] = np.mean([row[accelerometer] for row in rows[-ROWS:]], axis=0)
    return arm_state(last)
