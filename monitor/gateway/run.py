"""The gateway as a service: it takes transitions from the plant's database and gives each channel a thread of its own. I/O.

A database that is away is waited for. A channel whose other side is away tries again, later and later, and holds up no other one.
"""

import logging
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack

import sqlalchemy as sa

from monitor import __version__
from monitor.errors import BadConfiguration, BadInput, MonitorError, StoreUnavailable
from monitor.gateway.channel import Channel, Surroundings
from monitor.gateway.commands import Commands
from monitor.gateway.outbox import GatewayLock, Noted, Outbox
from monitor.gateway.settings import GatewayConfiguration
from monitor.gateway.silence import SILENCES, ArmsWatch, PlantWatch
from monitor.gateway.source import Source, Taken
from monitor.gateway.values import RAISED, Transition, active
from monitor.plant.arm import ArmName, HeardArm
from monitor.plant.database import PATIENCE_S, Database
from monitor.plant.ingest import set_note
from monitor.recording import DAY_S
from monitor.service.systemd import Heartbeats, StatusLine, Watchdog, notify

log = logging.getLogger(__name__)

RUNNING = "gateway"  # name of the note that it runs
TICK_S = 1.0
HEARTBEAT_S = 10.0  # between two notes that the gateway runs
LONGEST_PAUSE_S = 60.0  # between two attempts to reach the database
LOG_FIRST_S = 120.0  # within which the log of an arm says what its health says
STEP_S = 300.0  # a channel whose step takes longer hangs: the service manager starts the gateway anew
LONGEST_WAIT_S = STEP_S / 3.0  # between two steps of a channel
TROUBLE_PAUSE_S = 5.0, LONGEST_WAIT_S  # of a channel: first and longest
WAIT_S = 0.5  # between two looks whether a channel may act
STOP_S = 20.0  # for all channels to end what they do

Make = Callable[[Surroundings], Sequence[Channel]]


class Worker:
    """The thread of one channel."""

    def __init__(
        self, channel: Channel, surroundings: Surroundings, heartbeats: Heartbeats, permitted: threading.Event, *, shows: bool = False
    ) -> None:
        """`shows` : states, and owes nothing: it goes on while the database is away."""
        self._shows, self._has_shown = shows, False
        self.channel, self._surroundings, self._heartbeats, self._permitted = channel, surroundings, heartbeats, permitted
        self.trouble: str | None = None
        self.trouble_since_unix_s: float | None = None
        self.next_try_unix_s: float | None = None  # while there is trouble
        self._stopping, self._wake = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name=channel.name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def wake(self) -> None:
        """There is something new: do not wait for the end of the pause."""
        self._wake.set()

    def stop(self) -> None:
        """End after the present step."""
        self._stopping.set()
        self._wake.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the present step."""
        self._thread.join(timeout_s)

    @property
    def may(self) -> bool:
        """Whether it may act now.

        While the database is away, states that are shown must be seen to age. Such a channel goes on until something goes wrong: then
        another gateway may show them in its place.
        """
        return self._permitted.is_set() or (self._shows and self._has_shown and self.trouble is None)

    def once(self) -> float:
        """One step; what goes wrong becomes the channel's trouble. Returns the pause after it [s]."""
        now = self._surroundings.now()
        try:
            pause_s = self.channel.step(now)
        except MonitorError as error:
            return self._troubled(str(error), getattr(error, "wait_s", 0.0))
        except Exception as error:
            log.exception("%s: a step ended", self.channel.name)
            return self._troubled(f"{type(error).__name__}: a mistake of this program; the journal has more")
        if self.trouble is not None:
            log.info("%s: works again", self.channel.name)
        self.trouble = self.trouble_since_unix_s = self.next_try_unix_s = None
        self._failures = 0
        self._has_shown = True
        return pause_s

    _failures = 0

    def _troubled(self, why: str, wait_s: float = 0.0) -> float:
        why = self._surroundings.scrub(why)
        if why != self.trouble:
            log.warning("trouble=%s: %s; tried again", self.channel.name, why, extra={"trouble": self.channel.name})
        if self.trouble_since_unix_s is None:
            self.trouble_since_unix_s = self._surroundings.now()
        self.trouble = why
        self._failures += 1
        first, longest = TROUBLE_PAUSE_S
        pause_s = float(min(first * 2.0 ** min(self._failures - 1, 10), longest))
        self.next_try_unix_s = self._surroundings.now() + max(pause_s, wait_s)
        return pause_s

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._heartbeats.beat(self.channel.name, STEP_S)
            self._wake.clear()
            pause_s = self.once() if self.may else WAIT_S
            self._heartbeats.beat(self.channel.name, STEP_S)
            self._wake.wait(min(max(pause_s, 0.0), LONGEST_WAIT_S))


