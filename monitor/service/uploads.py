"""Recordings go to the archive behind the local copy: one after the other, tried again for ever, never in the way of a replay. I/O."""

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import closing

from monitor.config.schema import Configuration
from monitor.errors import ArchiveRefused, ArchiveUnavailable, StoreError
from monitor.publish.timestamps import rfc3339
from monitor.reason import Reason, Sentence
from monitor.recording import DAY_S
from monitor.service.computing import HERE, Compute, ComputingFailed
from monitor.service.housekeeping import going, prune
from monitor.service.problems import Problems
from monitor.store.archive.archive import Archive, ArchivedRecording, Copy
from monitor.store.archive.archived import ArchivedRow, Waiting, bring, changed, copies, listed
from monitor.store.archive.places import ArchiveSettings
from monitor.store.store import Store

log = logging.getLogger(__name__)

AT_A_TIME = 20  # recordings that one process brings
IDLE_S = 10.0  # between two looks for a recording that waits
FIRST_RETRY_S, LONGEST_RETRY_S = 5.0, 600.0  # doubled after each failure
UNHEARD = 3  # failures in a row from which a server that does not answer is a problem: shorter, it is a restart or a cable
SLOW_S = 300.0  # one recording takes seconds
NOT_ARCHIVED = Sentence("not_archived", "{why}; {meanwhile}")
ON_ITS_WAY = Sentence("archive_slow", "one recording has been on its way to the archive for {minutes:.0f} min; {meanwhile}")
RECORDINGS_WAIT = Sentence("recordings_wait", "recordings wait")
NONE_WAITS = Sentence("recordings_counted", "{count} recordings wait here; replays go on")
WAIT_SINCE = Sentence("recordings_wait_since", "{count} recordings wait here, the oldest since {since}; replays go on")
GONE = Sentence("archive_lost_recording", "{address}: is not there any more, and not here: restore it from a copy")
LEFT = Sentence("archive_differs", "replay {replay}: {why}; the recording stays here")
UNSOUND = Sentence("archive_unsound", "replay {replay}: {why}")
AND_MORE = Sentence("and_more", "{first}; and {more} more")
PROBLEM, SLOW = "archive", "archive_slow"


class Stopping(Exception):
    """The service stops: what is under way is given up, and comes again after the next start."""


