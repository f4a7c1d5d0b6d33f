"""Arms as the plant has heard them, for the tests of channels."""

from monitor.gateway.values import ArmState
from monitor.plant.links import ArmName

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
    """The newest friction of a joint, by the plant's columns."""
    return {
        **{"recorded_at": REPLAYED_UNIX_S, "replay": 7, "wear": 0.01 * joint, "wear_std": 0.004, "wear_rate_per_day": 0.001},
        **{"temperature_c": 30.0 + joint, "reference_torque_nm": 12.0, "trend_probability": 0.9},
        **{"p10_days": 40.0, "p50_days": 80.5, "p90_days": 200.0},
        **changes,
    }


def arm(robot="cell-3", site="lab", count=6, alerts=(), **changes):
    """A well arm with its documents; `changes` replace fields of the ArmState."""
    health = {
        **{"state": "MAINTENANCE_REQUIRED" if alerts else "NORMAL", "why": "well", "since": "2026-11-01T00:00:00Z", "stale": False},
        **{"said_at": "2026-11-18T11:06:00Z", "next_replay_due": "2026-11-18T15:00:00Z", "alerts": list(alerts)},
        "joints": [
            {
                **{"joint": joint, "state": "NORMAL", "why": "well", "since": "2026-11-01T00:00:00Z", "stale": False},
                "learnt_at": "2026-11-18T10:06:40Z",
            }
            for joint in range(1, count + 1)
        ],
    }
    given = {
        "name": ArmName(site, robot),
        "number": 1,
        "health": health,
        "monitor": {"last_replay": {"ended_at": "2026-11-18T10:06:40Z"}, "troubles": []},
        "info": {"robot": {"model": "ur5e"}, "serial": "20195500001", "firmware": "5.11.0", "version": "0.2.0"},
        "joints": {joint: row(joint) for joint in range(1, count + 1)},
        "heard_at_unix_s": {"health": NOW_UNIX_S - 20.0, "monitor": NOW_UNIX_S - 5.0},
    }
    return ArmState(**given | changes)
