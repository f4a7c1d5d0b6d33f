"""What is published of an arm: its retained messages by topic. No I/O, no clock.

A figure that is not known is null. Times are RFC 3339, wear is in percent, and units stand in the names.
"""

from collections.abc import Mapping
from typing import Any

import orjson

from monitor.gateway.figures import ArmFigures, JointFigures, unacknowledged
from monitor.gateway.mqtt.topics import OFFLINE, ONLINE, ArmTopics
from monitor.publish.timestamps import rfc3339


def messages(arm: ArmFigures, topics: ArmTopics, now_unix_s: float) -> dict[str, bytes]:
    """The retained messages of an arm, by topic; its availability is the last one, so that nobody believes old values."""
    silence = arm.silence(now_unix_s)
    told = {topics.state: _json(_arm(arm, silence)), topics.alerts: _json({"alerts": list(arm.alerts)})}
    told |= {topics.joint(joint.joint): _json(_joint(joint)) for joint in arm.joints}
    return told | {topics.availability: (OFFLINE if silence else ONLINE).encode()}


def _arm(arm: ArmFigures, silence: tuple[float | None, str] | None) -> dict[str, Any]:
    since, why = silence or (None, None)
    return {
        "site": arm.site,
        "robot": arm.robot,
        "model": arm.model,
        "serial": arm.serial,
        "state": arm.state,
        "why": arm.why,
        "since": _time(arm.since_unix_s),
        "stale": arm.stale,
        "alerts": len(arm.alerts),
        "unacknowledged": len(unacknowledged(arm.alerts)),
        "last_replay": _time(arm.last_replay_unix_s),
        "next_replay": _time(arm.next_replay_unix_s),
        "troubles": list(arm.troubles),
        "silent_since": _time(since),
        "silent_why": why,
        "version": arm.version,
    }


def _joint(joint: JointFigures) -> dict[str, Any]:
    p10, p50, p90 = joint.life_days
    return {
        "joint": joint.joint,
        "state": joint.state,
        "why": joint.why,
        "since": _time(joint.since_unix_s),
        "stale": joint.stale,
        "learnt_at": _time(joint.learnt_unix_s),
        "measured_at": _time(joint.measured_unix_s),
        "wear_percent": _percent(joint.wear),
        "wear_std_percent": _percent(joint.wear_std),
        "temperature_c": _rounded(joint.temperature_c, 2),
        "friction_nm": _rounded(joint.friction_nm, 3),
        "remaining_life_p10_days": _rounded(p10, 1),
        "remaining_life_p50_days": _rounded(p50, 1),
        "remaining_life_p90_days": _rounded(p90, 1),
        "trend_probability": _rounded(joint.trend_probability, 4),
        "alerts": len(joint.alerts),
        "unacknowledged": len(unacknowledged(joint.alerts)),
    }


def _json(document: Mapping[str, Any]) -> bytes:
    return orjson.dumps(document)


def _time(unix_s: float | None) -> str | None:
    return None if unix_s is None else rfc3339(unix_s)


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def _percent(fraction: float | None) -> float | None:
    return None if fraction is None else round(100.0 * fraction, 3)
