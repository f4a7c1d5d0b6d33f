"""The last question before an arm moves, asked by the parent while the child holds the connection: every condition, by name, once more.

In this order: conditions, announcement, the time that it gives people, permit, go. Each condition is logged as it was found.
"""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from monitor.acquire.safety.conditions import AT_THE_LAST, ConditionInputs, ConditionResult, Permit, conditions, refuse_unless, some
from monitor.acquire.state import ArmState

log = logging.getLogger(__name__)

ASK_S = 0.5  # one question; then the caller is asked whether to stop

AskPermit = Callable[[Mapping[str, Any], float], Permit | None]
"""Somebody else's permit: what is going to happen, and how long to wait → what was answered; None where nobody answered."""
Announce = Callable[[Mapping[str, Any]], None]
"""Tell whoever must know that the arm is going to move."""


class Gate:
    """One replay's way from "heard" to "go"."""

    def __init__(self, facts: ConditionInputs, *, ask: AskPermit | None, announce: Announce | None) -> None:
        self._facts, self._ask, self._announce = facts, ask, announce
        self._moves_at: float | None = None
        self.conditions: tuple[ConditionResult, ...] = ()

    @property
    def patience_s(self) -> float:
        """How long it may take by its own settings."""
        settings = self._facts.settings
        return settings.announce_s + (0.0 if settings.permit == "none" else settings.permit_timeout_s + ASK_S)

    def step(self, state: ArmState, now: float) -> bool:
        """May it go, now (monotonic)?

        Raises MotionRefused with the first condition that does not hold.
        """
        facts = self._facts = replace(self._facts, state=state, now_unix_s=time.time())
        settings = facts.settings
        if self._moves_at is None:
            found = tuple(condition for condition in conditions(facts) if condition.name != "permit")
            self._tell(found)
            self._moves_at = now + settings.announce_s
            if self._announce is not None:
                self._announce(self._about(settings.announce_s))
        if now < self._moves_at:
            return False
        if settings.permit == "zenoh" and self._ask is not None:
            answer = self._ask(self._about(0.0), min(ASK_S, settings.permit_timeout_s))
            if answer is None and now - self._moves_at < settings.permit_timeout_s:
                return False
            facts = replace(facts, permit=answer or Permit(False, f"permit/replay: no answer within {settings.permit_timeout_s:g} s"))
        found = some(facts, ("permit",))
        if settings.permit_input is not None and not found[0].holds and now - self._moves_at < settings.permit_timeout_s:
            return False  # it may still be switched on
        self._tell(found)
        refuse_unless(some(facts, AT_THE_LAST))  # minutes may have passed with the announcement and the permit
        return True

    def _tell(self, found: tuple[ConditionResult, ...]) -> None:
        self.conditions = (*self.conditions, *found)
        for condition in found:
            log.log(
                logging.INFO if condition.holds else logging.WARNING,
                "condition=%s %s: %s",
                condition.name,
                condition.status,
                condition.text,
            )
        refuse_unless(found)

    def _about(self, in_s: float) -> dict[str, Any]:
        """What is going to happen, for people and for other programs."""
        excitation, at = self._facts.excitation, time.time() + in_s
        return {
            "robot": self._facts.robot.name,
            "moves_at_unix_s": at,
            "trajectory_digest": excitation.digest,
            "duration_s": excitation.duration_s,
            "time_scale": excitation.time_scale,
        }
