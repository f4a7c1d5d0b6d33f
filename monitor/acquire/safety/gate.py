"""The last question before an arm moves. The parent asks it while the session holds the connection.

In this order: every condition, the announcement, the time that the announcement gives people, the permit, the conditions that may have
changed meanwhile. What each condition finds is logged.
"""

import logging
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

from monitor.acquire.safety.conditions import AT_THE_LAST, conditions, named_conditions, refuse_unless
from monitor.acquire.safety.inputs import ConditionInputs, ConditionResult, Permit
from monitor.acquire.state import ArmState
from monitor.reason import Sentence

log = logging.getLogger(__name__)

ASK_S = 0.5  # one question waits at most so long for its answer, so that the caller can be asked whether to stop


class AskPermit(Protocol):
    """Asks somebody else for a permit."""

    def __call__(self, about: Mapping[str, Any], timeout_s: float, /) -> Permit | None:
        """The answer about a motion; None where nobody answered within timeout_s."""


class Announce(Protocol):
    """Tells whoever must know that the arm is going to move."""

    def __call__(self, about: Mapping[str, Any], /) -> object:
        """Announce the motion."""


PERMIT_NO_ANSWER = Sentence("permit_no_answer", "permit/replay: no answer within {limit_s:g} s")


class Gate:
    """One replay's way from the first state that was received to `go`."""

    def __init__(self, inputs: ConditionInputs, *, ask: AskPermit | None, announce: Announce | None) -> None:
        self._inputs, self._ask, self._announce = inputs, ask, announce
        self._moves_at: float | None = None  # monotonic

    @property
    def patience_s(self) -> float:
        """How long the gate may take by its own settings."""
        settings = self._inputs.settings
        return settings.announce_s + (0.0 if settings.permit == "none" else settings.permit_timeout_s + ASK_S)

    def step(self, state: ArmState, now: float) -> bool:
        """Whether the arm may go now (monotonic [s]). Call it again with newer states until it may.

        Raises MotionRefused with the first condition that does not hold.
        """
        inputs = self._inputs = replace(self._inputs, state=state, now_unix_s=time.time())
        settings = inputs.settings
        if self._moves_at is None:
            self._log_or_refuse(tuple(result for result in conditions(inputs) if result.name != "permit"))
            self._moves_at = now + settings.announce_s
            if self._announce is not None:
                self._announce(self._about(settings.announce_s))
        if now < self._moves_at:
            return False
        in_time = now - self._moves_at < settings.permit_timeout_s
        if self.asks_over_zenoh:
            assert self._ask is not None
            answer = self._ask(self._about(0.0), min(ASK_S, settings.permit_timeout_s))
            if answer is None and in_time:
                return False
            inputs = replace(inputs, permit=answer or Permit(False, PERMIT_NO_ANSWER(limit_s=settings.permit_timeout_s)))
        found = named_conditions(inputs, ("permit",))
        if settings.permit_input is not None and not found[0].holds and in_time:
            return False  # the input may still be switched on
        self._log_or_refuse(found)
        refuse_unless(named_conditions(inputs, AT_THE_LAST))  # minutes may have passed with the announcement and the permit
        return True

    def in_time(self) -> None:
        """Whether a motion may begin at this time, before anything is known of the arm. Raises MotionRefused."""
        refuse_unless(named_conditions(replace(self._inputs, now_unix_s=time.time()), ("time_window",)))

    def ask_again(self, timeout_s: float) -> Permit | None:
        """The permit for an arm that moves already; None where nobody answered within timeout_s."""
        assert self._ask is not None
        return self._ask({**self._about(0.0), "moving": True}, timeout_s)

    @property
    def asks_over_zenoh(self) -> bool:
        """Whether somebody is asked for a permit over the bus."""
        return self._inputs.settings.permit == "zenoh" and self._ask is not None

    def _log_or_refuse(self, results: tuple[ConditionResult, ...]) -> None:
        for result in results:
            log.debug("condition=%s %s: %s", result.name, result.status, result.text)  # the outcome names the one that does not hold
        refuse_unless(results)

    def _about(self, in_s: float) -> dict[str, Any]:
        """What is going to happen, for people and for other programs."""
        excitation, at = self._inputs.excitation, time.time() + in_s
        return {
            "robot": self._inputs.robot.name,
            "moves_at_unix_s": at,
            "trajectory_digest": excitation.digest,
            "duration_s": excitation.duration_s,
            "time_scale": excitation.time_scale,
        }
