"""The web page of one robot's monitor, put together from its configuration, its bus and its history."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.config.schema import Configuration
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.store.store import Store
from monitor.views.web.content import BusAccess, Content

if TYPE_CHECKING:
    from monitor.views.web.server import PageServer


def page(
    configuration: Configuration, bus: BusAccess, store: Store, now: Callable[[], float] = time.time
) -> "AbstractContextManager[PageServer | None]":
    """Serve the page while the context lasts; the context gives None where the configuration names no address.

    Raises BusError where the address is taken, BadInput where the token cannot be read.
    """
    if not configuration.page.listen:
        return nullcontext()
    from monitor.views.web.server import PageServer  # its import takes 0.3 s, and many monitors have no page

    token = configuration.page.token(configuration.path.parent)
    return PageServer(configuration.page, Content(store, bus, about(configuration), configuration.schedule, now), token)


def about(configuration: Configuration) -> dict[str, Any]:
    """What the page reads once: the robot's names, the alert levels and conditions, and the geometry of the arm."""
    who, arm, health = configuration.robot, configuration.robot_description, configuration.assess.health
    prognosis = configuration.assess.prognosis
    return {
        "robot": {
            "site": who.site,
            "id": who.id,
            "model": who.model,
            "mounting": who.mounting,
            "payload_kg": who.payload_kg,
            "tool": who.tool,
        },
        "key_prefix": configuration.key_prefix,
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
            "base": np.round(configuration.mounting.rotation @ arm.base_rotation, 12).tolist(),
            "max_torque_nm": arm.max_torque_nm.tolist(),
        },
    }
