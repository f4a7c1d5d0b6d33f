"""What opens a window beside the clock: a cold start of the arm, and evidence from its production."""

from collections.abc import Iterator
from typing import NamedTuple

from monitor.acquire.schedule.local_time import midnight_before, spans_from
from monitor.acquire.schedule.settings import ScheduleSettings
from monitor.acquire.schedule.windows import Window, before_blackouts, blackouts

# two windows with one key are one window; these offsets keep the keys of cold start and evidence apart from those of the clock
COLD_START_KEY_S = 0.001  # after the beginning of the day
EVIDENCE_KEY_S = 0.002  # after the beginning of a pause


class Triggers(NamedTuple):
    """When something opened a window beside the clock; None: nothing did."""

    cold_start_unix_s: float | None = None  # the arm ran again after a long rest
    evidence_unix_s: float | None = None  # production motion indicated more friction


def triggered_windows(settings: ScheduleSettings, triggers: Triggers) -> Iterator[Window]:
    """The windows that the triggers open, as far as no blackout forbids them."""
    dark = blackouts(settings)
    for made in (cold_start_window(settings, triggers.cold_start_unix_s), evidence_window(settings, triggers.evidence_unix_s)):
        if made is not None and (left := before_blackouts(dark, made)) is not None:
            yield left


def cold_start_window(settings: ScheduleSettings, at_unix_s: float | None) -> Window | None:
    """The window of an arm that ran again at that time, after a rest; its key allows one such window a day."""
    if at_unix_s is None or not settings.cold_start_after_h:
        return None
    key = midnight_before(at_unix_s, settings.zone()) + COLD_START_KEY_S
    return Window(key, at_unix_s, at_unix_s + settings.grace_s, "cold start")


def evidence_window(settings: ScheduleSettings, at_unix_s: float | None) -> Window | None:
    """The window of evidence that was seen at that time: the first allowed span; its key allows one such window a pause."""
    if at_unix_s is None or not settings.evidence_windows:
        return None
    pause_s = 3600.0 * settings.evidence_pause_h
    key = at_unix_s // pause_s * pause_s + EVIDENCE_KEY_S
    zone = settings.zone()
    opens, closes = min(span for text in settings.evidence_windows for span in spans_from(text, at_unix_s, zone))
    return Window(key, max(opens, at_unix_s), closes, "evidence")
