"""What the page of one arm reads once: its names, the alert levels and conditions, and the geometry of the arm."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.alerts.health import HealthSettings
from monitor.judge.alerts.remaining_life import PrognosisSettings
from monitor.model.robot import Mounting, Robot
from monitor.reason import joint_name
from monitor.views.language.catalogue import LANGUAGES

SHOWN = ("site", "id", "model", "mounting", "payload_kg", "tool")  # keys of [robot]


def about_arm(
    robot: Mapping[str, Any], key_prefix: str, arm: Robot, mounting: Mounting, health: HealthSettings, prognosis: PrognosisSettings
) -> dict[str, Any]:
    """The document. robot : the section [robot] of the arm's configuration."""
    return {
        "robot": {name: robot[name] for name in SHOWN},
        "key_prefix": key_prefix,
        "joints": [joint_name(j + 1) for j in range(arm.joints)],
        "languages": LANGUAGES,
        "levels": [
            {"name": "wear tier", "rise": health.wear_rise, "state": "MAINTENANCE_REQUIRED"},
            {"name": "limit", "rise": health.limit_rise, "state": "FAILURE"},
        ],
        "conditions": {
            name: {"states": {tier: of.state for tier, of in condition.tiers.items()}, "probability_of": condition.probability_of}
            for name, condition in CONDITIONS.items()
        },
        "life": {"limit_rise": prognosis.limit_rise, "service_days": prognosis.service_days},
        "arm": {
            "links": list(arm.link_names),
            "a_m": arm.a_m.tolist(),
            "d_m": arm.d_m.tolist(),
            "alpha_rad": arm.alpha_rad.tolist(),
            "zero_rad": arm.zero_rad.tolist(),
            "base": np.round(mounting.rotation @ arm.base_rotation, 12).tolist(),
            "max_torque_nm": arm.max_torque_nm.tolist(),
        },
    }
