"""The listening process: `python -m monitor.acquire.ur.listen`. It receives only, and sends rows to its parent."""

import ipaddress
import time

from monitor.acquire.rows import COLUMN
from monitor.acquire.ur.child import Lifeline, Outbox, begin, leave, request_real_time, set_timer_slack
from monitor.acquire.ur.receive import TornRow, connect_receiver, read_row
from monitor.acquire.ur.streaming.pacing import PacketTiming

LONGEST_POLL_S = 0.02  # where not every tick counts, a late check costs nothing
POLL_SHARE = 0.8  # of a period between two checks: each row is seen, and few checks find nothing new
TIMER_SLACK_SHARE = 0.25  # of a period: ur-rtde's thread may sleep so much longer and still takes in each row before the next one comes


def send_rows(host: str, rate_hz: float, outbox: Outbox, lifeline: Lifeline, *, every_tick: bool) -> None:
    """Send rows until the connection is lost; leaves the process where the parent is gone.

    Raises RuntimeError or TornRow where the connection breaks off.
    """
    if every_tick and not ipaddress.ip_address(host).is_loopback:
        request_real_time()  # before ur-rtde starts its threads, which inherit it
    elif not every_tick:
        set_timer_slack(TIMER_SLACK_SHARE / rate_hz)  # likewise
    receive, signals = connect_receiver(host, rate_hz)
    set_timer_slack(0.0)  # this thread's checks are on time
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
        planned_s = timing.sleep_s(began, 1.0 / rate_hz) if every_tick else min(LONGEST_POLL_S, POLL_SHARE / rate_hz)
        time.sleep(planned_s)
        timing = timing.woke(time.monotonic() - began - planned_s)


def main() -> None:
    """Listen as the job on standard input says; never returns."""
    job, outbox, lifeline = begin()
    host = job["host"]
    try:
        send_rows(host, job["rate_hz"], outbox, lifeline, every_tick=job["every_tick"])
        outbox.message("lost", text=f"{host}: the RTDE connection was lost")
    except (RuntimeError, TornRow) as error:
        outbox.message("lost", text=f"{host}: RTDE: {error}")
    leave(1)


if __name__ == "__main__":
    main()
