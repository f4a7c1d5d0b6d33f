"""What can go wrong, named by what the operator can do about it.

A `MonitorError` is a sentence for a person: what was wrong, where, and what would be right. The command line prints
it without a traceback and ends with the error's `exit_code`; anything else that escapes is a fault of ours (exit 1).
"""


class MonitorError(Exception):
    """Base of every error that joint-monitor raises on purpose."""

    exit_code = 1


class BadInput(MonitorError):
    """A file, argument or message is not what it should be: correct it and call again."""

    exit_code = 2


class BadConfiguration(BadInput):
    """The configuration is wrong: every mistake is listed with its key. `run` ends with 78 (EX_CONFIG)."""


class Unidentifiable(BadInput):
    """The recording cannot carry an identification: it holds no motion, or too little of it."""


class MotionRefused(MonitorError):
    """A guard does not allow the arm to move: nothing was sent to it."""

    exit_code = 2


class RobotUnreachable(MonitorError):
    """No answer from the controller: look at the cable, the address, the power."""


class ReplayAborted(MonitorError):
    """The arm was moving and was stopped: the message says why; nothing of it is learnt from.

    `cause` is the reason in one word, for the history: "protective_stop", "connection_lost", "child_died", …
    """

    # nothing was wrong with the arm or with what stands around it: the next window may try again without anybody
    HARMLESS = frozenset(
        {
            "parent_asked_to_stop",
            "permit_withdrawn",
            "connection_lost",
            "stalled",
            "late",
            "timeout",
            "child_died",
            "controller_restarted",
            "program_stopped",
            "no_control",
            "no_watchdog",
            "servo_refused",
            "speed_scaling",
            "joint_temperature",
        }
    )

    def __init__(self, message: str, cause: str = "unknown") -> None:
        super().__init__(message)
        self.cause = cause

    @property
    def needs_a_person(self) -> bool:
        """Before the arm moves again, somebody must look: a protective or emergency stop, torque or a path that was not as expected."""
        return self.cause not in self.HARMLESS


class StoreError(MonitorError):
    """The history cannot be read or written: look at the disk and at who else uses the folder."""


class StoreUnavailable(StoreError):
    """The disk does not take it now: full, read-only, failing. It may again, so whoever can waits for it."""


class BusError(MonitorError):
    """The Zenoh session cannot be opened, or nobody answered: look at the endpoint and at the daemon."""