class Uploads:
    """Call `step` again and again, or `run` in a thread of its own. All that it knows is in the history: it may be killed at any moment."""

    def __init__(
        self,
        store: Store,
        configuration: Callable[[], Configuration],
        problems: Problems,
        now: Callable[[], float],
        monotonic: Callable[[], float] = time.monotonic,
        compute: Compute = HERE,
    ) -> None:
        """`compute` speaks with the archive: in the daemon, a process of its own."""
        self._store, self._configuration, self._problems, self._now, self._monotonic = store, configuration, problems, now, monotonic
        self._compute = compute
        self._settings: ArchiveSettings | None = None
        self._failures = 0
        self._left: dict[int, str | None] = {}  # windows that are left out, and what is wrong; None: no file
        self._again: set[int] = set()  # those of them that are tried once more: daily, a person may have put it right
        self._gone: list[ArchivedRow] = []  # neither here nor there any more
        self._unsound: dict[int, Reason] = {}  # windows whose recordings the archive holds otherwise than they were, and what is wrong
        self._going: list[int] = []  # windows whose recordings may go from here once the archive's copy was read back
        self._compared = -math.inf  # monotonic: when history and archive were compared
        self._began: float | None = None  # monotonic: since when an upload is under way

    def run(self, stopping: threading.Event) -> None:
        """Until `stopping`."""
        while not stopping.is_set():
            try:
                pause_s = self.step()
            except Stopping:
                return
            except StoreError as error:  # the history, not the archive
                self._problems.report("store", error.reason)
                pause_s = IDLE_S
            except Exception:  # uploads must go on after an error of this program; the log names it
                log.exception("an upload met a fault")
                pause_s = LONGEST_RETRY_S
            stopping.wait(pause_s)

    def step(self) -> float:
        """Bring the oldest recordings that wait, let go of old ones, or compare history and archive.

        Returns how long to wait before the next step [s].
        """
        settings = self._in_force()
        if settings is None:
            return IDLE_S
        oldest = self._store.archived.waiting(len(self._left) + AT_A_TIME)
        waiting = [each for each in oldest if each.ledger_id not in self._left or each.ledger_id in self._again][:AT_A_TIME]
        if not waiting and not self._going and self._monotonic() - self._compared < DAY_S:
            self._failures = 0
            self._tell_left()
            return IDLE_S
        self._began = self._monotonic()
        try:
            if waiting:
                self._bring(settings, waiting)
            elif self._going:
                self._let_go(settings)
            else:
                self._compare(settings)
        except (ArchiveRefused, ArchiveUnavailable, ComputingFailed) as error:
            self._failures += 1
            if isinstance(error, ArchiveRefused) or self._failures >= UNHEARD:
                self._problems.report(PROBLEM, NOT_ARCHIVED(why=error.reason, meanwhile=self._consequence()))
            return float(min(FIRST_RETRY_S * 2 ** min(self._failures - 1, 20), LONGEST_RETRY_S))
        finally:
            self._began = None
            self._problems.clear(SLOW)
        self._failures = 0
        self._tell_left()
        return 0.0

    def observe(self) -> None:
        """Report an upload that does not come to an end. Call it from another thread."""
        began = self._began
        if began is not None and self._monotonic() - began > SLOW_S:
            minutes = (self._monotonic() - began) / 60.0
            self._problems.report(SLOW, ON_ITS_WAY(minutes=minutes, meanwhile=self._consequence()))

    def _in_force(self) -> ArchiveSettings | None:
        """The settings in force, which the history notes; None where there is no archive."""
        settings = self._configuration().archive
        if settings != self._settings:
            self._left, self._again, self._gone, self._unsound, self._going = {}, set(), [], {}, []
            self._compared, self._failures = -math.inf, 0
            if settings is None:
                self._problems.clear(PROBLEM)
            else:
                self._store.archived.note_place(settings)
            self._settings = self._store.archived.settings = settings
        return settings

    def _bring(self, settings: ArchiveSettings, waiting: list[Waiting]) -> None:
        robot = self._configuration().robot
        with closing(self._compute.steps(bring, settings, robot.site, robot.id, waiting)) as outcomes:
            for number, outcome in outcomes:
                self._began = self._monotonic()
                self._failures = 0
                self._again.discard(number)
                if isinstance(outcome, Copy):
                    self._left.pop(number, None)
                    self._store.archived.add(number, outcome, self._now())
                    log.info("archived replay=%d bytes=%d%s", number, outcome.size, " (it was there)" if outcome.was_there else "")
                else:
                    self._left[number] = outcome

    def _compare(self, settings: ArchiveSettings) -> None:
        """Once a day: what the archive has lost is brought again from here, and what the history has forgotten is noted again."""
        robot = self._configuration().robot
        root = Archive.open(settings).address("")
        rows = [row for row in self._store.archived.rows() if row.address.startswith(root)]
        arms = sorted({(robot.site, robot.id), *(_arm_of(row.address[len(root) :]) for row in rows)})
        present = self._compute(listed, settings, arms)
        unsound = self._note_forgotten(settings, present, {row.address for row in rows})
        lost = [row for row in rows if (there := present.get(row.address)) is None or there.size != row.size]
        self._gone = [row for row in lost if not self._store.recordings.path(row.ledger_id).is_file()]
        for row in lost:
            if row not in self._gone:
                log.warning("replay=%d is not in the archive any more, and is brought again: %s", row.ledger_id, row.address)
                self._store.archived.remove(row.ledger_id)
        among = {row.ledger_id for row in rows} - {row.ledger_id for row in lost}
        self._going = going(self._store, self._configuration().store, self._now(), among)
        # what was found before is told until it is read back once more: else its problem would end and begin again every day
        self._unsound = {number: text for number, text in self._unsound.items() if number in self._going} | unsound
        self._again = {number for number, text in self._left.items() if text is not None}
        self._compared = self._monotonic()

    def _note_forgotten(self, settings: ArchiveSettings, present: Mapping[str, ArchivedRecording], known: set[str]) -> dict[int, Reason]:
        """A history that was restored from an older backup does not know what was archived since: number and time say which it is.

        Returns what is wrong with those that are not as they were brought there, by their windows.
        """
        unsound: dict[int, Reason] = {}
        unknown: dict[int, list[ArchivedRecording]] = {}
        for address, each in present.items():
            if address not in known:
                unknown.setdefault(each.replay, []).append(each)
        there = []
        for window in self._store.archived.forgotten() if unknown else ():
            found = [each for each in unknown.get(window.ledger_id, ()) if window.may_be(each.recorded_at_unix_s)]
            there += [(window.ledger_id, found[0])] if len(found) == 1 else []  # of several nobody knows which it is
        if not there:
            return unsound
        with closing(self._compute.steps(copies, settings, there)) as outcomes:
            for number, outcome in outcomes:
                self._began = self._monotonic()
                if isinstance(outcome, Copy):
                    self._store.archived.add(number, outcome, self._now())
                    self._left.pop(number, None)
                    log.info("found again in the archive: replay=%d %s", number, outcome.address)
                else:
                    unsound[number] = UNSOUND(replay=number, why=outcome)
        return unsound

    def _let_go(self, settings: ArchiveSettings) -> None:
        """Remove some of the recordings that retention lets go, each after its copy in the archive was read back and compared."""
        some = self._going[:AT_A_TIME]
        rows = [row for number in some if (row := self._store.archived.of(number)) is not None]
        sound = set()
        with closing(self._compute.steps(changed, settings, rows)) as outcomes:
            for number, wrong in outcomes:
                self._began = self._monotonic()
                if wrong is None:
                    sound.add(number)
                    self._unsound.pop(number, None)
                else:
                    self._unsound[number] = LEFT(replay=number, why=wrong)
        prune(self._store, self._configuration().store, self._problems, self._now(), sound)
        self._going = self._going[len(some) :]

    def _tell_left(self) -> None:
        """The problem of what the archive has lost, or holds otherwise; none where there is nothing of it."""
        found = [GONE(address=row.address) for row in self._gone]
        found += [LEFT(replay=number, why=text) for number, text in self._left.items() if text is not None]
        found += self._unsound.values()
        first = found[0] if found else None
        self._problems.update(PROBLEM, first if first is None or len(found) == 1 else AND_MORE(first=first, more=len(found) - 1))

    def _consequence(self) -> Reason:
        try:
            count, since = self._store.archived.waits()
        except StoreError:
            return RECORDINGS_WAIT()
        return NONE_WAITS(count=count) if since is None else WAIT_SINCE(count=count, since=rfc3339(since))


def _arm_of(key: str) -> tuple[str, str]:
    """Site and robot of a recording below the archive's address."""
    site, robot, *_ = (part.partition("=")[2] for part in key.split("/"))
    return site, robot
