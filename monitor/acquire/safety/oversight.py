"""What is asked of others while the arm moves, in threads of their own: whether remote control is still on, and the permit still given.

The thread that follows the session only reads what they found, so that a slow answer delays nothing.
"""

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import NamedTuple

from monitor.acquire.safety.inputs import Permit
from monitor.errors import RobotUnreachable
from monitor.reason import Reason, Sentence

CONTROL_EVERY_S = 0.2  # between two questions whether remote control is on: the arm stands within 1 s of its loss
CONTROL_SILENCE_S = 2.0  # a dashboard that was closed and opened again answers within that time
NAME_EVERY_S = 0.2  # between two questions for the name of our program, until it plays
PERMIT_EVERY_S = 1.0  # between two questions for the permit
PERMIT_ANSWER_S = 0.5  # one question waits so long for its answer
PERMIT_SILENCE_S = 1.9  # two questions in a row without an answer: the permit is gone
LEAVE_S = 0.6  # a question that is under way when the motion ends has its answer by then


class Interruption(NamedTuple):
    """Why a motion must end. `cause` is the kind of it, by which the history and the next motion go."""

    cause: str
    reason: Reason

    @property
    def text(self) -> str:
        """In English."""
        return self.reason.text


Question = Callable[[threading.Event], Interruption | None]  # returns where it finds a reason, or once the event is set


SUPERVISION_FAILED = Sentence("supervision_failed", "the supervision of the motion failed: {kind}: {why}")


class Oversight:
    """Runs questions while the arm moves; `finding` is the first reason to stop that one of them found."""

    def __init__(self, questions: tuple[Question, ...], *, playing_program: Callable[[], str | None]) -> None:
        """`playing_program` gives the name of the program that plays; None while none does. The first one that plays is ours."""
        self._questions, self._playing_program = questions, playing_program
        self._over = threading.Event()
        self._threads: list[threading.Thread] = []
        self.finding: Interruption | None = None
        self.program_name: str | None = None  # of our program, as the robot calls it; None: it is not known

    def start(self) -> None:
        """Begin to ask."""
        for question in (*self._questions, self._note_name):
            self._threads.append(threading.Thread(target=self._run, args=(question,), name="oversight", daemon=True))
            self._threads[-1].start()

    def cancel(self) -> None:
        """Ask no more; what is found from now on does not count."""
        self._over.set()

    def join(self) -> None:
        """Wait for the questions that were under way."""
        until = time.monotonic() + LEAVE_S
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def _note_name(self, over: threading.Event) -> None:
        while self.program_name is None and not over.wait(NAME_EVERY_S):
            with suppress(RobotUnreachable):
                self.program_name = self._playing_program()

    def _run(self, question: Question) -> None:
        try:
            found = question(self._over)
        except Exception as error:  # a question that cannot be asked any more is no answer
            found = Interruption("internal", SUPERVISION_FAILED(kind=type(error).__name__, why=str(error)))
        if found is not None and self.finding is None and not self._over.is_set():
            self.finding = found


LOCAL_CONTROL_TAKEN = Sentence("local_control_taken", "the controller was taken into local control")
REMOTE_CONTROL_UNKNOWN = Sentence("remote_control_unknown", "whether remote control is on is not known for {silent_s:.1f} s: {why}")


def remote_control_kept(converse: Callable[[], AbstractContextManager[Callable[[], bool | None]]]) -> Question:
    """The robot is in remote control, and says so again and again."""

    def question(over: threading.Event) -> Interruption | None:
        heard_at, why = time.monotonic(), ""
        while not over.is_set():
            try:
                with converse() as ask:
                    while not over.is_set():
                        remote = ask()
                        if remote is False:
                            return Interruption("local_control", LOCAL_CONTROL_TAKEN())
                        if remote is None:
                            why = "the dashboard says neither true nor false"
                            break
                        heard_at = time.monotonic()
                        over.wait(CONTROL_EVERY_S)
            except RobotUnreachable as error:
                why = str(error)
            if (silent_s := time.monotonic() - heard_at) > CONTROL_SILENCE_S:
                return Interruption("local_control", REMOTE_CONTROL_UNKNOWN(silent_s=silent_s, why=why))
            over.wait(CONTROL_EVERY_S)
        return None

    return question


PERMIT_UNANSWERED = Sentence("permit_unanswered", "nobody has answered permit/replay for {silent_s:.1f} s")


def permit_kept(ask: Callable[[float], Permit | None]) -> Question:
    """The permit is still given. `ask` waits for an answer at most so long [s]."""

    def question(over: threading.Event) -> Interruption | None:
        heard_at = time.monotonic()
        while not over.wait(PERMIT_EVERY_S):
            answer = ask(PERMIT_ANSWER_S)
            if answer is not None and not answer.given:
                return Interruption("permit_withdrawn", answer.reason)
            if answer is not None:
                heard_at = time.monotonic()
            elif (silent_s := time.monotonic() - heard_at) > PERMIT_SILENCE_S:
                return Interruption("permit_withdrawn", PERMIT_UNANSWERED(silent_s=silent_s))
        return None

    return question
