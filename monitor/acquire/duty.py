"""An arm's duty as it is heard: operating hours, hours in motion, and the stops that its safety system makes by itself."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from monitor.acquire.listen import LiveState
from monitor.acquire.state import POWERED, STOPS

LONGEST_STEP_S = 2.0  # [s] between two rows that belong together; what happened in a longer pause is not known
MOVING_RAD_S = 0.02  # an arm moves while a joint is faster


class Seconds(NamedTuple):
    """For how long the arm was heard, under power, and in motion."""

    heard_s: float = 0.0
    on_s: float = 0.0
    moving_s: float = 0.0

    def __add__(self, other: "Seconds") -> "Seconds":  # type: ignore[override]  # a sum of times, not of tuples
        """The sum of two spans."""
        return Seconds(self.heard_s + other.heard_s, self.on_s + other.on_s, self.moving_s + other.moving_s)


class Edge(NamedTuple):
    """A stop has begun, or the one that stood has ended (`kind` is None)."""

    age_s: float  # before the newest row of its batch
    kind: str | None


@dataclass(slots=True)
class DutyCounter:
    """Counts one arm's rows in their order. `standing` is the stop that stood when the last row came; None: none."""

    standing: str | None = None
    _last: LiveState | None = field(default=None, repr=False)

    def take(self, states: Sequence[LiveState]) -> tuple[Seconds, list[Edge]]:
        """What the rows since the last call add, and the stops that began or ended in them."""
        seconds, edges = Seconds(), []
        for state in states:
            if self._last is not None:
                seconds += _between(self._last, state)
            kind = STOPS.get(state.safety_mode)
            if kind != self.standing:
                edges.append(Edge(max(states[-1].t_s - state.t_s, 0.0), kind))
                self.standing = kind
            self._last = state
        return seconds, edges


TOGETHER_S = 2.0  # a stop in the rows and the controller's report of it are not further apart


class ShortStop(NamedTuple):
    """A stop that the controller has reported, and that was over before a row showed it."""

    kind: str
    began_unix_s: float
    ended_unix_s: float


@dataclass(slots=True)
class ReportedStops:
    """Which of the stops that the controller reports were too short for the rows. Each one in the rows stands for one that is reported."""

    _kind: str | None = None  # of the stop that stands, as reported
    _unseen: list[ShortStop] = field(default_factory=list)  # no row has shown them yet; one that stands has no end (inf)
    _unreported: list[tuple[str, float]] = field(default_factory=list)  # in the rows: the controller has not reported them yet

    def reported(self, safety_mode: int, now_unix_s: float) -> None:
        """The controller reports a safety mode."""
        kind = STOPS.get(safety_mode)
        if kind == self._kind:
            return
        if self._kind is not None:
            self._unseen = [stop._replace(ended_unix_s=min(stop.ended_unix_s, now_unix_s)) for stop in self._unseen]
        self._kind = kind
        self._unreported = [each for each in self._unreported if now_unix_s - each[1] <= TOGETHER_S]
        shown = next((each for each in self._unreported if each[0] == kind), None)
        if shown is not None:
            self._unreported.remove(shown)
        elif kind is not None:
            self._unseen.append(ShortStop(kind, now_unix_s, math.inf))

    def shown(self, kind: str, now_unix_s: float) -> None:
        """A row shows that a stop has begun."""
        reported = next((stop for stop in self._unseen if stop.kind == kind), None)
        if reported is not None:
            self._unseen.remove(reported)
        else:
            self._unreported.append((kind, now_unix_s))

    def missed(self, standing: str | None, now_unix_s: float) -> list[ShortStop]:
        """Those that no row shows any more, each once. standing : the stop that the rows show.

        Where an earlier one of the same kind stands in the rows, what was short is the pause between the two.
        """
        found = [
            stop for stop in self._unseen if now_unix_s - (stop.began_unix_s if stop.kind == standing else stop.ended_unix_s) > TOGETHER_S
        ]
        self._unseen = [stop for stop in self._unseen if stop not in found]
        return [stop._replace(ended_unix_s=min(stop.ended_unix_s, now_unix_s)) for stop in found]


def _between(before: LiveState, now: LiveState) -> Seconds:
    """The time between two rows, by the controller's clock; nothing after a gap or a restart of the controller."""
    step_s = now.t_s - before.t_s
    if not 0.0 < step_s <= LONGEST_STEP_S:
        return Seconds()
    on = now.robot_mode in POWERED
    moving = on and bool(np.nanmax(np.abs(now.qd), initial=0.0) > MOVING_RAD_S)
    return Seconds(step_s, step_s if on else 0.0, step_s if moving else 0.0)