class Gateway:
    """One running gateway. A context manager; `step` is called until it ends."""

    def __init__(
        self, configuration: GatewayConfiguration, make: Sequence[Make] | None = None, now: Callable[[], float] = time.time
    ) -> None:
        """`make` : instead of the configured channels. Raises BadConfiguration, BadInput."""
        self._stack = ExitStack()
        self.configuration, self._now = configuration, now
        self._owes = configuration.owes if make is None else True
        self.database = Database(configuration.plant.database, patience_s=PATIENCE_S)
        self._stack.callback(self.database.close)
        self.outbox, self.source = Outbox(self.database, now), Source(self.database)
        plant = configuration.plant
        self.commands = Commands(self.database, plant.plant.connect, plant.zenoh_file, now)
        self._stack.callback(self.commands.close)
        self.heartbeats = Heartbeats()
        self.permitted = threading.Event()  # while the database answers, and no other gateway works with it
        self._surroundings = Surroundings(
            plant=plant,
            language=configuration.gateway.language,
            link=configuration.gateway.link.rstrip("/"),
            outbox=self.outbox,
            arms=self.source.arms,
            transitions=self.outbox.told,
            commands=self.commands,
            now=now,
            scrub=configuration.scrub,
        )
        self._gateway_lock = GatewayLock(self.database)
        self._stack.callback(self._gateway_lock.release)
        self.workers: list[Worker] = []
        self._arms_watch = ArmsWatch(configuration.gateway.silent_hours * 3600.0)
        self._plant_watch = PlantWatch(configuration.gateway.plant_silent_minutes * 60.0)
        self._noted = Noted(set(), {}, set())
        self._seen: dict[str, float] = {}  # what arms say and nobody is told of: since when, by this clock
        self.trouble: str | None = "the database is not open yet"
        self._pause_s, self._next_try, self._heartbeat_at, self._pruned_at = 0.0, 0.0, 0.0, -DAY_S
        self._began_unix_s = now()
        try:
            for each, shows in _configured(configuration) if make is None else [(each, False) for each in make]:
                for channel in _made(each, self._surroundings):
                    self._stack.callback(channel.close)
                    self.workers.append(Worker(channel, self._surroundings, self.heartbeats, self.permitted, shows=shows))
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> "Gateway":
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self.workers:
            worker.stop()
        until = time.monotonic() + STOP_S
        for worker in self.workers:
            if self._started:
                worker.join(max(until - time.monotonic(), 0.1))
        self._stack.close()

    _started = False

    def start(self) -> None:
        """Begin the channels' threads; before the database is open they would only wait."""
        if not self._started:
            self._started = True
            for worker in self.workers:
                worker.start()

    def step(self) -> None:
        """Take what the plant has copied, and owe what follows from it. Raises StoreError where waiting would change nothing."""
        if self.trouble is not None and time.monotonic() < self._next_try:
            return
        try:
            if self.trouble is not None:
                self._open()
            self.source.refresh()
            if self._owes:
                self._take()
            if self.trouble is not None or time.monotonic() - self._heartbeat_at >= HEARTBEAT_S:
                if self._owes:
                    self._gateway_lock.take()
                self._heartbeat()  # what can be read may still be locked: the trouble is over once a row is written
            if self.trouble is not None:
                if self._pause_s:
                    log.info("the database answers again: %s", self.database.name)
                self.trouble, self._pause_s = None, 0.0
            self.permitted.set()
        except StoreUnavailable as error:
            self.permitted.clear()
            if self.trouble != str(error):
                log.error("trouble=database: %s; waiting for it", error, extra={"trouble": "database"})
            self.trouble = str(error)
            self._pause_s = min(max(2.0 * self._pause_s, 1.0), LONGEST_PAUSE_S)
            self._next_try = time.monotonic() + self._pause_s

    def status(self) -> str:
        """The line that `systemctl status` shows."""
        parts = [f"WAITING: {self.trouble}"] if self.trouble else [f"{len(self.source.arms())} arms"]
        parts += [f"{each.channel.name}: {each.trouble or each.channel.status()}" for each in self.workers] or ["no channel is configured"]
        return "; ".join(parts)[:500]

    def _open(self) -> None:
        self.database.forget()
        self.database.migrate()
        if self._owes:
            self._gateway_lock.take()
            if (noted := self.outbox.noted()) is None:
                noted = self._begin()
            self._noted = noted
            self._plant_watch.rest()

    def _begin(self) -> Noted:
        """There is a gateway from now on: what is copied is of before."""
        with self.database.write() as connection:
            before = self.source.everything(connection)
            self.outbox.begin(connection)
            self._pass(connection, before)
        return Noted(set(before.known), {}, set())

    def _take(self) -> None:
        more = True
        while more:
            taken = self.source.transitions(self._noted.known)
            arms, now, told = self.source.arms(), self._now(), self.outbox.owed(SILENCES)
            silences = self._arms_watch.look(arms, self.source.plant_said_unix_s, told, now)
            silences += self._plant_watch.look(self.source.plant_said_unix_s, told, now)
            there = self.outbox.taken([each.id for each in taken.transitions])  # of a history that is copied anew
            noted, new, late = self._noted.copy(), list[Transition](), list[Transition]()
            for each in taken.transitions:
                if each.id in there:
                    continue
                raised = each.kind == RAISED and each.place in noted.already and not noted.new_to(each.place, each.after)
                (late if raised else new).append(each)  # an alert that was told before its raising came
                if each.changes_tier:
                    noted.told(each.place, each.after, already=False)
            new += self._untold(arms, noted, now)
            if not (taken.cursors or taken.known or silences or new):
                return
            found = [*new, *(each.transition for each in silences)]
            owed = [(each.channel.name, delivery) for each in self.workers for one in found for delivery in each.channel.offer(one)]
            with self.database.write() as connection:
                for name, delivery in owed:
                    self.outbox.add(connection, name, [delivery])
                for silence in silences:
                    if silence.begins is not None:
                        self.outbox.add(connection, SILENCES, [silence.begins])
                    self.outbox.end(connection, silence.ends)
                self.outbox.note_taken(connection, (*late, *new))
                self._pass(connection, taken)
            noted.known.update(taken.known)
            self._noted = noted
            for name in {name for name, _ in owed}:
                for worker in self.workers:
                    if worker.channel.name == name:
                        worker.wake()
            more = taken.more

    def _pass(self, connection: sa.Connection, taken: Taken) -> None:
        """Note in this transaction what is of before, and how far the arms' logs are taken."""
        self.outbox.note_before(connection, taken.before)
        self.outbox.note_known(connection, taken.known)
        self.source.commit(connection, taken.cursors)

    def _untold(self, arms: Mapping[ArmName, HeardArm], noted: Noted, now_unix_s: float) -> list[Transition]:
        """Alerts that arms say, that wait for a person, and of which their logs have said nothing for a while."""
        if not self.configuration.gateway.already_active:
            return []
        found = [active(arm, alert) for arm in arms.values() for alert in arm.waiting(now_unix_s)]
        found = [each for each in found if noted.new_to(each.place, each.after)]
        self._seen = {each.id: min(self._seen.get(each.id, now_unix_s), now_unix_s) for each in found}
        untold = [each for each in found if now_unix_s - self._seen[each.id] >= LOG_FIRST_S]
        for each in untold:
            noted.told(each.place, each.after, already=True)
        return untold

    def _heartbeat(self) -> None:
        self._heartbeat_at = time.monotonic()
        document = {
            "version": __version__,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "started_at_unix_s": self._began_unix_s,
            "channels": {
                each.channel.name: {
                    "trouble": each.trouble,
                    "trouble_since_unix_s": each.trouble_since_unix_s,
                    "next_try_unix_s": each.next_try_unix_s,
                    "status": self.configuration.scrub(each.channel.status()),
                }
                for each in self.workers
            },
        }
        set_note(self.database, RUNNING if self._owes else f"{RUNNING} {self.configuration.path}", self._now(), document)
        if time.monotonic() - self._pruned_at >= DAY_S:
            self.outbox.prune()
            self._pruned_at = time.monotonic()


