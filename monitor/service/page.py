"""The web page of one robot's monitor, put together from its configuration, its bus and its history."""

import re
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, ParamSpec

from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.service.computing import HERE, Compute, ComputingFailed
from monitor.store.store import Store
from monitor.views.language.catalogue import language
from monitor.views.web.content import Content
from monitor.views.web.page_content import BusAccess, about_arm
from monitor.views.web.server import PageServer

P = ParamSpec("P")

_one = threading.Lock()  # answer at a time: each takes a process, and several would take the memory of a replay under way


def page(
    configuration: Configuration, bus: BusAccess, store: Store, now: Callable[[], float] = time.time, compute: Compute = HERE
) -> PageServer:
    """The server of the page, which serves while its context lasts.

    Raises as `errors.cannot_listen`, BadInput where the token cannot be read.
    """
    token = configuration.page.token(configuration.path.parent)
    content = Content(
        store,
        bus,
        about(configuration),
        configuration.schedule,
        now,
        language=configuration.page.language,
        report=lambda code: answered(compute, _report, configuration, now(), code),
        table=lambda code: answered(compute, _table, configuration, code),
        file_name=re.sub(r"[^A-Za-z0-9._-]+", "-", f"{configuration.robot.site}-{configuration.robot.id}"),
    )
    return PageServer(configuration.page, content, token)


def answered(compute: Compute, function: Callable[P, str], *args: P.args, **kwargs: P.kwargs) -> str:
    """What somebody asks for once in a while, with all that drawing loads. Raises BadInput."""
    try:
        with _one:
            return compute(function, *args, **kwargs)
    except ComputingFailed as error:
        raise BadInput(f"nothing could be made, try again: {error}") from None


def _report(configuration: Configuration, now_unix_s: float, code: str) -> str:
    """The report on the whole history as HTML. It reads beside the daemon, which goes on. Raises BadInput where nothing can be drawn."""
    from monitor.service.history.report import report
    from monitor.views.report.page import report_page

    with Store.reader(configuration.state_directory) as store:
        return report_page([report(configuration, store, None, None, now_unix_s)], language(code))


def _table(configuration: Configuration, _code: str) -> str:
    """Friction of every replay as CSV; programs read it, so it has no language."""
    from monitor.service.history.transfer import table

    with Store.reader(configuration.state_directory) as store:
        return str(table(store, "friction").to_csv(index=False))


def about(configuration: Configuration) -> dict[str, Any]:
    """What the page reads once: the robot's names, the alert levels and conditions, and the geometry of the arm."""
    return about_arm(
        asdict(configuration.robot),
        configuration.key_prefix,
        configuration.robot_description,
        configuration.mounting,
        configuration.assess.health,
        configuration.assess.prognosis,
    )
