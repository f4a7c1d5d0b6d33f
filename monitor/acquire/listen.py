"""Receive-only: the arm's live state, decimated, for predictions and production residuals.

The same discipline as a replay: ur-rtde lives in a child process (`python -m monitor.acquire.listen`) that may be
killed at any moment; the daemon calls `poll` now and then, which restarts a lost child with growing pauses.
Listening never moves an arm, so any address is allowed, and it may go on during a replay.
"""

import ipaddress
import time
from dataclasses import dataclass

import numpy as np

from monitor.acquire.rows import columns
from monitor.acquire.ur.child import Child, ChildLost
from monitor.errors import BadInput
from monitor.recording import Array

LONGEST_POLL_S = 0.02  # live state is decimated: a late look costs nothing
POLL_SHARE = 0.8  # of a period: each row is seen, and hardly one look is in vain
TIMER_SLACK_SHARE = 0.25  # of a period: what a sleep of ur-rtde's thread may last longer; each row is still taken in before the next comes
EVERY_TICK_POLL_S = 0.0003  # the finest sleep that does not burn a core


@dataclass(frozen=True, slots=True, kw_only=True)
class ListenSettings:
    """Whom to listen to, how often, and how patiently."""

    host: str
    rate_hz: float = 10.0
    startup_timeout_s: float = 10.0  # ur-rtde waits for ever for a controller that accepts but does not answer
    silence_timeout_s: float = 3.0
    first_pause_s: float = 1.0
    longest_pause_s: float = 60.0

    def __post_init__(self) -> None:
        """Raises BadInput for a rate that the controller cannot give."""
        if not 1.0 <= self.rate_hz <= 125.0:
            raise BadInput(f"listen: rate_hz = {self.rate_hz!r}; expected 1 to 125")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveState:
    """The arm a moment ago."""

    t_s: float  # controller's clock
    received_monotonic_s: float  # host's clock, of the child's reading
    q: Array  # (J,) [rad]
    qd: Array  # (J,) [rad/s]
    current: Array  # (J,) [A]
    temperature_c: Array  # (J,)
    target_q: Array  # (J,) [rad]
    target_qd: Array  # (J,) [rad/s]
    target_qdd: Array  # (J,) [rad/s²]
    robot_mode: int
    safety_mode: int
    runtime_state: int


def _live(rows: list[Array]) -> list[LiveState]:
    """Rows (WIDTH,) as states; taken apart together, which at 125 Hz is most of what listening costs the daemon."""
    if not rows:
        return []
    table = columns(np.stack(rows))
    return [
        LiveState(
            t_s=float(table["timestamp"][n]),
            received_monotonic_s=float(table["host_monotonic_s"][n]),
            q=table["actual_q"][n],
            qd=table["actual_qd"][n],
            current=table["actual_current"][n],
            temperature_c=table["joint_temperatures"][n],
            target_q=table["target_q"][n],
            target_qd=table["target_qd"][n],
            target_qdd=table["target_qdd"][n],
            robot_mode=int(table["robot_mode"][n]),
            safety_mode=int(table["safety_mode"][n]),
            runtime_state=int(table["runtime_state"][n]),
        )
        for n in range(len(rows))
    ]


class Listener:
    """Live state by polling; no thread of its own. Call every method from one thread that outlives the listener."""

    def __init__(self, settings: ListenSettings) -> None:
        self._settings = settings
        self._child: Child | None = None
        self._latest: LiveState | None = None
        self._wanted = False
        self._heard_at = 0.0
        self._spoke = False  # this child has delivered a row
        self._next_try_at = 0.0
        self._pause_s = settings.first_pause_s
        self.problem: str | None = None  # why the arm cannot be heard; None while it can, or before the first try

    @property
    def reachable(self) -> bool:
        """Rows are coming."""
        return self._child is not None and self._spoke and time.monotonic() - self._heard_at < self._settings.silence_timeout_s

    def start(self) -> None:
        """Begin to listen; `poll` does the work."""
        self._wanted = True
        self._next_try_at = 0.0
        self._pause_s = self._settings.first_pause_s
        self.poll()

    def stop(self) -> None:
        """End the child and reap it; `start` may follow."""
        self._wanted = False
        self._drop()
        self._latest = None

    def latest(self) -> LiveState | None:
        """The newest state seen by `poll`, or None while the arm cannot be heard."""
        return self._latest

    def poll(self) -> list[LiveState]:
        """Take what has come since the last call, oldest first; restart a child that is lost. Never waits."""
        if not self._wanted:
            return []
        now = time.monotonic()
        if self._child is None:
            if now >= self._next_try_at:
                self._try(now)
            return []
        rows: list[Array] = []
        last_word = None
        try:
            for frame in self._child.frames(0.0):
                if isinstance(frame, dict):
                    last_word = frame["text"]
                else:
                    rows.append(frame)
        except ChildLost:
            last_word = last_word or f"{self._settings.host}: the listening process died"
        fresh = _live(rows)
        if last_word is not None:
            self._lost(now, last_word)
            return fresh
        if fresh:
            self._heard_at, self._spoke, self._latest, self.problem = now, True, fresh[-1], None
            self._pause_s = self._settings.first_pause_s
        patience_s = self._settings.silence_timeout_s if self._spoke else self._settings.startup_timeout_s
        if now - self._heard_at > patience_s:
            self._lost(now, f"{self._settings.host}: no RTDE data for {patience_s:g} s")
        return fresh

    def _try(self, now: float) -> None:
        self._heard_at, self._spoke = now, False
        try:
            self._child = Child(
                "monitor.acquire.listen", {"host": self._settings.host, "rate_hz": self._settings.rate_hz, "every_tick": False}
            )
        except ChildLost as lost:
            self._lost(now, str(lost))

    def _lost(self, now: float, problem: str) -> None:
        self.problem = problem
        self._drop()
        self._next_try_at = now + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, self._settings.longest_pause_s)
        self._latest = None

    def _drop(self) -> None:
        if self._child is not None:
            self._child.end()
            self._child = None


def main() -> None:
    """The child: rows to the parent until the connection or the parent is gone; never returns."""
    from monitor.acquire.rows import COLUMN, Torn, connect_receiver, snapshot
    from monitor.acquire.ur.child import begin, leave, real_time, set_timer_slack

    job, outbox, lifeline = begin()
    host = job["host"]
    if job["every_tick"] and not ipaddress.ip_address(host).is_loopback:
        real_time()  # before ur-rtde starts its threads, which inherit it
    elif not job["every_tick"]:
        set_timer_slack(TIMER_SLACK_SHARE / job["rate_hz"])  # likewise
    poll_s = EVERY_TICK_POLL_S if job["every_tick"] else min(LONGEST_POLL_S, POLL_SHARE / job["rate_hz"])
    try:
        receive, signals = connect_receiver(host, job["rate_hz"])
        set_timer_slack(0.0)  # this thread's own looks come in time
        told_s = None
        while receive.isConnected():
            if receive.getTimestamp() != told_s:
                row, _ = snapshot(receive, signals)
                row[COLUMN["host_monotonic_s"]] = time.monotonic()
                told_s = row[0]
                outbox.row(row)
            lifeline.word()
            time.sleep(poll_s)
        outbox.message("lost", text=f"{host}: the RTDE connection was lost")
    except (RuntimeError, Torn) as error:
        outbox.message("lost", text=f"{host}: RTDE: {error}")
    leave(1)


if __name__ == "__main__":
    main()
