"""What the plant does at its start and once a day: the priors of new arms, in a process that ends, and retention. I/O."""

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path

import sqlalchemy as sa

from monitor.errors import MonitorError
from monitor.plant.database import Database
from monitor.plant.ingest import set_note
from monitor.plant.priors import NOTE, Learn, Priors
from monitor.plant.tables import friction, history, stored
from monitor.recording import DAY_S
from monitor.service.computing import Apart, ComputingFailed

log = logging.getLogger(__name__)

AGAIN_S = 600.0  # [s] after an attempt that failed, or made no prior: the plant may be new, and its arms' histories under way


class Daily:
    """The thread. A context manager."""

    def __init__(
        self,
        database: Database,
        address: str | Path,
        days: float,
        learn: Learn | None,
        priors: Priors,
        ready: Callable[[], bool],
    ) -> None:
        """`days` : of retention. ready : whether this plant leads, and its database answers. learn : None: no prior is made."""
        self._database, self._address, self._days, self._ready = database, address, days, ready
        self._learn, self._priors = learn, priors
        self._compute = Apart(self._alive)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="daily")  # its child does not outlive it

    def __enter__(self) -> "Daily":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.is_set():
            if not self._ready():
                self._stopping.wait(1.0)
                continue
            done = False
            try:
                if (gone := prune(self._database, self._days, time.time(), self._stopping.is_set)) > 0:
                    log.info("retention: the identified parts of %d replays older than %g days are taken away", gone, self._days)
                done = self._learn is None or self._make(self._learn)
            except MonitorError as error:
                log.warning("retention: %s", error)
            except Exception:  # the thread must survive an error of this program; the log names it
                log.exception("what is done daily: a fault")
            self._stopping.wait(DAY_S if done else AGAIN_S)

    def _make(self, learn: Learn) -> bool:
        """Whether there are priors. A database that is away, and arms that say nothing yet, are told in the log."""
        try:
            found = self._compute(learn, self._address)
            self._priors.take(found)
            set_note(self._database, NOTE, time.time(), [each._asdict() for each in found])
        except MonitorError as error:
            log.info("no prior for new arms is made: %s", error)
            return False
        whole = [f"{each.model}: {each.arms} arms" for each in found if each.site is None]
        log.info("prior for new arms made: %s; of sites: %d", ", ".join(whole), len(found) - len(whole))
        return True

    def _alive(self) -> None:
        if self._stopping.is_set():
            raise ComputingFailed("the plant ends")


def prune(database: Database, days: float, now_unix_s: float, stops: Callable[[], bool] = lambda: False) -> int:
    """Take away what replays older than `days` were identified of; 0: nothing. Their verdicts, friction and transitions stay.

    Arm by arm, each in a transaction of its own. The number of replays. Raises StoreError.
    """
    if not days:
        return 0
    gone = 0
    with database.read() as connection:
        histories = connection.execute(sa.select(history.c.arm, history.c.number)).all()
    for arm, number in histories:
        if stops():
            break
        of_arm = (friction.c.arm == arm) & (friction.c.history == number) & (friction.c.joint == 1)
        old = sa.select(sa.cast(friction.c.replay, sa.Text)).where(of_arm, friction.c.recorded_at < now_unix_s - days * DAY_S)
        parts = (stored.c.arm == arm) & (stored.c.history == number) & (stored.c.of_table == "identified")
        with database.write() as connection:
            gone += connection.execute(sa.delete(stored).where(parts, stored.c.row.in_(old))).rowcount
    return gone
