"""The observing process: `python -m monitor.acquire.ur.observe`. It receives a few rows, sends one to its parent, and ends."""

import time

import numpy as np

from monitor.acquire.rows import COLUMN
from monitor.acquire.ur.child import begin, leave
from monitor.acquire.ur.receive import TornRow, connect_receiver, read_row
from monitor.recording import Array

ROWS = 13  # the accelerometer is averaged over so many: 0.1 s at 125 Hz
ROW_POLL_S = 0.001  # between two checks for a new row: an eighth of a tick at 125 Hz, so no row is missed


def main() -> None:
    """Send the last of ROWS rows with the mean of their accelerometer readings, or a message why there is none; never returns."""
    job, outbox, lifeline = begin()
    try:
        receive, signals = connect_receiver(job["host"], job["rate_hz"])
        rows: list[Array] = []
        timestamp_s = None
        while receive.isConnected() and len(rows) < ROWS:
            if receive.getTimestamp() != timestamp_s:
                row, _ = read_row(receive, signals)
                timestamp_s = row[0]
                rows.append(row)
            lifeline.word()
            time.sleep(ROW_POLL_S)
        if len(rows) == ROWS:
            column = COLUMN["actual_tool_accelerometer"]
            rows[-1][column] = np.mean([row[column] for row in rows], axis=0)
            outbox.row(rows[-1])
            leave(0)
        outbox.message("lost", text="the RTDE connection was lost")
    except (RuntimeError, TornRow) as error:
        outbox.message("lost", text=f"RTDE: {error}")
    leave(1)


if __name__ == "__main__":
    main()
