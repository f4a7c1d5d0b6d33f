"""Conditions of the monitor itself: nothing moves, nothing is learnt, the arm is not heard, the history was restored.

A replay cannot raise them, because they say that there is none. The service looks at them between replays: see `ServiceSituation`.
"""

import numpy as np

from monitor.judge.alerts.condition import AlertCondition, AlertTier, Headlines, ServiceSituation, Standing
from monitor.judge.alerts.ne107 import CHECK_FUNCTION
from monitor.recording import DAY_S

STORE_RESTORED, NOTHING_LEARNT = "store_restored", "nothing_learnt"
STOPPED, STALE, UNHEARD = "stopped", "stale", "unheard"
REFUSED_WINDOWS, REFUSED_DAYS = 3, 1.0  # so many windows in a row, over so long, are no working day of the cell


def _stopped(situation: ServiceSituation) -> str | None:
    """A stop waits for a person; or every window is refused, so that nothing will move by itself either."""
    if situation.stop is not None:
        return f"Nothing moves since {_time(situation.stop)}: {situation.stop.reason}. It waits for a person."
    refused = situation.refused
    if refused is None or refused.windows < REFUSED_WINDOWS or situation.now_unix_s - refused.since_unix_s < REFUSED_DAYS * DAY_S:
        return None
    return f"Nothing moves since {_time(refused)}: every window since then was refused; the last one: {refused.reason}."


def _stale(situation: ServiceSituation) -> str | None:
    learnt = situation.unlearnt
    if learnt is None or not _over(learnt, situation):
        return None
    last = f" The last window: {learnt.reason}." if learnt.reason else ""
    if situation.due is not None:
        last = f" A replay is due since {_time(situation.due)}, {situation.due.reason}."
    return f"Nothing was learnt of this arm since {_time(learnt)}: what is known of its joints is of then, not of now.{last}"


def _unheard(situation: ServiceSituation) -> str | None:
    heard = situation.unheard
    if heard is None or not _over(heard, situation):
        return None
    return f"The arm is not heard since {_time(heard)}{f': {heard.reason}' if heard.reason else ''}."


def _over(standing: Standing, situation: ServiceSituation) -> bool:
    """Whether it has lasted for longer than it may."""
    return standing.until_unix_s is not None and situation.now_unix_s >= standing.until_unix_s


def _time(standing: Standing) -> str:
    return f"{np.datetime64(int(standing.since_unix_s), 's')}Z"


SERVICE_CONDITIONS = (
    AlertCondition(
        name=STORE_RESTORED,
        headlines=Headlines(arm="The monitor's history was damaged, and a backup has taken its place."),
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look at the disk, and at what set-aside file and backups say; then acknowledge this.",
                "the history was damaged and the newest good backup replaced it, or it lost its newest entries",
            )
        },
    ),
    AlertCondition(
        name=STOPPED,
        headlines=Headlines(arm="Nothing moves, and nothing will until a person has put it right."),
        service=_stopped,
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look at the arm and at the reason (joint-monitor check); put it right, or allow motion (joint-monitor allow). "
                "Until the arm replays again, wear goes unnoticed.",
                "a stop waits for a person; or every window was refused, three or more in a row over a day or longer",
            )
        },
    ),
    AlertCondition(
        name=STALE,
        headlines=Headlines(arm="What the monitor knows of this arm is out of date."),
        service=_stale,
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look why the last windows failed (joint-monitor status): until one succeeds, wear goes unnoticed.",
                "no replay was learned from for schedule.learn_within_days: as it is shipped, for three windows and two days",
            )
        },
    ),
    AlertCondition(
        name=UNHEARD,
        headlines=Headlines(arm="The monitor does not hear the arm."),
        service=_unheard,
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look whether the arm is switched on, and at its cable and address (joint-monitor check).",
                "the arm did not answer for schedule.heard_within_days: as it is shipped, for two windows and a day",
            )
        },
    ),
    AlertCondition(  # an alert that 0.2.0 raised goes on until it is cleared; since then the same is `stale`
        name=NOTHING_LEARNT,
        headlines=Headlines(arm="The monitor has learned nothing about this arm for days."),
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look why the last windows failed (joint-monitor status): until one succeeds, wear goes unnoticed.",
                "version 0.2.0 raised this for what is `stale` now",
            )
        },
    ),
)