def _made(make: Make, surroundings: Surroundings) -> Sequence[Channel]:
    """The channels. What is wrong with their settings is wrong with the configuration: starting again would change nothing."""
    try:
        return make(surroundings)
    except BadConfiguration:
        raise
    except BadInput as error:
        raise BadConfiguration(str(error)) from None


def _configured(configuration: GatewayConfiguration) -> Sequence[tuple[Make, bool]]:
    """How the channels are made, and whether they only show states."""

    def maker(kind_make: Callable[..., Sequence[Channel]], settings: object) -> Make:
        return lambda surroundings: kind_make(settings, surroundings)

    return [(maker(kind.make, configuration.sections[kind.section]), not kind.owes) for kind in configuration.kinds]


def serve(configuration: GatewayConfiguration) -> None:
    """Run until SIGTERM or SIGINT. Raises BadConfiguration, StoreError."""
    configuration.check_files()
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    configuration.expect_channel()
    with Gateway(configuration) as gateway:
        watchdog = Watchdog(gateway.heartbeats)
        line = StatusLine()
        while not stopping.wait(TICK_S):
            gateway.step()
            if gateway.trouble is None:
                gateway.start()
            watchdog.check()
            status = configuration.scrub(gateway.status())
            if line.say(status):
                log.info("running: %s", status)
        log.info("stopping")
        notify("STOPPING=1")
