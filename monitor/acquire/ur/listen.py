"""The listening process: `python -m monitor.acquire.ur.listen`. It receives only, and sends every tick's row to its parent."""

import ipaddress
import time

from monitor.acquire.rows import COLUMN
from monitor.acquire.ur.child import Lifeline, Outbox, begin, leave, request_real_time
from monitor.acquire.ur.receive import TornRow, connect_receiver, read_row
from monitor.acquire.ur.streaming.pacing import PacketTiming


def send_rows(host: str, rate_hz: float, outbox: Outbox, lifeline: Lifeline) -> None:
    """Send rows until the connection is lost; leaves the process where the parent is gone.

    Raises RuntimeError or TornRow where the connection breaks off.
    """
    if not ipaddress.ip_address(host).is_loopback:
        request_real_time()  # before ur-rtde starts its threads, which inherit it
    receive, signals = connect_receiver(host, rate_hz)
    timestamp_s = receive.getTimestamp()
    timing = PacketTiming(timestamp_s=timestamp_s, offset_s=time.monotonic() - timestamp_s)
    sent_s = None
    while receive.isConnected():
        timestamp_s, now = receive.getTimestamp(), time.monotonic()
        if timestamp_s != sent_s:
            row, _ = read_row(receive, signals)
            row[COLUMN["host_monotonic_s"]] = time.monotonic()
            sent_s = float(row[0])
            timing = timing.arrived(sent_s, now)
            outbox.row(row)
        lifeline.word()
        began = time.monotonic()
        planned_s = timing.sleep_s(began, 1.0 / rate_hz)
        time.sleep(planned_s)
        timing = timing.woke(time.monotonic() - began - planned_s)


def main() -> None:
    """Listen as the job on standard input says; never returns."""
    job, outbox, lifeline = begin()
    host = job["host"]
    try:
        send_rows(host, job["rate_hz"], outbox, lifeline)
        outbox.message("lost", text=f"{host}: the RTDE connection was lost")
    except (RuntimeError, TornRow) as error:
        outbox.message("lost", text=f"{host}: RTDE: {error}")
    leave(1)


if __name__ == "__main__":
    main()
