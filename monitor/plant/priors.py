"""The priors that the plant tells new arms: made at its start and daily, in a process that ends, and answered on the bus. I/O."""

import logging
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import orjson
import zenoh

from monitor.errors import MonitorError
from monitor.plant.database import Database
from monitor.plant.ingest import set_note
from monitor.publish.session import PLANT, encoding
from monitor.recording import DAY_S
from monitor.service.computing import Apart, ComputingFailed

log = logging.getLogger(__name__)

NOTE = "priors"  # in the plant's database, for whoever looks there
AGAIN_S = 600.0  # [s] after an attempt that made none: the plant may be new, and its arms' histories under way
NONE_YET = "the plant has no prior of a {model}: no arm of it has replays enough, or none was made since the plant's start"


class ModelPrior(NamedTuple):
    """The newest prior of a model, as it is said."""

    site: str | None  # None: of the arms of all sites
    model: str
    arms: int
    made_at: str
    text: str  # the document, JSON


Learn = Callable[[str | Path], list[ModelPrior]]  # from the address of the plant's database


class Priors:
    """What is answered below `joint-monitor/plant/v1/prior`: SITE/MODEL. Methods may be called from any thread."""

    def __init__(self) -> None:
        self._known: dict[tuple[str | None, str], ModelPrior] = {}

    def take(self, priors: Sequence[ModelPrior]) -> None:
        """Answer with these from now on."""
        self._known = {(each.site, quote(each.model, safe="")): each for each in priors}

    def answer(self, query: zenoh.Query) -> None:
        """Answer one question: exactly one site and model, or every prior of a site that a selector with wildcards names."""
        known = self._known
        with query:
            key = str(query.key_expr)
            if "*" in key or "$" in key:
                for (site, model), each in known.items():
                    full = zenoh.KeyExpr(f"{PLANT}/prior/{site or ANY_SITE}/{model}")
                    if query.key_expr.intersects(full):
                        query.reply(full, each.text.encode(), encoding=encoding("prior"))
                return
            site, _, model = key.removeprefix(f"{PLANT}/prior/").partition("/")
            found = known.get((site, model)) or known.get((None, model))
            if found is None:
                query.reply_err(orjson.dumps({"error": NONE_YET.format(model=model)}), encoding=encoding("error"))
            else:
                query.reply(query.key_expr, found.text.encode(), encoding=encoding("prior"))


ANY_SITE = "-"  # in the place of the site: of all of them


class PriorMaker:
    """Makes the priors beside the plant. A context manager."""

    def __init__(self, database: Database, address: str | Path, learn: Learn, priors: Priors, ready: Callable[[], bool]) -> None:
        """`ready` : whether the database has its tables and answers."""
        self._database, self._address, self._learn, self._priors, self._ready = database, address, learn, priors, ready
        self._compute = Apart(self._alive)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="priors")  # its child does not outlive it

    def __enter__(self) -> "PriorMaker":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()

    def make(self) -> bool:
        """Make them once; whether there are any. A database that is away, and arms that say nothing yet, are told in the log."""
        try:
            found = self._compute(self._learn, self._address)
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

    def _run(self) -> None:
        while not self._stopping.is_set():
            if not self._ready():
                self._stopping.wait(1.0)
                continue
            try:
                made = self.make()
            except Exception:  # the thread must survive an error of this program; the log names it
                log.exception("the priors for new arms: a fault")
                made = False
            self._stopping.wait(DAY_S if made else AGAIN_S)
