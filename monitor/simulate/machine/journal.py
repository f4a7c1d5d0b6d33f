"""The logbook of an arm, for tests that judge what happened to it: whose programs ran, when the arm moved, and what pressed against it.

Times are on the controller's own clock, which begins again when the controller starts; `boot` counts the starts.
"""

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from monitor.recording import Array
from monitor.simulate.machine.state import DEVIATES, Clock, ErrorCode, SafetyMode

LENGTH = 200  # entries of each kind; older entries are dropped
MOVING_RAD_S = 0.02  # an arm moves while a joint is faster; after a hard stop the servo settles at up to 0.015 rad/s
STOOD_S = 0.1  # after so long without motion a stretch of motion has ended
TOUCH_NM = 1e-6  # a smaller contact torque is rounding

CLIENT, SOMEBODY_ELSE, SIMULATOR = "client", "somebody else", "simulator"  # whose a program is: that of a script that came over a port, …


@dataclass(slots=True)
class ProgramRun:
    """One program, from its start to its end."""

    number: int
    boot: int
    owner: str  # CLIENT, SOMEBODY_ELSE or SIMULATOR
    began_s: float
    ended_s: float | None = None
    kind: str = ""  # as in a Stop: "watchdog", "protective_stop", "emergency_stop", "program_stop" or "program_end"
    stopped_by: str = (
        ""  # "itself", "watchdog", "safety", "dashboard", "power", "controller", or the owner of the program or script that did
    )
    reason: str = ""


@dataclass(slots=True)
class Motion:
    """One stretch of motion of the arm."""

    boot: int
    program: int | None  # the number of the program that ran when it began
    began_s: float
    stood_s: float | None = None
    fastest_rad_s: float = 0.0


@dataclass(slots=True)
class Touch:
    """One contact of the arm with something outside."""

    boot: int
    began_s: float
    ended_s: float | None = None
    largest_nm: float = 0.0  # torque on the joint that bears most of it
    joint: int = 0  # 1 … J, that joint


class Logbook:
    """Watches one arm. `boot` is the number of the controller's present start."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.boot = 1
        self.programs: deque[ProgramRun] = deque(maxlen=LENGTH)
        self.motions: deque[Motion] = deque(maxlen=LENGTH)
        self.touches: deque[Touch] = deque(maxlen=LENGTH)
        self._run: ProgramRun | None = None
        self._motion: Motion | None = None
        self._still_since_s: float | None = None
        self._touch: Touch | None = None
        self._numbers = 0

    def take_over(self, before: "Logbook") -> None:
        """Go on after the logbook of the controller that ran before on the same arm. It ended without a word: the arm stands."""
        self.boot = before.boot + 1
        before.cut()
        self.programs, self.motions, self.touches, self._numbers = before.programs, before.motions, before.touches, before._numbers

    def cut(self) -> None:
        """The controller is gone, and with it every program; the brakes hold the arm."""
        self.program_ended("power", "power", "the controller was switched off")
        if self._motion is not None:
            self._motion.stood_s, self._motion = self._clock.now_s, None
        if self._touch is not None:
            self._touch.ended_s, self._touch = self._clock.now_s, None

    # --- programs -----------------------------------------------------------------------------------------------
    @property
    def running(self) -> ProgramRun | None:
        """The program that runs."""
        return self._run

    def program_began(self, owner: str) -> None:
        """A program has started."""
        self._numbers += 1
        self._run = ProgramRun(self._numbers, self.boot, owner, self._clock.now_s)
        self.programs.append(self._run)

    def program_ended(self, kind: str, stopped_by: str, reason: str) -> None:
        """The program that ran has ended."""
        run, self._run = self._run, None
        if run is not None:
            run.ended_s, run.kind, run.stopped_by, run.reason = self._clock.now_s, kind, stopped_by, reason

    # --- the arm ------------------------------------------------------------------------------------------------
    def watch(self, qd: Array, contact_nm: Array | None) -> None:
        """Note what the arm did in a control period: joint speeds (J,) [rad/s], and torques (J,) from outside [N·m], None without any."""
        fastest = max(map(abs, qd.tolist()))
        if self._motion is not None or fastest > MOVING_RAD_S:
            self._watch_motion(fastest)
        if self._touch is not None or contact_nm is not None:
            self._watch_touch(contact_nm)

    def _watch_motion(self, fastest_rad_s: float) -> None:
        now_s, motion = self._clock.now_s, self._motion
        if fastest_rad_s > MOVING_RAD_S:
            if motion is None:
                motion = self._motion = Motion(self.boot, None if self._run is None else self._run.number, now_s)
                self.motions.append(motion)
            motion.fastest_rad_s = max(motion.fastest_rad_s, fastest_rad_s)
            self._still_since_s = None
            return
        if self._still_since_s is None:
            self._still_since_s = now_s
        if motion is not None and now_s - self._still_since_s >= STOOD_S:
            motion.stood_s, self._motion = self._still_since_s, None

    def _watch_touch(self, contact_nm: Array | None) -> None:
        sizes = [0.0] if contact_nm is None else [abs(torque) for torque in contact_nm.tolist()]
        largest, touch = max(sizes), self._touch
        if largest <= TOUCH_NM:
            if touch is not None:
                touch.ended_s, self._touch = self._clock.now_s, None
            return
        if touch is None:
            touch = self._touch = Touch(self.boot, self._clock.now_s)
            self.touches.append(touch)
        if largest > touch.largest_nm:
            touch.largest_nm, touch.joint = largest, sizes.index(largest) + 1

    def document(self) -> dict[str, Any]:
        """The entries as JSON values."""
        return {
            "boot": self.boot,
            "programs": [asdict(run) for run in self.programs],
            "motions": [asdict(motion) for motion in self.motions],
            "touches": [asdict(touch) for touch in self.touches],
        }


# --- The journal of a controller: stops, messages for the primary port, and refused requests ------------

log = logging.getLogger(__name__)

OPEN_STOPS = 9  # stops that wait for the arm to come to rest; older ones are no longer watched


@dataclass(slots=True)
class Stop:
    """One stop of a program or of the arm. Times are on the controller's clock."""

    at_s: float
    kind: str  # "watchdog" | "protective_stop" | "emergency_stop" | "program_stop" | "program_end"
    reason: str
    stood_at_s: float | None = None  # when the arm came to rest


