"""Documents as an arm's monitor says them, with what a test changes."""

from monitor import __version__

SAID_AT = "2026-11-18T11:06:00Z"
STORE = {"history_bytes": 1, "last_backup_at": None, "free_bytes": None, "sqlite": "3"}
WHOLE = {
    "health": {"state": "NORMAL", "joints": [], "alerts": [], "next_replay_due": None, "said_at": SAID_AT},
    "monitor": {
        **{"version": __version__, "programs": {}, "started_at": SAID_AT, "uptime_s": 1.0, "said_at": SAID_AT, "troubles": []},
        **{"last_replay": None, "next_replay_due": None, "next_replay_why": None, "lag_s": None, "arm": {"heard": True}},
        **{"bus": {"to_send": 0, "to_answer": 0, "dropped": 0}, "store": STORE, "workers": {}, "reload": None, "overrides": []},
        "process": {"resident_bytes": None, "cpu_s": 1.0, "threads": 1, "pid": 1, "pid_namespace": None},
    },
    "info": {"robot": {"model": "ur5e"}, "version": __version__, "host": "h", "trajectory_digest": "t", "started_at": SAID_AT},
}
ALERT = {
    **{"joint": 3, "condition": "wear_rising", "tier": "wear", "active": True, "raised_at": SAID_AT, "updated_at": SAID_AT},
    **{"change": 0.1, "probability": 1.0, "text": "Friction has risen.", "action": "Inspect it."},
}
JOINT = {"state": "NORMAL", "why": "well", "since": "2026-11-01T00:00:00Z"}
LAST_REPLAY = {"replay": 7, "window": "2026-11-18T10:00:00Z", "state": "assessed", "reason": None, "ended_at": "2026-11-18T10:06:40Z"}
FRICTION = {
    **{"coulomb_nm": 3.0, "coulomb_std_nm": 0.1, "viscous_nm_s_per_rad": 4.0, "viscous_std_nm_s_per_rad": 0.1, "temperature_c": 31.0},
    **{"reference_speed_rad_s": 0.4, "reference_temperature_c": 25.0, "reference_torque_nm": 12.0, "reference_torque_std_nm": 0.1},
    **{"wear": 0.01, "wear_std": 0.004, "wear_rate_per_day": 0.001, "wear_rate_std_per_day": 0.0001},
}


def whole(key, **changes):
    """A document of this key; what lies in it is whole as well."""
    if isinstance(changes.get("last_replay"), dict):
        changes["last_replay"] = LAST_REPLAY | changes["last_replay"]
    if isinstance(changes.get("store"), dict):
        changes["store"] = STORE | changes["store"]
    if isinstance(changes.get("troubles"), list):
        changes["troubles"] = [{"code": "free", "parameters": {}, "text": "?", "since": SAID_AT, **each} for each in changes["troubles"]]
    if isinstance(changes.get("joints"), list) and all(isinstance(each, dict) for each in changes["joints"]):
        changes["joints"] = [JOINT | each for each in changes["joints"]]
    if isinstance(changes.get("alerts"), list) and all(isinstance(each, dict) for each in changes["alerts"]):
        changes["alerts"] = [ALERT | each for each in changes["alerts"]]
    return WHOLE.get(key, {}) | changes
