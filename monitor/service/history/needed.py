"""When the next replay is needed, by what the history knows of replays and of the arm's ordinary work."""

import math

import numpy as np

from monitor.acquire.schedule.needed import Need, Told, need
from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.judge.alerts.health import Health, health_from_document
from monitor.judge.belief import Belief, belief_from_document
from monitor.judge.document import plain, typed
from monitor.judge.friction.figures import suspected_rise
from monitor.judge.friction.step import FrictionModel
from monitor.judge.production_observation import ProductionObservation
from monitor.publish.documents import FromProduction, JointFromProduction, NextReplay, worded
from monitor.publish.timestamps import utc, utc_if
from monitor.reason import Reason, Sentence
from monitor.recording import DAY_S
from monitor.service.history.assess_and_store import EstimatorState
from monitor.store.history.production import DayOfProduction
from monitor.store.store import Store

PRODUCTION_TELLS_DAYS = 7.0  # since production told of a joint: from then on replays alone tell of it
NOT_NEEDED = Sentence("not_needed", "not needed before {day:day} ({why})")


def told(store: Store | None, belief: Belief | None, health: Health | None) -> Told:
    """What replays and work have told so far. Raises StoreError."""
    if store is None or belief is None or health is None:
        return Told(began_unix_s=None if store is None else store.ledger.began_unix_s())
    joints = tuple(-math.inf if joint.learnt_at_unix_s is None else joint.learnt_at_unix_s for joint in health.joints)
    asks, suspects = ((), ()) if belief.production is None else (belief.production.asks, belief.production.suspects)
    alone = np.ones(belief.joints, dtype=bool)  # joints of which replays alone tell
    if belief.production is not None:
        alone = ~(belief.at_unix_s - belief.production.learnt_at_unix_s <= PRODUCTION_TELLS_DAYS * DAY_S)
    doubted = tuple(int(j) + 1 for j in np.flatnonzero(suspected_rise(belief.friction, FrictionModel()) & alone))
    return Told(store.ledger.began_unix_s(), store.ledger.learnt_at_unix_s(), joints, asks, suspects, doubted)


def needed(settings: ScheduleSettings, store: Store | None, belief: Belief | None, health: Health | None) -> Need:
    """From when the next replay is needed, and why. Raises StoreError."""
    return need(settings, told(store, belief, health))


def not_needed(now_unix_s: float, found: Need) -> Reason | None:
    """Why no replay is needed now; None where one is."""
    if found.at(now_unix_s):
        return None
    return NOT_NEEDED(day=found.from_unix_s, why=found.why)


def need_document(settings: ScheduleSettings, found: Need) -> NextReplay:
    """As documents say it."""
    at = utc(found.from_unix_s) if math.isfinite(found.from_unix_s) else None
    return NextReplay(replay=settings.replay, needed_from=at, **worded(why=found.why))


# --- the document `from-production` ----------------------------------------------------------------


def last_observation(store: Store) -> tuple[DayOfProduction, ProductionObservation] | None:
    """The newest day of work that was judged; None where none was. Raises StoreError."""
    rows = store.production.rows(limit=1)
    return (rows[-1], typed(ProductionObservation, rows[-1].document, where="observation from production")) if rows else None


def from_production_document(store: Store, state: EstimatorState, schedule: ScheduleSettings) -> FromProduction | None:
    """What came from the arm's ordinary work; None before the first day of work. Raises StoreError."""
    newest, belief = last_observation(store), state.belief
    if newest is None or belief is None or belief.production is None:
        return None
    _, seen = newest
    history, replays, periods = belief.production, belief.learnt_replays, belief.friction.of_joints(belief.friction.periods)
    return FromProduction(
        period_began_at=utc(seen.begin_unix_s),
        period_ended_at=utc(seen.end_unix_s),
        observations=history.observations,
        seen_s=seen.seen_s,
        left_out_s=dict(seen.left_out_s),
        asks=list(history.asks),
        suspects=list(history.suspects),
        next_replay=need_document(schedule, needed(schedule, store, belief, state.health)),
        joints=[
            JointFromProduction(
                joint=j + 1,
                known=bool(seen.known[j] > 0),
                share=float(seen.share[j]) if math.isfinite(seen.share[j]) else None,
                friction_nm=plain(seen.friction_nm[j]),
                deviation_nm=plain(seen.deviation_nm[j]),
                temperature_c=plain(seen.temperature_c[j]),
                learnt_at=utc_if(plain(history.learnt_at_unix_s[j])),
                learnt_from_replays=int(replays[j]),
                learnt_from_production=int(periods[j]),
                **worded(reason=(seen.reasons[j] if j < len(seen.reasons) else None) or ""),
            )
            for j in range(belief.joints)
        ],
    )


def stored_from_production(store: Store, schedule: ScheduleSettings) -> FromProduction | None:
    """The same from the stored state, which is read only where a day was judged. Raises StoreError."""
    state = store.assessments.state() if store.production.rows(limit=1) else None
    if state is None:
        return None
    known = EstimatorState(belief=belief_from_document(state.belief), health=health_from_document(state.health))
    return from_production_document(store, known, schedule)
