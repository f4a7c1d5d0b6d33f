"""Errors, each named by what the operator can do about it.

A `MonitorError` is a sentence for a person: what was wrong, where, and what would be right. The command line prints it without a traceback
and ends with the error's `exit_code`. Any other exception is a defect of this software (exit code 1).
"""

import errno
from typing import NamedTuple

from monitor.reason import Reason, Sentence, reason_of

DOES_NOT_HOLD = Sentence("condition_does_not_hold", "{condition}: {why}")
AT_HOST = Sentence("at_host", "{host}: {why}")
AFTER_IT = Sentence("after_it", "{ended}; after it {what}")


class MonitorError(Exception):
    """Base of every error that joint-monitor raises on purpose. `reason` is what it says, as a value; str() is its English text."""

    exit_code = 1

    def __init__(self, said: str | Reason = "") -> None:
        super().__init__(str(said))
        self.reason = reason_of(said)


class BadInput(MonitorError):
    """A file, argument or message is wrong: correct it and call again."""

    exit_code = 2


class BadConfiguration(BadInput):
    """The configuration is wrong: the message lists every mistake with its key. `run` ends with 78 (EX_CONFIG)."""


class Unidentifiable(BadInput):
    """The recording cannot carry an identification: it holds no motion, or too little of it."""


class MotionRefused(MonitorError):
    """A guard does not allow the arm to move. Nothing was sent to the arm."""

    exit_code = 2

    @property
    def condition(self) -> str | None:
        """The name of the condition that does not hold; None where it is none of those of a motion."""
        return str(self.reason.parameters["condition"]) if self.reason.code == DOES_NOT_HOLD.code else None


class RobotUnreachable(MonitorError):
    """The controller does not answer: check the cable, the address and the power."""


class LastSeen(NamedTuple):
    """An arm as it was last seen in a motion. NaN: not reported."""

    host_s: float  # this host's monotonic clock
    controller_s: float  # the controller's clock
    q: tuple[float, ...]  # (J,) [rad]
    qd: tuple[float, ...]  # (J,) [rad/s]
    payload_kg: float


class ReplayAborted(MonitorError):
    """The arm was moving and was stopped. The message gives the reason. The replay is not learned from.

    `cause` is the reason in one word, for the history: "protective_stop", "connection_lost", "child_died", …
    """

    # causes that need no person: neither the arm nor its surroundings had a fault, so the next window may try again
    HARMLESS = frozenset(
        {
            "parent_asked_to_stop",
            "permit_withdrawn",
            "motion_forbidden",
            "local_control",
            "connection_lost",
            "stalled",
            "late",
            "timeout",
            "child_died",
            "program_stopped",
            "no_control",
            "no_watchdog",
            "servo_refused",
            "speed_scaling",
            "joint_temperature",
        }
    )

    # of these, the causes of this machine or of somebody whom the motion asks: nothing but us stopped the arm, and the way that it came is
    # as free as it was. An arm that such an end left on its trajectory is brought back over that way by the next motion.
    BROUGHT_BACK = frozenset({"parent_asked_to_stop", "permit_withdrawn", "motion_forbidden", "late", "timeout", "joint_temperature"})

    # of the harmless, the causes on this machine's side or on the network's: the same window may try again
    TRANSIENT = frozenset({"late", "stalled", "timeout", "child_died", "connection_lost", "no_control", "no_watchdog"})

    def __init__(
        self,
        message: str | Reason,
        cause: str = "unknown",
        *,
        moved: bool = False,
        at_rest: bool = False,
        unknown: Reason | None = None,
        phase: str = "",
        home_q: tuple[float, ...] = (),
        borrowed: bool = False,
        last_seen: LastSeen | None = None,
    ) -> None:
        """`moved`: a program of ours may have moved the arm. `at_rest`: it was seen at rest, and our program has ended.

        `unknown`: what is not known of the arm after this end, or must be put right; None: all that must be known is.
        `phase`: the last one in which targets were sent; empty: none was. `home_q`: (J,) [rad] where the arm should have come back to.
        `borrowed`: the arm was taken from a program that played, and not given back; that program has ended, and a person must start it.
        `last_seen`: the arm as the session last showed it; None: it never did.
        """
        super().__init__(message)
        self.cause, self.moved, self.at_rest, self.unknown = cause, moved, at_rest, unknown
        self.phase, self.home_q, self.borrowed, self.last_seen = phase, home_q, borrowed, last_seen

    @property
    def needs_a_person(self) -> bool:
        """Whether a person must check the arm before it moves again.

        So after a protective stop or an unexpected torque or path, after any end that did not show an arm at rest and in order, and
        where an arm was borrowed and not given back.
        """
        return self.cause not in self.HARMLESS or self.unknown is not None or self.borrowed

    def known(self, unknown: Reason | None) -> "ReplayAborted":
        """The same end after a look at the arm; the message says what is `unknown` after it. What was unknown before it stays so."""
        if unknown is None:
            return self
        return self._with(AFTER_IT(ended=self.reason, what=unknown), self.cause, unknown)

    def stopped(self, cause: str, stop: Reason, unknown: Reason | None) -> "ReplayAborted":
        """The same end, of which a stop by the robot's safety system turned out to be the cause."""
        return self._with(AFTER_IT(ended=self.reason, what=stop), cause, unknown)

    def _with(self, message: Reason, cause: str, unknown: Reason | None) -> "ReplayAborted":
        return ReplayAborted(
            message,
            cause,
            moved=self.moved,
            at_rest=self.at_rest,
            unknown=unknown,
            phase=self.phase,
            home_q=self.home_q,
            borrowed=self.borrowed,
            last_seen=self.last_seen,
        )


class StoreError(MonitorError):
    """The history cannot be read or written: check the disk, and which other program uses the folder."""


class OlderHistory(StoreError):
    """A version before 1.0 wrote this history: begin a new one in another folder. `run` ends with 78 (EX_CONFIG)."""

    exit_code = 2


class StoreInUse(StoreError):
    """Another process writes this history: the daemon, which can be asked on the bus."""


class StoreUnavailable(StoreError):
    """The disk does not accept data now: it is full, read-only or failing. This may pass, so a caller that can wait tries again."""


class ArchiveUnavailable(StoreError):
    """The archive of recordings does not answer now. This may pass, so a caller that can wait tries again."""


class ArchiveRefused(StoreError):
    """The archive of recordings does not let us in, or is not there: keys, bucket, clock or certificate must be put right."""


class ArchiveConflict(StoreError):
    """What the archive holds under a name is missing, or is not what was recorded. It is never overwritten."""


class ArchiveLost(ArchiveConflict):
    """The archive does not have a recording any more that was brought there."""


class BusError(MonitorError):
    """The Zenoh session cannot be opened, or nobody answered: check the endpoint and the daemon."""


def cannot_listen(where: str, number: int | None, why: str) -> MonitorError:
    """The error of an address on which this host does not listen. `number` : the errno.

    A port of another program, or of root's, is a mistake of the configuration: it stays so until a person acts. An address that is not
    this host's may come with the network.
    """
    if number == errno.EADDRINUSE:
        return BadConfiguration(f"{where}: another program listens there; end it, or name another port")
    if number == errno.EACCES:
        return BadConfiguration(f"{where}: this user may not listen there; name a port from 1024 on")
    return BusError(f"{where}: cannot listen there: {why}")
