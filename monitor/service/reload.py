"""SIGHUP: read the configuration again. All of it is right, or nothing of it is taken. I/O."""

import logging
import time
from collections.abc import Sequence
from typing import Any

from monitor.config.load import load
from monitor.config.reload import reloaded
from monitor.errors import BadConfiguration
from monitor.service.monitor import Monitor
from monitor.service.scheduler import Scheduler
from monitor.service.systemd import notify, reloading

log = logging.getLogger(__name__)


class Reloader:
    """Reloads the configuration on request, and keeps the outcome of the last reload for the monitor's document."""

    def __init__(self, monitor: Monitor, scheduler: Scheduler) -> None:
        self._monitor, self._scheduler = monitor, scheduler
        self.outcome: dict[str, Any] | None = None  # of the last reload; None before the first

    def reload(self) -> None:
        """Read the file once more. A mistake in it is logged, and the settings in force stay."""
        reloading()
        try:
            found = reloaded(self._monitor.configuration, load(self._monitor.configuration.path))
        except BadConfiguration as error:
            log.error("reload refused, the old configuration stays: %s", error)
            self._keep(done=False, text=str(error))
        else:
            self._monitor.reconfigure(found.configuration)
            self._scheduler.reconsider()
            log.info("reloaded: %s", found.text)
            self._keep(done=True, text=found.text, waiting=found.waiting, held=found.held)
        notify("READY=1")

    def _keep(self, *, done: bool, text: str, waiting: Sequence[str] = (), held: Sequence[str] = ()) -> None:
        self.outcome = {"at_unix_s": time.time(), "done": done, "told": text, "waiting": list(waiting), "held": list(held)}
