"""The documents of the commands `status`, `schedule` and `predict --local`, made from the history without a daemon."""

from collections.abc import Sequence
from contextlib import ExitStack
from datetime import datetime
from typing import Any

import numpy as np

from monitor.acquire.schedule.needed import ALWAYS, Need
from monitor.acquire.schedule.windows import ScheduleSettings, expected
from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.judge.alerts.health import alert_document, health_from_document
from monitor.judge.alerts.rules import why_not_alerting
from monitor.judge.belief import belief_from_document, learnt_replays_of
from monitor.judge.torque.model import model_from_document
from monitor.publish.compensation import compensation, compensation_at
from monitor.publish.documents import Alert, JointFrictionAt, as_json, made, worded_json
from monitor.publish.health_document import health_document
from monitor.publish.shown import NOTHING_ASSESSED
from monitor.publish.timestamps import outside, rfc3339
from monitor.publish.torque import torque_answer
from monitor.recording import DAY_S
from monitor.service.history.assess_and_store import early_alerts
from monitor.service.history.inspection import inspection_document
from monitor.service.history.maintenance import friction_known, row_document
from monitor.service.history.needed import need_document, needed, stored_from_production
from monitor.service.lending import DueReplay
from monitor.service.monitor_document import borrowed_document, not_watched, present_unix_s, read_monitor_document, silent_s
from monitor.service.plant_prior import prior_taken
from monitor.store.backup import present
from monitor.store.history.assessments import StoredState
from monitor.store.history.ledger import Borrow, LedgerRow, Try
from monitor.store.store import Store

MAINTENANCE_SHOWN = 6  # newest works on joints that `status` shows: all joints of one `maintenance`
LEDGER_ROWS = 10  # newest windows that `status` shows
WINDOWS_SHOWN = 5  # newest past windows that `schedule` shows


def status_document(configuration: Configuration, now_unix_s: float, why_joint: int | None = None) -> dict[str, Any]:
    """The arm's health, friction and last windows, and the monitor's own state.

    why_joint : 1…J adds the reasons why that joint does not alert. Raises StoreError without a history, BadInput for a joint the arm lacks.
    """
    monitor = read_monitor_document(configuration.state_directory)
    now_unix_s = present_unix_s(monitor, now_unix_s)
    with Store.reader(configuration.state_directory) as store:
        state = store.assessments.state()
        newest = store.assessments.friction(limit=configuration.robot_description.joints)
        maintenance = [as_json(row_document(row)) for row in store.maintenance.rows() if row.in_force][-MAINTENANCE_SHOWN:]
        if state is not None and (replays := learnt_replays_of(state.belief)) is not None:
            newest = [friction_known(row, float(replays[row["joint"] - 1])) for row in newest]
        recorded = {replay: at for replay, _, at, _ in store.assessments.friction_of(sorted({row["replay"] for row in newest}))}
        ledger = store.ledger.rows(limit=LEDGER_ROWS)
        tries, borrows = store.ledger.tries(ledger), store.borrows.of(ledger)
        early = [] if state else early_alerts(store)
        from_production = stored_from_production(store, configuration.schedule)
        inspection = inspection_document(configuration.inspection, store, now_unix_s)
        prior = prior_taken(configuration, store)
    document = {
        "said_at": rfc3339(now_unix_s),
        "robot": configuration.robot.id,
        "model_revision": state.revision if state else 0,
        "health": _health(state, now_unix_s, configuration),
        "early_alerts": [as_json(made(Alert, alert_document(alert))) for alert in early],
        "friction": outside([row | {"recorded_at": rfc3339(recorded[row["replay"]])} for row in newest]),
        **({} if state is None else {"compensation": _compensation(state)}),
        "maintenance": maintenance,
        **({} if from_production is None else {"from_production": as_json(from_production)}),
        **({} if inspection is None else {"inspection": as_json(inspection)}),
        **({} if prior is None else {"prior": as_json(prior)}),
        "monitor": None if monitor is None else as_json(monitor),
        "monitor_silent_s": None if monitor is None else silent_s(monitor, now_unix_s),
        **worded_json(not_watched=not_watched(monitor, now_unix_s)),
        "ledger": [_window(row, tries[row.id], borrows.get(row.id)) for row in ledger],
    }
    if why_joint is not None:
        document["not_alerting"] = {"joint": why_joint, "reasons": _reasons(state, why_joint, configuration)}
    return document


def _compensation(state: StoredState) -> dict[str, Any]:
    return as_json(compensation(model_from_document(state.model), belief_from_document(state.belief)))


