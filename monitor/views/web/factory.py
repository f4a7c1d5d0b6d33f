"""The page of one robot's monitor, put together from its configuration, its bus and its store.

`configuration` is a `monitor.config.load.Configuration`, which lies above this room.
"""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from monitor.store.store import Store
from monitor.views.web.content import Ask, Content


def page(configuration: Any, bus: Ask, store: Store, now: Callable[[], float] = time.time) -> AbstractContextManager[Any]:
    """The server while it is in use; nothing where no page is configured. Raises BusError, or BadInput for a token that cannot be read."""
    if not configuration.page.listen:
        return nullcontext()
    from monitor.views.web.server import PageServer  # 0.3 s, and only where there is a page

    token = configuration.page.token(configuration.path.parent)
    return PageServer(configuration.page, Content(store, bus, about(configuration), configuration.schedule, now), token)


def about(configuration: Any) -> dict[str, Any]:
    """Who it is, and the arm's geometry for its drawing."""
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
