"""The web page of one robot's monitor, put together from its configuration, its bus and its history."""

import re
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.config.schema import Configuration
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.model.joint_names import joint_name
from monitor.store.store import Store
from monitor.views.language.catalogue import LANGUAGES, language
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
    content = Content(
        store,
        bus,
        about(configuration),
        configuration.schedule,
        now,
        language=configuration.page.language,
        report=partial(_report, configuration, now),
        table=partial(_table, configuration),
        file_name=re.sub(r"[^A-Za-z0-9._-]+", "-", f"{configuration.robot.site}-{configuration.robot.id}"),
    )
    return PageServer(configuration.page, content, token)


def _report(configuration: Configuration, now: Callable[[], float], code: str) -> str:
    """The report on the whole history as HTML. It reads beside the daemon, which goes on. Raises BadInput where nothing can be drawn."""
    from monitor.service.history.report import report
    from monitor.views.plots.picture import needs_drawing
    from monitor.views.report.page import report_page

    needs_drawing("report")
    with Store.reader(configuration.state_directory) as store:
        return report_page([report(configuration, store, None, None, now())], language(code))


def _table(configuration: Configuration, _code: str) -> str:
    """Friction of every replay as CSV; programs read it, so it has no language."""
    from monitor.service.history.transfer import table

    with Store.reader(configuration.state_directory) as store:
        return str(table(store, "friction").to_csv(index=False))


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
            "base": np.round(configuration.mounting.rotation @ arm.base_rotation, 12).tolist(),
            "max_torque_nm": arm.max_torque_nm.tolist(),
        },
    }
