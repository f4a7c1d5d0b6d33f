"""What the history knows of the need for a replay: `[schedule] replay = "when_needed"`."""

import math

import numpy as np

from monitor.acquire.schedule.needed import Need, Told, need
from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.judge.alerts.health import Health
from monitor.judge.belief import Belief
from monitor.judge.drift.suspicion import doubted_rise
from monitor.publish.timestamps import rfc3339
from monitor.store.store import Store


def told(store: Store | None, belief: Belief | None, health: Health | None) -> Told:
    """What replays and work have told so far. Raises StoreError."""
    if store is None or belief is None or health is None:
        return Told(began_unix_s=None if store is None else store.ledger.began_unix_s())
    joints = tuple(-math.inf if joint.learnt_at_unix_s is None else joint.learnt_at_unix_s for joint in health.joints)
    asks, suspects = ((), ()) if belief.production is None else (belief.production.asks, belief.production.suspects)
    doubted = tuple(int(j) + 1 for j in np.flatnonzero(doubted_rise(belief.filter_state)))
    return Told(store.ledger.began_unix_s(), store.ledger.learnt_at_unix_s(), joints, asks, suspects, doubted)


def needed(settings: ScheduleSettings, store: Store | None, belief: Belief | None, health: Health | None) -> Need:
    """From when the next replay is needed, and why. Raises StoreError."""
    return need(settings, told(store, belief, health))


def not_needed(now_unix_s: float, found: Need) -> str | None:
    """Why no replay is needed now; None where one is."""
    if found.at(now_unix_s):
        return None
    # no colon: the windows that the arm or its cell refuses are counted by theirs
    return f"not needed before {rfc3339(found.from_unix_s)[:10]} ({found.why.replace(':', ' –')})"


def need_document(settings: ScheduleSettings, found: Need) -> dict[str, object]:
    """As documents say it, its time not yet text."""
    from_unix_s = found.from_unix_s if math.isfinite(found.from_unix_s) else None
    return {"replay": settings.replay, "needed_from_unix_s": from_unix_s, "why": found.why}
