"""Work on a joint that a person declares or takes back, between two replays: it is durable first, and published by the caller then.

The daemon does this when it is asked on the bus, and `joint-monitor serviced` itself where no daemon runs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from monitor.config.schema import Configuration
from monitor.errors import BadInput, StoreError
from monitor.judge.alerts.health import Alert, Health, Transition, alert_document, health_from_document
from monitor.judge.alerts.life_cycle import declare
from monitor.judge.belief import belief_from_document
from monitor.judge.document import plain
from monitor.judge.drift.maintenance import PERSONAL, REPLACED, Maintenance
from monitor.judge.maintenance import begin_maintenance, with_new_joints
from monitor.publish import documents
from monitor.publish.documents import Answer, made, worded
from monitor.publish.queries import ServicedRequest, UndoServicedRequest
from monitor.publish.timestamps import rfc3339, utc, utc_if
from monitor.reason import joint_text
from monitor.recording import DAY_S
from monitor.service.computing import HERE, Compute
from monitor.service.history.assess_and_store import EstimatorState, load_state
from monitor.service.history.inspection import declared_time
from monitor.store.history.events import AlertEvent
from monitor.store.history.maintenance import MaintenanceRow
from monitor.store.store import Store

MOST_REPEATED = 60  # replays that are judged once more where work is taken back: two weeks of four a day, half a minute of computing


class Declared(NamedTuple):
    """What came of it: the state after it, the transitions of alerts, and the answer to the person."""

    state: EstimatorState
    alerts: tuple[Alert, ...]
    events: list[AlertEvent]
    answer: Answer


def declare_maintenance(
    store: Store, configuration: Configuration, state: EstimatorState, request: ServicedRequest, now_unix_s: float
) -> Declared:
    """Declare work on one joint. Raises BadInput where the request does not fit this arm, StoreError where it cannot be stored."""
    belief, health = state.belief, state.health
    if belief is None or health is None:
        raise BadInput("serviced: no replay has been assessed yet, so nothing is known of the joint that work could change")
    if request.kind not in PERSONAL:
        raise BadInput(f"serviced: kind {request.kind!r}; expected {', '.join(PERSONAL)}")
    _known_joint(request.joint, belief.joints)
    at = now_unix_s if request.at is None else _time_of_maintenance(request.at, belief.began_at_unix_s, now_unix_s)
    act = Maintenance(request.joint, request.kind, at, now_unix_s, request.by.strip(), request.why.strip())
    begun, maintenance = begin_maintenance(belief, (act,), configuration.assess)
    after = with_new_joints(begun, maintenance, configuration.assess)
    judged, transitions = declare(health, maintenance, now_unix_s)
    amended = (after.as_document(), judged.as_document())
    before = (belief.as_document(), health.as_document())
    events = store.maintenance.declare(plain(maintenance[0]), before, amended, _events(transitions, request.by, request.why), now_unix_s)
    answer = Answer(
        done="serviced",
        maintenance=maintenance_document(maintenance[0]),
        alerts=[made(documents.Alert, alert_document(each.alert)) for each in transitions],
        text=_meaning(store, maintenance[0], transitions),
    )
    return Declared(replace(state, belief=after, health=judged), tuple(each.alert for each in transitions), events, answer)


def undo_maintenance(
    store: Store, state: EstimatorState, request: UndoServicedRequest, now_unix_s: float, compute: Compute = HERE
) -> Declared:
    """Take the last declared work on a joint back: the state is as if it had not been declared.

    Replays since then are judged once more from their recordings. Raises BadInput where there is none, a later one stands before it, or a
    recording that this needs is gone.
    """
    from monitor.service.history.recompute import repeated_since  # and with it all that judges

    if state.belief is None or state.health is None:
        raise BadInput("serviced: no replay has been assessed yet")
    _known_joint(request.joint, state.belief.joints)
    row = _last_declared(store, request.joint)
    kept = store.maintenance.before(row)
    if kept is None:
        raise BadInput(f"serviced: what was known before the work on {joint_text(request.joint)} is not kept: it cannot be taken back")
    start = EstimatorState(belief=belief_from_document(kept[0]), health=health_from_document(kept[1]), model=state.model)
    returned, replays = compute(repeated_since, store.directory, start, row.declared_at_unix_s, MOST_REPEATED)
    assert returned.belief is not None
    assert returned.health is not None
    health, changed = _alerts_after(state.health, returned.health, request.joint)
    amended = (returned.belief.as_document(), health.as_document())
    by, why = request.by.strip(), request.why.strip()
    transitions = tuple(Transition("updated" if alert.active else "cleared", alert) for alert in changed)
    events = store.maintenance.undo(row, by, why, amended, _events(transitions, by, why), now_unix_s)
    again = f"; {replays} replays since then were judged once more" if replays else ""
    active = ", ".join(f"j{alert.joint}/{alert.condition} ({alert.tier})" for alert in changed if alert.active) or "none"
    work = maintenance_document(Maintenance(**row.document))
    answer = Answer(
        done="taken back",
        maintenance=work.model_copy(update={"undone_at": utc(now_unix_s), "undone_by": by, "undone_why": why}),
        alerts=[made(documents.Alert, alert_document(alert)) for alert in changed],
        text=[
            f"What is known of {joint_text(request.joint)} is what it was before the work was declared{again}.",
            f"Active again: {active}.",
        ],
    )
    return Declared(replace(state, belief=returned.belief, health=health), changed, events, answer)


def offline(configuration: Configuration, request: ServicedRequest | UndoServicedRequest, now_unix_s: float) -> Answer:
    """The same without a daemon: the daemon finds it in the history and publishes it when it starts.

    Raises StoreInUse where a daemon runs, StoreError where its last run left a replay that is not assessed yet.
    """
    with Store.open(configuration.state_directory) as store:
        if store.ledger.unfinished():
            raise StoreError("the last run left a replay half-way: start `joint-monitor run` once, so that it is finished first")
        state = load_state(store)
        if isinstance(request, ServicedRequest):
            return declare_maintenance(store, configuration, state, request, now_unix_s).answer
        return undo_maintenance(store, state, request, now_unix_s).answer


def maintenance_document(act: Maintenance) -> documents.Maintenance:
    """Work as it is published."""
    return documents.Maintenance(
        joint=act.joint,
        kind=act.kind,
        at=utc(act.at_unix_s),
        declared_at=utc(act.declared_at_unix_s),
        by=act.by,
        why=act.why,
        outcome=act.outcome,
        change=plain(act.change),
        change_std=plain(act.change_std),
        replays=act.replays,
        days=act.days,
        **worded(text=act.reason, meaning=act.meaning),
    )


def row_document(row: MaintenanceRow) -> documents.Maintenance:
    """Work of the history as it is published; who took it back is part of it."""
    undone = {"undone_at": utc_if(row.undone_at_unix_s), "undone_by": row.undone_by, "undone_why": row.undone_why}
    return maintenance_document(Maintenance(**row.document)).model_copy(update=undone)


def friction_known(row: Mapping[str, Any], replays: float) -> dict[str, Any]:
    """The newest friction of a joint. Of a joint that was replaced and has not replayed since, what the old one had worn is left out.

    replays : that the filter has learnt of the joint that is there now.
    """
    if replays > 0:
        return dict(row)
    nothing = {"trend_probability": 0.5, "verdict": "no_trend", "before_service_probability": 0.0}
    life = {name: nothing.get(name) for name in row["remaining_life"]}
    unknown = (
        "reference_torque_nm",
        "reference_torque_std_nm",
        "replay_torque_nm",
        "replay_torque_std_nm",
        "unseen_step",
        "unseen_step_days",
    )
    zero = dict.fromkeys(("wear", "wear_std", "wear_rate_per_day", "wear_rate_std_per_day"), 0.0)
    return {**row, **dict.fromkeys(unknown), **zero, "remaining_life": life, "remaining_revolutions": [None, None, None]}


def _meaning(store: Store, act: Maintenance, transitions: Sequence[Transition]) -> list[str]:
    """What the work means from now on, in sentences."""
    if act.kind == REPLACED:
        lines = [
            "It is a new joint: friction, noise and wear are learnt anew from the next replay on.",
            "The temperature law of the old joint is a first guess.",
            "Remaining life is unknown until the new joint shows a trend.",
        ]
    else:
        lines = [
            "Friction may have moved either way: the next replays show by how much, and become its new reference where it moved.",
            "The temperature law and the noise of its replays stay.",
            "Remaining life is counted from the new reference; until then it says what it said before.",
        ]
    for transition in transitions:
        alert = transition.alert
        what = "waits for its proof by the next replays" if alert.awaiting_proof else f"cleared, {alert.cleared_why}"
        lines.append(f"j{alert.joint}/{alert.condition} ({alert.tier}, at its gravest {alert.gravest_so_far.change:+z.1%}): {what}.")
    if not transitions:
        lines.append("No alert of this joint was active.")
    later = 0
    if act.at_unix_s < act.declared_at_unix_s:
        later = sum(1 for _ in store.assessments.between(act.at_unix_s, act.declared_at_unix_s))
    if later:
        which = "1 replay" if later == 1 else f"{later} replays"
        lines.append(f"Not used for the new reference: {which} between the work and this declaration.")
    return [*lines, "What was found before stays in the history."]


def _time_of_maintenance(text: str, began_unix_s: float, now_unix_s: float) -> float:
    at = declared_time(text, now_unix_s, "declare work when it is done")
    if at < began_unix_s - DAY_S:
        raise BadInput(f"at {text!r}: the history begins on {rfc3339(began_unix_s)}; work before it is in its beginning already")
    return at


def _known_joint(joint: int, joints: int) -> None:
    if joint > joints:
        raise BadInput(f"joint {joint}: the arm has {joints} joints")


def _last_declared(store: Store, joint: int) -> MaintenanceRow:
    """The last work on a joint that a person declared and nobody took back.

    Raises BadInput where there is none, or work on another joint was declared later.
    """
    rows = [row for row in store.maintenance.rows() if row.in_force and row.ledger_id is None]
    own = [row for row in rows if row.joint == joint]
    if not own:
        raise BadInput(f"serviced: no declared work on {joint_text(joint)} that could be taken back")
    if rows[-1] is not own[-1]:
        raise BadInput(
            f"serviced: work on {joint_text(rows[-1].joint)} was declared later, on {rfc3339(rows[-1].declared_at_unix_s)}: "
            "take that back first"
        )
    return own[-1]


def _alerts_after(present: Health, returned: Health, joint: int) -> tuple[Health, tuple[Alert, ...]]:
    """The health that taking work back returns to, with what people did to other alerts since; and the alerts that thereby changed."""
    now = {alert.key: alert for alert in present.alerts}
    alerts = {alert.key: alert if alert.joint == joint else now.get(alert.key, alert) for alert in returned.alerts}
    alerts = {key: alert for key, alert in now.items() if key[0] != joint} | alerts
    changed = tuple(alert for key, alert in alerts.items() if now.get(key) != alert)
    return replace(returned, alerts=tuple(alerts.values())), changed


def _events(transitions: Sequence[Transition], by: str, why: str) -> list[dict[str, Any]]:
    return [{"kind": each.kind, **alert_document(each.alert), "by": by, "why": why} for each in transitions]