def schedule_document(configuration: Configuration, now_unix_s: float, count: int) -> dict[str, Any]:
    """The next `count` windows, and how the last ones ended. Raises StoreError where a history cannot be read."""
    settings = configuration.schedule
    with ExitStack() as stack:
        directory = configuration.state_directory
        store = stack.enter_context(Store.reader(directory)) if present(directory) else None
        began, last = (None, []) if store is None else (store.ledger.began_unix_s(), store.ledger.rows(limit=WINDOWS_SHOWN))
        tries = {} if store is None else store.ledger.tries(last)
        borrows = {} if store is None else store.borrows.of(last)
        due = None if store is None else DueReplay.kept(store)
        need = _need(store, settings)
        from_unix_s = max(now_unix_s, need.from_unix_s - settings.grace_s)
        windows = expected(settings, from_unix_s, count, None if store is None else store.ledger, configuration.key_prefix)
    zone = settings.zone()
    learning = settings.learning_every_h > 0 and settings.learning_days > 0
    return {
        "robot": configuration.robot.id,
        "timezone": settings.timezone,
        "motion_allowed": configuration.replay.allow_motion is True,
        "learning_until": rfc3339(began + settings.learning_days * DAY_S) if learning and began is not None else None,
        "windows": [
            {
                "window": rfc3339(window.key_unix_s),
                "opens": rfc3339(window.opens_unix_s),
                "closes": rfc3339(window.closes_unix_s),
                "local": datetime.fromtimestamp(window.opens_unix_s, tz=zone).strftime("%a %Y-%m-%d %H:%M"),
                "why": window.why,
            }
            for window in windows
        ],
        "blackout": list(settings.blackout),
        **({} if settings.replay == ALWAYS else {"needed": as_json(need_document(settings, need))}),
        "due": None if due is None else due.document().model_dump(mode="json", include={"since", "until", "kind", "why", "tries"}),
        "last": [_window(row, tries[row.id], borrows.get(row.id)) for row in last],
    }


def _health(state: StoredState | None, now_unix_s: float, configuration: Configuration) -> dict[str, Any] | None:
    if state is None:
        return None
    return as_json(health_document(health_from_document(state.health), now_unix_s, configuration.assess.health))


def _need(store: Store | None, settings: ScheduleSettings) -> Need:
    """From when the next replay is needed. Where every window is used, nothing of the state is read."""
    state = None if store is None or settings.replay == ALWAYS else store.assessments.state()
    known = (None, None) if state is None else (belief_from_document(state.belief), health_from_document(state.health))
    return needed(settings, None if settings.replay == ALWAYS else store, *known)


def torque_from_history(configuration: Configuration, request: dict[str, Any]) -> dict[str, Any]:
    """The answer to a torque query by the stored model, at the newest known temperatures where the query gives none.

    Raises BadInput where no replay was assessed yet or the query is wrong, StoreError without a history.
    """
    state, newest_c = _model_and_temperatures(configuration)
    present_c = None if None in newest_c or not newest_c else np.array(newest_c)
    return as_json(torque_answer(model_from_document(state.model), configuration.robot_description, present_c, request))


def compensation_from_history(configuration: Configuration, temperature_c: Sequence[float] | None) -> list[JointFrictionAt]:
    """Friction of each joint at J [°C], else at the newest known temperatures. Raises as `torque_from_history`."""
    state, newest_c = _model_and_temperatures(configuration)
    return compensation_at(model_from_document(state.model), newest_c if temperature_c is None else temperature_c)


def _model_and_temperatures(configuration: Configuration) -> tuple[StoredState, list[float | None]]:
    with Store.reader(configuration.state_directory) as store:
        state = store.assessments.state()
        newest = store.assessments.friction(limit=configuration.robot_description.joints)
    if state is None:
        raise BadInput(f"{configuration.state_directory}: no replay has been assessed yet, so there is no model")
    return state, [row.get("temperature_c") for row in newest]


def _window(row: LedgerRow, tries: Sequence[Try], borrow: Borrow | None) -> dict[str, Any]:
    """One window; `tries`, where there are any, are the replays before the last one in it; `borrowed`: a program lent the arm."""
    document = {"replay": row.id, "window": rfc3339(row.window_unix_s), "kind": row.kind, "state": row.state}
    document |= worded_json(reason=row.reason)
    earlier = [{"at": rfc3339(each.ended_at_unix_s), "cause": each.cause, **worded_json(reason=each.reason)} for each in tries]
    document |= {"tries": earlier} if earlier else {}
    return document if borrow is None else document | {"borrowed": as_json(borrowed_document(borrow))}


def _reasons(state: StoredState | None, joint: int, configuration: Configuration) -> list[dict[str, Any]]:
    """Why a joint (1…J) has no alert, or none of a higher tier. Raises BadInput for a joint that the arm lacks."""
    if state is None:
        return [NOTHING_ASSESSED.document()]
    health = health_from_document(state.health)
    if joint > len(health.joints):
        raise BadInput(f"--why {joint}: the arm has {len(health.joints)} joints")
    return [each.document() for each in why_not_alerting(health, belief_from_document(state.belief), joint, configuration.assess)]
