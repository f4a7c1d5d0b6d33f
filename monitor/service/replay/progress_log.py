"""The progress of a replay in the log, so that a person who has just started the service does not wait in silence."""

import logging
import time
from collections.abc import Callable

from monitor.acquire.watch import ReplayProgress

log = logging.getLogger(__name__)

EVERY_S = 5.0
NODE = "node"  # the phase in which a replay waits for the program's node


def progress_log(monotonic: Callable[[], float] = time.monotonic) -> Callable[[ReplayProgress], None]:
    """Logs where a replay is, a line every EVERY_S, e.g. `slow first pass, 40 s of 52`."""
    logged_at, passed_by = monotonic(), ""

    def show(at: ReplayProgress) -> None:
        nonlocal logged_at, passed_by
        if at.phase == NODE:  # that may last for days: a line where something is new
            if at.passed_by != passed_by:
                passed_by = at.passed_by
                log.info("the program's node was passed by: %s", passed_by)
        elif monotonic() - logged_at >= EVERY_S:
            logged_at = monotonic()
            total = f" of {at.duration_s:.0f}" if at.duration_s else ""
            log.info("%s, %.0f s%s", at.text, at.elapsed_s, total)

    return show
