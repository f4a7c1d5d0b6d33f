"""When to replay: the settings of the schedule."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Literal
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from annotated_types import Interval

from monitor.acquire.schedule.cron import cron_trigger
from monitor.acquire.schedule.local_time import is_blackout, is_span
from monitor.errors import BadInput


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleSettings:
    """When to replay."""

    timezone: str = "UTC"  # of cron, blackout and evidence_windows
    cron: str = "0 3 * * *"  # minute, hour, day, month, weekday; empty: no such windows
    every_h: Annotated[float, Interval(ge=0.0, le=8784.0)] = 0.0  # [h] between further windows, counted in UTC; 0: no such windows
    replay: Literal["always", "when_needed"] = "always"  # in every window; or only where the arm's ordinary work does not tell enough
    at_most_days: Annotated[float, Interval(ge=1.0, le=365.0)] = 30.0  # [d] without a replay, where replay is when_needed
    untold_days: Annotated[float, Interval(ge=1.0, le=90.0)] = 7.0  # [d] in which neither work nor a replay has told of a joint, likewise
    grace_s: Annotated[float, Interval(ge=10.0, le=86400.0)] = 600.0  # [s] a window stays open; one without a replay is logged as skipped
    tries: Annotated[int, Interval(ge=1, le=10)] = 3  # replays begun in one window where this machine or the network ended the one before
    try_again_after_s: Annotated[float, Interval(ge=1.0, le=3600.0)] = 60.0  # [s] before the next of them
    learn_within_days: Annotated[float, Interval(ge=0.0, le=3660.0)] = (
        0.0  # [d] without a verdict are a problem; 0: three windows, at least 2 d
    )
    heard_within_days: Annotated[float, Interval(ge=0.0, le=3660.0)] = 0.0  # [d] an arm may be unheard; 0: two windows, at least 1 d
    jitter_s: Annotated[float, Interval(ge=0.0, le=43200.0)] = 0.0  # [s] each window opens later by a share of this, its own for each robot
    blackout: tuple[str, ...] = ()  # "2026-12-24..2027-01-02" or single days on which no window opens
    after_warm_up: bool = False  # begin only while the joints' temperatures are steady
    warm_k_per_10_min: Annotated[float, Interval(ge=0.05, le=20.0)] = 0.5  # [K] temperatures that change by less in 10 min are steady
    cold_start_after_h: Annotated[float, Interval(ge=0.0, le=168.0)] = 0.0  # [h] of rest before a cold start opens a window; 0: none does
    learning_days: Annotated[float, Interval(ge=0.0, le=90.0)] = 14.0  # [d] the learning phase, from the first window on
    learning_every_h: Annotated[float, Interval(ge=0.0, le=168.0)] = 0.0  # [h] between windows in that phase; 0: as at any time
    evidence_windows: tuple[str, ...] = ()  # "22:00-05:00": when a replay may be pulled forward; empty: never
    evidence_pause_h: Annotated[float, Interval(ge=1.0, le=720.0)] = 24.0  # [h] at most one replay is pulled forward in this time

    def __post_init__(self) -> None:
        """Raises BadInput naming the setting, its value and what would be right."""
        self.zone()
        cron_trigger(self.cron)
        if not self.jitter_s < self.grace_s:
            raise BadInput(
                f"schedule.jitter_s = {self.jitter_s:g}: expected less than grace_s = {self.grace_s:g}, or windows close unopened"
            )
        if self.untold_days > self.at_most_days:
            raise BadInput(f"schedule.untold_days = {self.untold_days:g}: expected at most at_most_days = {self.at_most_days:g}")
        wrong = [text for text in self.blackout if not is_blackout(text)]
        if wrong:
            raise BadInput(f"schedule.blackout = {_listed(wrong)}: expected a day or two, e.g. 2026-12-25 or 2026-12-24..2027-01-02")
        wrong = [text for text in self.evidence_windows if not is_span(text)]
        if wrong:
            raise BadInput(f"schedule.evidence_windows = {_listed(wrong)}: expected HH:MM-HH:MM, e.g. 22:00-05:00")

    def zone(self) -> ZoneInfo:
        """The time zone. Raises BadInput."""
        try:
            return ZoneInfo(self.timezone)
        except (ZoneInfoNotFoundError, ValueError, OSError):
            raise BadInput(f"schedule.timezone = {self.timezone!r}: expected a name such as UTC or Europe/Berlin") from None


def _listed(texts: Iterable[str]) -> str:
    return ", ".join(repr(text) for text in texts)
