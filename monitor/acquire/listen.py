"""Listening to an arm: its live state by polling, and the recording of a motion that another program makes, one row a tick.

Listening never moves an arm, so every address is allowed, and it may go on during a replay. The connection is held by a session of the
driver; `Listener.poll` opens a lost one again, with growing pauses.
"""

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor import __version__
from monitor.acquire.driver import Driver, Session, usual_driver
from monitor.acquire.rows import columns, latency_p99_ms, recording_from_columns, tick_quality
from monitor.errors import BadInput, MotionRefused, RobotUnreachable
from monitor.reason import Reason, Sentence, reason_from
from monitor.recording import Array, Context, Recording

NO_DATA_FOR = Sentence("no_rtde_data_for", "{host}: no RTDE data for {limit_s:g} s")
NOTHING_HEARD = Sentence("nothing_heard", "{host}: nothing was heard before the end was asked for")
RECORDS_ANOTHER_ARM = Sentence("records_another_arm", "{host}: the controller's serial number is {serial}, expected {expected}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ListenSettings:
    """Which robot to listen to, how often, and for how long to wait."""

    host: str
    rate_hz: float = 10.0  # rows a second
    startup_timeout_s: float = 10.0  # until the first row: a controller that accepts a connection may still not answer
    silence_timeout_s: float = 3.0  # between two rows
    first_pause_s: float = 1.0  # before the first new try; each further pause is twice as long …
    longest_pause_s: float = 60.0  # … up to this one

    def __post_init__(self) -> None:
        """Raises BadInput for a rate that the controller cannot give."""
        if not 1.0 <= self.rate_hz <= 125.0:
            raise BadInput(f"listen: rate_hz = {self.rate_hz!r}; expected 1 to 125")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveState:
    """The arm's state as one row reports it."""

    t_s: float  # controller's clock
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


def _live_states(rows: list[Array]) -> list[LiveState]:
    """Rows (WIDTH,) as states. They are taken apart together, because that is most of what listening at 125 Hz costs the service."""
    if not rows:
        return []
    table = columns(np.stack(rows))
    return [
        LiveState(
            t_s=float(table["timestamp"][n]),
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
    """The arm's live state, by polling; no thread of its own. Call every method from one thread, which must outlive the listener."""

    def __init__(self, settings: ListenSettings, driver: Driver | None = None) -> None:
        self._settings, self._driver = settings, driver or usual_driver()
        self._session: Session | None = None
        self._latest: LiveState | None = None
        self._wanted = False
        self._received_at = 0.0
        self._has_delivered = False  # this session has delivered a row
        self._next_try_at = 0.0
        self._pause_s = settings.first_pause_s
        self.rows: list[Array] = []  # (WIDTH,) each, what the last `poll` took its states from
        self.problem: Reason | None = None  # why nothing is received from the arm; None while rows come, or before the first try

    @property
    def reachable(self) -> bool:
        """Rows are coming."""
        return self._session is not None and self._has_delivered and time.monotonic() - self._received_at < self._settings.silence_timeout_s

    def start(self) -> None:
        """Begin to listen; every further step happens in `poll`."""
        self._wanted = True
        self._next_try_at = 0.0
        self._pause_s = self._settings.first_pause_s
        self.poll()

    def stop(self) -> None:
        """End the session; `start` may follow."""
        self._wanted = False
        self._drop()
        self._latest = None

    def latest(self) -> LiveState | None:
        """The newest state seen by `poll`, or None while nothing is received from the arm."""
        return self._latest

    def wait(self, timeout_s: float) -> bool:
        """Wait until `poll` may find something, at most so long; False at once where there is no connection that would tell."""
        if self._session is not None:
            self._session.wait(timeout_s)
        return self._session is not None

    def poll(self) -> list[LiveState]:
        """The states that have come since the last call, oldest first. Starts a lost session again when its pause is over; never waits."""
        self.rows = []
        if not self._wanted:
            return []
        now = time.monotonic()
        if self._session is None:
            if now >= self._next_try_at:
                self._received_at, self._has_delivered = now, False
                self._session = self._driver.listen(self._settings.host, self._settings.rate_hz)
            return []
        lost = None
        for frame in self._session.frames(0.0):
            if isinstance(frame, dict):
                lost = reason_from(frame["reason"])
            else:
                self.rows.append(frame)
        fresh = _live_states(self.rows)
        if lost is not None:
            self._lost(now, lost)
            return fresh
        if fresh:
            self._received_at, self._has_delivered, self._latest, self.problem = now, True, fresh[-1], None
            self._pause_s = self._settings.first_pause_s
        patience_s = self._settings.silence_timeout_s if self._has_delivered else self._settings.startup_timeout_s
        if now - self._received_at > patience_s:
            self._lost(now, NO_DATA_FOR(host=self._settings.host, limit_s=patience_s))
        return fresh

    def _lost(self, now: float, problem: Reason) -> None:
        self.problem = problem
        self._drop()
        self._next_try_at = now + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, self._settings.longest_pause_s)
        self._latest = None

    def _drop(self) -> None:
        if self._session is not None:
            self._session.end()
            self._session = None


POLL_S = 0.05  # how often the caller is asked whether to stop
SILENCE_S = 1.0  # no row for so long: the connection is gone, or the controller's clock stands still
BY_DURATION, BY_REQUEST = "seconds", "asked"  # how a recording ended as planned


def record(
    host: str,
    *,
    rate_hz: float,
    context: Context,
    seconds: float | None = None,
    should_stop: Callable[[], bool] | None = None,
    startup_timeout_s: float = 10.0,
    on_progress: Callable[[float, int], None] | None = None,
    driver: Driver | None = None,
) -> Recording:
    """Listen for so many seconds of the controller's clock, or until `should_stop` returns true; one row a tick.

    `on_progress` receives the duration so far [s] and the count of rows.

    Raises RobotUnreachable where fewer than two rows come; MotionRefused where the arm has another serial number than the context.
    """
    driver = driver or usual_driver()
    identity = driver.identity(host)
    if identity.serial is not None and context.serial is not None and identity.serial != context.serial:
        raise MotionRefused(RECORDS_ANOTHER_ARM(host=host, serial=identity.serial, expected=context.serial))
    session = driver.listen(host, rate_hz)
    rows: list[Array] = []
    began_unix_s: float | None = None
    received_at = time.monotonic()
    ended: str | Reason | None = None
    try:
        while ended is None:
            for frame in session.frames(POLL_S):
                if isinstance(frame, dict):
                    ended = reason_from(frame["reason"])
                    break
                began_unix_s = began_unix_s or time.time()
                received_at = time.monotonic()
                rows.append(frame)
            lasted_s = rows[-1][0] - rows[0][0] if rows else 0.0
            if on_progress is not None:
                on_progress(lasted_s, len(rows))
            if seconds is not None and lasted_s >= seconds - 0.5 / rate_hz:
                ended = BY_DURATION
            elif should_stop is not None and should_stop():
                ended = BY_REQUEST
            elif ended is None and time.monotonic() - received_at > (patience_s := SILENCE_S if rows else startup_timeout_s):
                ended = NO_DATA_FOR(host=host, limit_s=patience_s)
    finally:
        session.end()
    if len(rows) < 2:
        raise RobotUnreachable(ended if isinstance(ended, Reason) else NOTHING_HEARD(host=host))
    known = dataclasses.replace(
        context,
        serial=identity.serial or context.serial,
        firmware=identity.firmware or context.firmware,
        trajectory_digest=None,  # the motion is another program's
        software=f"joint-monitor {__version__}",
        recorded_at_unix_s=began_unix_s,
    )
    return _recording(np.array(rows), known, rate_hz, {"host_clock_at_start_unix_s": began_unix_s, "ended": str(ended)})


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
