"""The published form of a Health: the fields that the schema names, without the judge's internal counts."""

from collections.abc import Sequence
from datetime import datetime
from typing import cast

from monitor.judge.alerts.health import Health, JointHealth, State, alert_document
from monitor.judge.alerts.states import FOR_DAYS, NOT_YET, stale_joints, stale_reason
from monitor.judge.document import plain
from monitor.judge.drift.ripple_track import JointRipple
from monitor.judge.settings import HealthSettings
from monitor.judge.torque.production_residual import ProductionEvidence
from monitor.publish import documents
from monitor.publish.documents import made, mended_alerts, worded
from monitor.publish.timestamps import outside, utc, utc_if
from monitor.reason import Reason
from monitor.recording import DAY_S


def health_document(
    health: Health | None,
    now_unix_s: float,
    settings: HealthSettings,
    *,
    next_replay_due: datetime | None = None,
    nothing_learnt: str | Reason | None = None,
    production: Sequence[ProductionEvidence] = (),
    ripple: Sequence[JointRipple] = (),
) -> documents.Health:
    """States, reasons and alerts, each with its staleness; `state` is None before the first assessment.

    Staleness stands beside the state: an alert stays until a replay clears it, and readers of v1 know five states.
    """
    known = health is not None and bool(health.joints)
    alerts = () if health is None else health.alerts
    silent = stale_joints(health, now_unix_s, settings) if health is not None and known else ()
    why = next((alert.text for alert in alerts if alert.active), None) if health is None or not known else health.why
    return documents.Health(
        state=cast(State, health.state) if health is not None and known else None,
        since=utc(health.since_unix_s) if health is not None and known else None,
        joints=[] if health is None else [_joint(joint, old) for joint, old in zip(health.joints, silent, strict=True)],
        alerts=mended_alerts([outside(plain(alert_document(alert))) for alert in alerts]),
        next_replay_due=next_replay_due,
        said_at=utc(now_unix_s),
        stale=any(silent),
        production=[made(documents.ProductionEvidence, each) for each in production],
        ripple=[made(documents.JointRipple, each, joint=joint) for joint, each in enumerate(ripple, start=1)],
        **worded(
            why=why,
            stale_why=None if health is None else _stale_why(health, silent, now_unix_s, settings),
            nothing_learnt=nothing_learnt,
        ),
    )


def _joint(joint: JointHealth, stale: bool) -> documents.JointState:
    return documents.JointState(
        joint=joint.joint,
        state=cast(State, joint.state),
        since=utc(joint.since_unix_s),
        stale=stale,
        learnt_at=utc_if(joint.learnt_at_unix_s),
        **worded(why=joint.why),
    )


def _stale_why(health: Health, silent: tuple[bool, ...], now_unix_s: float, settings: HealthSettings) -> Reason | None:
    """For how long there was no figure, and of which joints; None where there was one of every joint."""
    if not any(silent):
        return None
    old = [joint for joint, is_old in zip(health.joints, silent, strict=True) if is_old]
    known = [joint.learnt_at_unix_s for joint in old if joint.learnt_at_unix_s is not None]
    limit = settings.stale_days
    since = FOR_DAYS(days=(now_unix_s - min(known)) / DAY_S, limit=limit) if known else NOT_YET(limit=limit)
    return stale_reason([joint.joint for joint in old], len(health.joints), since)
