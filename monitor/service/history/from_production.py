"""The document `from-production`: what came from the arm's ordinary work and what from replays, and how far the next replay is."""

import math
from typing import Any

import numpy as np

from monitor.judge.document import plain
from monitor.judge.production_observation import ProductionObservation, production_observation_from_document
from monitor.service.history.assess_and_store import EstimatorState
from monitor.store.history.production import DayOfProduction
from monitor.store.store import Store


def last_observation(store: Store) -> tuple[DayOfProduction, ProductionObservation] | None:
    """The newest day of work that was judged; None where none was. Raises StoreError."""
    rows = store.production.rows(limit=1)
    return (rows[-1], production_observation_from_document(rows[-1].document)) if rows else None


def from_production_document(store: Store, state: EstimatorState, needed: dict[str, Any]) -> dict[str, Any] | None:
    """What came from work: the document `from-production`, its times not yet text; None before the first day of work. Raises StoreError."""
    newest, belief = last_observation(store), state.belief
    if newest is None or belief is None or belief.production is None:
        return None
    _, seen = newest
    history, sources = belief.production, belief.filter_state.sources
    replays = np.zeros(belief.joints) if sources is None else sources.number
    periods = np.zeros(belief.joints) if sources is None else sources.other_number
    return {
        "period_began_at_unix_s": seen.begin_unix_s,
        "period_ended_at_unix_s": seen.end_unix_s,
        "observations": history.observations,
        "seen_s": seen.seen_s,
        "left_out_s": dict(seen.left_out_s),
        "asks": list(history.asks),
        "suspects": list(history.suspects),
        "next_replay": needed,
        "joints": [
            {
                "joint": j + 1,
                "known": bool(seen.known[j] > 0),
                "share": None if not math.isfinite(seen.share[j]) else float(seen.share[j]),
                "friction_nm": plain(seen.friction_nm[j]),
                "deviation_nm": plain(seen.deviation_nm[j]),
                "temperature_c": plain(seen.temperature_c[j]),
                "learnt_at_unix_s": plain(history.learnt_at_unix_s[j]),
                "learnt_from_replays": int(replays[j]),
                "learnt_from_production": int(periods[j]),
                "reason": seen.reasons[j] if j < len(seen.reasons) else "",
            }
            for j in range(belief.joints)
        ],
    }
