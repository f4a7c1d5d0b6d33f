"""The journal of a controller: stops, messages for the primary port, and refused requests."""

import logging
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from monitor.simulate.controller.clock import Clock
from monitor.simulate.controller.identity.codes import DEVIATES, ErrorCode
from monitor.simulate.controller.logbook import Logbook
from monitor.simulate.controller.modes import SafetyMode

log = logging.getLogger(__name__)

LENGTH = 200  # entries of each kind; older entries are dropped
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

    def program_message(self, title: str, text: str) -> None:
        """Report that a program started or stopped."""
        self.messages.append(ProgramMessage(self._clock.now_s, title, text))

    def exception_message(self, text: str, line: int = 1, column: int = 1) -> None:
        """Report a runtime exception, or a script that cannot be compiled, with its place in the script."""
        self.messages.append(ExceptionMessage(self._clock.now_s, text, line, column))

    def text_message(self, text: str) -> None:
        """Report what a program wrote into the log."""
        self.messages.append(TextMessage(self._clock.now_s, text))

    def safety_message(self, mode: SafetyMode) -> None:
        """Report a change of the safety mode."""
        self.messages.append(SafetyMessage(self._clock.now_s, mode))

    def error_message(self, text: str, code: ErrorCode = DEVIATES, argument: int = 0) -> None:
        """Report the reason of a protective stop."""
        self.messages.append(ErrorMessage(self._clock.now_s, text, code, argument))
