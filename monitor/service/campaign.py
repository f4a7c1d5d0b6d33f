"""A warm-up campaign: replays one after another, from a cold arm until its temperatures are steady, as in Raviola et al. (2021), section 4.

It asks the running daemon for each replay, as a person does who presses *Replay now*: every condition, guard and permit is the daemon's,
and each replay is judged before the next one is asked for. It ends with the first one that is not learnt from.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from monitor.errors import BadInput
from monitor.publish.client import Client
from monitor.publish.documents import Replay
from monitor.reason import Reason, Sentence

SPAN_S = 600.0  # in which steady temperatures change by no more than `steady_k`
ASK_EVERY_S = 1.0

STEADY = Sentence("campaign_steady", "the temperatures are steady: no joint changed by more than {kelvin:g} K in {minutes:g} min")
ENOUGH = Sentence("campaign_enough", "{replays} replays were made; --most allows no more")
TIME_OVER = Sentence("campaign_time_over", "{hours:g} h are over; --hours allows no more")
STOPPED = Sentence("campaign_stopped", "stopped on request: no further replay is asked for; one that is under way ends by itself")
UNMOVED = Sentence("campaign_unmoved", "no temperature of any joint changed at all in {replays} replays: their sensors are stuck")
NOT_ENDED = Sentence(
    "campaign_not_ended", "no end of the replay was told for {minutes:.0f} min; `joint-monitor status` says what the daemon lacks"
)
NOT_LEARNT = Sentence("campaign_not_learnt", "replay {replay} was {verdict}: {why}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """When a campaign ends."""

    most: int = 60  # replays
    hours: float = 2.0
    steady_k: float = 0.5  # as `[schedule] warm_k_per_10_min`
    longest_s: float = 1500.0  # of one replay: its window, and a quarter of an hour for motion and verdict

    def __post_init__(self) -> None:
        """Raises BadInput naming the option, its value and what would be right."""
        if not 1 <= self.most <= 200:
            raise BadInput(f"--most {self.most}: expected 1 to 200 replays")
        if not 0.0 < self.hours <= 12.0:
            raise BadInput(f"--hours {self.hours:g}: expected more than 0, and at most 12")


class Made(NamedTuple):
    """One replay of a campaign."""

    replay: int
    at_unix_s: float
    temperature_c: tuple[float | None, ...]  # (J,)


class Ended(NamedTuple):
    """A campaign: its replays, whether it came to a steady temperature, and why it ended."""

    made: tuple[Made, ...]
    steady: bool
    why: Reason


def campaign(
    client: Client,
    bounds: Bounds,
    *,
    by: str,
    why: str,
    should_stop: Callable[[], bool] = lambda: False,
    tell: Callable[[Made], None] = lambda _: None,
    now: Callable[[], float] = time.time,
    sleep: Callable[[float], None] = time.sleep,
) -> Ended:
    """The campaign. tell : takes each replay that was learnt from. Raises BusError where the daemon is gone."""
    began, made = now(), list[Made]()

    def ended(reason: Reason, *, steady: bool = False) -> Ended:
        return Ended(tuple(made), steady, reason)

    def over() -> Reason | None:
        if should_stop():
            return STOPPED()
        return TIME_OVER(hours=bounds.hours) if now() - began >= 3600.0 * bounds.hours else None

    while True:
        if (reason := over()) is not None:
            return ended(reason)
        if len(made) >= bounds.most:
            return ended(ENOUGH(replays=len(made)))
        before, asked = _newest(client), now()
        try:
            client.request_replay(by=by, why=why)
        except BadInput as error:
            return ended(error.reason)
        while (found := _newest(client)) is None or found == before:
            if (reason := over()) is not None:
                return ended(reason)
            if now() - asked >= bounds.longest_s:
                return ended(NOT_ENDED(minutes=bounds.longest_s / 60.0))
            sleep(ASK_EVERY_S)
        if found.verdict != "assessed":
            return ended(NOT_LEARNT(replay=found.replay or 0, verdict=found.verdict or "ended", why=found.reason or "no reason given"))
        made.append(Made(found.replay or 0, now(), tuple(row.temperature_c for row in client.friction())))
        tell(made[-1])
        if steady(made, bounds.steady_k):
            if unmoved(made):
                return ended(UNMOVED(replays=len(made)))
            return ended(STEADY(kelvin=bounds.steady_k, minutes=SPAN_S / 60.0), steady=True)


def steady(made: Sequence[Made], within_k: float) -> bool:
    """Whether no joint changed by more than `within_k` over the replays of the last SPAN_S; False before there are such."""
    last = made[-1].at_unix_s
    if last - made[0].at_unix_s < SPAN_S:
        return False
    begin = max(k for k, each in enumerate(made) if last - each.at_unix_s >= SPAN_S)
    joints = list(zip(*(each.temperature_c for each in made[begin:]), strict=True))
    known = [[T for T in joint if T is not None] for joint in joints]
    return all(len(values) == len(joint) and max(values) - min(values) <= within_k for values, joint in zip(known, joints, strict=True))


def unmoved(made: Sequence[Made]) -> bool:
    """Whether no temperature changed at all, by not even a step of its sensor: an arm that has just moved does not do that."""
    return all(len(set(joint)) == 1 for joint in zip(*(each.temperature_c for each in made), strict=True))


def _newest(client: Client) -> Replay | None:
    """The document `replay` of the last one that ended; None while one is announced, or before the first."""
    found = [Replay.model_validate(message.document) for message in client.get("replay")]
    if not found:
        client.info()  # which every daemon answers: one that died in a replay is not waited for until the hours are over
    return found[0] if found and found[0].state == "ended" else None