class ProgramMessage(NamedTuple):
    """A program started or stopped."""

    at_s: float
    title: str
    text: str


class SafetyMessage(NamedTuple):
    """The safety mode changed."""

    at_s: float
    mode: SafetyMode


class ErrorMessage(NamedTuple):
    """The reason of a protective stop."""

    at_s: float
    text: str
    code: ErrorCode = DEVIATES
    argument: int = 0  # of C153 the joint, from 0


class ExceptionMessage(NamedTuple):
    """A runtime exception ended a program, or a script could not be compiled. Line and column count from 1."""

    at_s: float
    text: str
    line: int = 1
    column: int = 1


class TextMessage(NamedTuple):
    """A program wrote a text into the log."""

    at_s: float
    text: str


Message = ProgramMessage | SafetyMessage | ErrorMessage | ExceptionMessage | TextMessage


class Journal:
    """Records what happens to one controller."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.logbook = Logbook(clock)
        self.stops: deque[Stop] = deque(maxlen=LENGTH)
        self.messages: deque[Message] = deque(maxlen=LENGTH)  # not yet sent
        self.refused_commands: deque[int] = deque(maxlen=LENGTH)
        self.refused_scripts: deque[str] = deque(maxlen=LENGTH)
        self.scripts_started = self.watchdog_trips = 0
        self._open: list[Stop] = []  # the arm has not come to rest after these

    def stop(self, kind: str, reason: str) -> None:
        """Record a stop."""
        log.info("stop kind=%s at=%.3f reason=%s", kind, self._clock.now_s, reason)
        stop = Stop(self._clock.now_s, kind, reason)
        self.stops.append(stop)
        self._open = [*self._open[1 - OPEN_STOPS :], stop]

    @property
    def has_open_stops(self) -> bool:
        """Whether the arm has yet to come to rest after a stop."""
        return bool(self._open)

    def close_stops(self) -> None:
        """Record that the arm has come to rest."""
        for stop in self._open:
            stop.stood_at_s = self._clock.now_s
        self._open = []

    def tell(self, kind: Callable[..., Message], *content: Any) -> None:
        """Report a message of this kind on the primary port; its time is now."""
        self.messages.append(kind(self._clock.now_s, *content))
