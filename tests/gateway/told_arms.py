"""Arms as the plant has heard them, for the tests of channels."""

from heard_documents import FRICTION, JOINT, LAST_REPLAY, whole

from monitor.plant.arm import ArmName, HeardArm, documents_of
from monitor.publish.documents import HistoryRow

NOW_UNIX_S = 1_795_000_000.0  # 2026-11-18T11:06:40Z
REPLAYED_UNIX_S = NOW_UNIX_S - 3600.0


def alert(joint=3, condition="wear_rising", **changes):
    return {
        **{"joint": joint, "condition": condition, "tier": "wear", "active": True, "severity": "high", "change": 0.3, "probability": 0.99},
        **{"text": f"Joint {joint} wears.", "action": "Order a gear.", "raised_at": "2026-11-18T03:00:00Z"},
        **{"updated_at": "2026-11-18T03:00:00Z", "acknowledged_at": None, "acknowledged_by": None, "shelved_until": None},
        **changes,
    }


def row(joint=1, **changes):
    """The newest friction of a joint; days of its remaining life among the changes."""
    life = {"trend_probability": 0.9, "p10_days": 40.0, "p50_days": 80.5, "p90_days": 200.0, "verdict": "trend"}
    life |= {name: changes.pop(name) for name in list(changes) if name in life}
    known = {"joint": joint, "replay": 7, "recorded_at": "2026-11-18T10:06:40Z", "wear": 0.01 * joint, "temperature_c": 30.0 + joint}
    return HistoryRow.model_validate({**FRICTION, **known, "remaining_life": life, **changes})


def health(count=6, alerts=(), joints=None, **changes):
    """The document of an arm that is well, or that has these alerts; `joints` : what is said otherwise of some, by number."""
    known = {
        **{"state": "MAINTENANCE_REQUIRED" if alerts else "NORMAL", "why": "well", "since": "2026-11-01T00:00:00Z"},
        **{"said_at": "2026-11-18T11:06:00Z", "next_replay_due": "2026-11-18T15:00:00Z", "alerts": list(alerts)},
        "joints": [
            {**JOINT, "joint": joint, "learnt_at": "2026-11-18T10:06:40Z", **(joints or {}).get(joint, {})} for joint in range(1, count + 1)
        ],
    }
    return whole("health", **known | changes)


def arm(robot="cell-3", site="lab", count=6, alerts=(), **changes):
    """A well arm with its documents; `changes` replace fields of the HeardArm, documents as they come among them."""
    about = {"robot": {"model": "ur5e"}, "serial": "20195500001", "firmware": "5.11.0", "version": "0.2.0"}
    said = {"health": health(count, alerts), "monitor": whole("monitor", last_replay=LAST_REPLAY), "info": whole("info", **about)}
    said |= {key: changes.pop(key) for key in list(said) if key in changes}
    given = {
        **{"name": ArmName(site, robot), "number": 1, "friction": {joint: row(joint) for joint in range(1, count + 1)}},
        "heard_at_unix_s": {"health": NOW_UNIX_S - 20.0, "monitor": NOW_UNIX_S - 5.0},
    }
    return HeardArm(**given | documents_of(said, NOW_UNIX_S) | changes)
