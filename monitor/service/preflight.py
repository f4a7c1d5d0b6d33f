"""Preflight: the conditions that the service itself needs, each by name: configuration, history, disk, clock, and the kernel's filter."""

import math
import os
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing, suppress
from pathlib import Path

from monitor.acquire.ending import AND_THEN
from monitor.acquire.safety.inputs import ConditionResult
from monitor.acquire.schedule.windows import HORIZONS_DAYS, Window, windows
from monitor.acquire.settings import ReplaySettings
from monitor.config.schema import Configuration
from monitor.errors import StoreError
from monitor.publish.timestamps import rfc3339
from monitor.reason import Sentence
from monitor.recording import DAY_S
from monitor.service.history.assess_and_store import misfit
from monitor.service.node import node_conditions
from monitor.store.archive.archive import Archive
from monitor.store.backup import HISTORY, backups, checked, connected, lost, made_at_unix_s, present
from monitor.store.disk import damaged, not_writable, refuse_network, refused_by
from monitor.store.history.database import version_of
from monitor.store.store import Store

BEFORE_THIS_PROGRAM_UNIX_S = 1_767_225_600.0  # 2026-01-01: an earlier clock is wrong, and the preflight check says so
RESTORES = "the next `joint-monitor run` restores"
CONFIGURATION_RIGHT = Sentence("configuration_right", "{path} is right")
OVERRIDDEN = Sentence("configuration_overridden", "the environment stands in for it: {keys}")
FLEET_PRIOR = Sentence("fleet_prior", "joints begin with the prior of a fleet of {arms} {model} ({digest})")
CANNOT_BE_MADE = Sentence("history_cannot_be_made", "{folder}: cannot be made: {parent} cannot be written to")
NOTHING_YET = Sentence("history_not_begun", "{folder}: nothing yet; the first run makes it")
HISTORY_LOST = Sentence("history_lost", "{path}: {why}; " + RESTORES + " what can be")
MISFIT = Sentence("history_misfit", "{path}: {why}")
NO_BACKUP, NEWEST_BACKUP = Sentence("no_backup_yet", "no backup yet"), Sentence("newest_backup", "the newest backup is of {at}")
SOUND = Sentence("history_sound", "sound, {windows} windows")
FREE = Sentence("disk_free", "{free_mb:.0f} MB are free in {folder}; replays want {least_mb:.0f} MB")
ARCHIVE_WAITS = Sentence("archive_waits", "{why}; recordings wait here until then, and replays go on")
ARCHIVE_ANSWERS = Sentence("archive_answers", "{address} answers")
ARCHIVE_HOLDS = Sentence("archive_holds", "{count} recordings are in it, {waiting} wait")
CLOCK_TOO_EARLY = Sentence("clock_too_early", "{now}: before this program existed")
CLOCK_BEHIND = Sentence("clock_behind_history", "{now}: the history knows of {known}; set the clock right")
SYNCHRONISED = Sentence("clock_synchronised", "{now}, synchronised")
NOT_SYNCHRONISED = Sentence("clock_not_synchronised", "{now}, not synchronised: drifting hours would shift the windows")
SYNCHRONISED_UNKNOWN = Sentence("clock_synchronised_unknown", "{now}; whether it is synchronised, nobody here says")
NO_WINDOWS = Sentence("schedule_without_windows", "neither cron nor every_h: replays are made where somebody or something asks for them")
NEVER_OPENS = Sentence("schedule_never_opens", "cron = {cron!r} names no time within {days} days: expected one that comes, e.g. 0 3 * * *")
NEVER_MEETS = Sentence(
    "schedule_never_meets",
    "no window of the schedule within {days} days lies in windows_utc ({windows}), e.g. not that of {first}: the arm would never move",
)
NEXT_WINDOW = Sentence("schedule_next_window", "the next window opens at {at}")
LOCK_NOT_TRIED = Sentence("socket_lock_not_tried", "it could not be tried: {why}")
LOCK_WORKS = Sentence("socket_lock_works", "the kernel lets the process that moves the arm forbid itself new connections")
LOCK_FAILS = Sentence("socket_lock_fails", "{why}: nothing moves without it; a systemd unit must permit the system call seccomp")
BOUND_TO = "SELECT json_extract(belief, '$.robot'), json_extract(belief, '$.reference_speed_rad_s') FROM state"


def service_conditions(configuration: Configuration, now_unix_s: float | None = None) -> tuple[ConditionResult, ...]:
    """All conditions of the service; checking them changes nothing."""
    now = time.time() if now_unix_s is None else now_unix_s
    return (
        _configuration(configuration),
        _history(configuration),
        _disk(configuration),
        _clock(configuration, now),
        _schedule(configuration, now),
        _socket_lock(configuration),
        *_archive(configuration),
        *node_conditions(configuration),
    )


def _configuration(configuration: Configuration) -> ConditionResult:
    prior = configuration.assess.drift.prior
    found = CONFIGURATION_RIGHT(path=str(configuration.path))
    if configuration.overrides:
        found = AND_THEN(first=found, then=OVERRIDDEN(keys=configuration.overrides))
    if prior is not None:
        found = AND_THEN(first=found, then=FLEET_PRIOR(arms=prior.arms, model=prior.model, digest=prior.digest))
    return ConditionResult(name="configuration", holds=True, reason=found)


def _history(configuration: Configuration) -> ConditionResult:
    directory = configuration.state_directory
    path = directory / HISTORY
    try:
        refuse_network(directory)
        is_there = present(directory)
    except StoreError as error:
        return ConditionResult(name="history", holds=False, reason=error.reason)
    if not is_there and (wrong := lost(directory)) is None:
        parent = next(folder for folder in (directory, *directory.parents) if os.access(folder, os.F_OK))
        if not os.access(parent, os.W_OK):
            return ConditionResult(name="history", holds=False, reason=CANNOT_BE_MADE(folder=str(directory), parent=str(parent)))
        return ConditionResult(name="history", holds=True, reason=NOTHING_YET(folder=str(directory)))
    if not is_there:
        return ConditionResult(name="history", holds=False, reason=HISTORY_LOST(path=str(path), why=wrong))
    try:
        with closing(connected(path, "ro")) as connection:
            wrong = checked(connection, path)
            version = version_of(connection, directory)
            rows = connection.execute("SELECT count(*) FROM ledger").fetchone()[0] if version else 0
            bound = connection.execute(BOUND_TO).fetchone() if version else None
    except StoreError as error:
        return ConditionResult(name="history", holds=False, reason=error.reason)
    except sqlite3.Error as error:
        return ConditionResult(name="history", holds=False, reason=refused_by(error, path).reason)
    if wrong is not None:
        return ConditionResult(name="history", holds=False, reason=damaged(path, wrong))
    if (refused := not_writable(path)) is not None:
        return ConditionResult(name="history", holds=False, reason=refused.reason)
    if bound is not None and (why := misfit(configuration, *bound)) is not None:
        return ConditionResult(name="history", holds=False, reason=MISFIT(path=str(path), why=why))
    newest = next(iter(backups(directory)), None)
    backup = NO_BACKUP() if newest is None else NEWEST_BACKUP(at=rfc3339(made_at_unix_s(newest)))
    return ConditionResult(name="history", holds=True, reason=AND_THEN(first=SOUND(windows=rows), then=backup))


def _disk(configuration: Configuration) -> ConditionResult:
    directory = configuration.state_directory
    folder = next(each for each in (directory, *directory.parents) if os.access(each, os.F_OK))
    free_mb = shutil.disk_usage(folder).free / 1e6
    least_mb = configuration.store.least_free_mb
    return ConditionResult(name="disk", holds=free_mb >= least_mb, reason=FREE(free_mb=free_mb, folder=str(folder), least_mb=least_mb))


def _archive(configuration: Configuration) -> tuple[ConditionResult, ...]:
    """Whether the archive of recordings is there and lets us in; nothing where none is configured."""
    settings = configuration.archive
    if settings is None:
        return ()
    try:
        Archive.open(settings).look()
    except StoreError as error:
        return (ConditionResult(name="archive", holds=False, reason=ARCHIVE_WAITS(why=error.reason)),)
    found = ARCHIVE_ANSWERS(address=settings.address)
    with suppress(StoreError):  # the condition `history` says why
        if present(configuration.state_directory):
            with Store.reader(configuration.state_directory) as store:
                found = AND_THEN(first=found, then=ARCHIVE_HOLDS(count=store.archived.count(), waiting=store.archived.waits()[0]))
    return (ConditionResult(name="archive", holds=True, reason=found),)


def _clock(configuration: Configuration, now: float) -> ConditionResult:
    if now < BEFORE_THIS_PROGRAM_UNIX_S:
        return ConditionResult(name="clock", holds=False, reason=CLOCK_TOO_EARLY(now=rfc3339(now)))
    newest = _newest(configuration.state_directory / HISTORY)
    if newest is not None and newest > now + 3600.0:
        return ConditionResult(name="clock", holds=False, reason=CLOCK_BEHIND(now=rfc3339(now), known=rfc3339(newest)))
    synchronised = _synchronised()
    sentence = {True: SYNCHRONISED, False: NOT_SYNCHRONISED, None: SYNCHRONISED_UNKNOWN}[synchronised]
    return ConditionResult(name="clock", holds=True, reason=sentence(now=rfc3339(now)), checked=synchronised is True)


def _schedule(configuration: Configuration, now: float) -> ConditionResult:
    """Whether the clock opens windows within the days that are searched, and the arm may move in one of them."""
    settings, replay = configuration.schedule, configuration.replay
    if not settings.cron.strip() and not settings.every_h:
        return ConditionResult(name="schedule", holds=True, reason=NO_WINDOWS())
    found: list[Window] = []
    for days in HORIZONS_DAYS:  # a dense schedule has half a million windows in the last of them
        found = windows(settings, now, now + days * DAY_S, None, configuration.key_prefix)
        allowed = next((each for each in found if _may_move(replay, each)), None)
        if allowed is not None:
            return ConditionResult(name="schedule", holds=True, reason=NEXT_WINDOW(at=rfc3339(allowed.opens_unix_s)))
    if not found:
        return ConditionResult(name="schedule", holds=False, reason=NEVER_OPENS(cron=settings.cron, days=HORIZONS_DAYS[-1]))
    spans, first = ", ".join(replay.windows_utc), rfc3339(found[0].opens_unix_s)
    return ConditionResult(name="schedule", holds=False, reason=NEVER_MEETS(windows=spans, first=first, days=HORIZONS_DAYS[-1]))


def _may_move(replay: ReplaySettings, window: Window) -> bool:
    """Whether the arm may move at some minute of a window."""
    minutes = range(int(window.opens_unix_s), math.ceil(window.closes_unix_s), 60)
    return any(replay.minutes_left(at) is not None for at in minutes)


SOCKET_LOCK = "from monitor.acquire.driver import usual_driver; print(usual_driver().lock_sockets() or '')"
SOCKET_LOCK_S = 10.0  # for a process that starts, tries it and ends


def _socket_lock(configuration: Configuration) -> ConditionResult:
    """Whether the process that moves an arm could forbid itself new connections. Another process tries it: it cannot be undone."""
    name = "socket_lock"
    try:
        tried = subprocess.run([sys.executable, "-c", SOCKET_LOCK], capture_output=True, text=True, timeout=SOCKET_LOCK_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return ConditionResult(name=name, holds=True, reason=LOCK_NOT_TRIED(why=str(error)), checked=False)
    why = tried.stdout.strip() if tried.returncode == 0 else f"the process that tried ended with {tried.returncode}"
    if not why:
        return ConditionResult(name=name, holds=True, reason=LOCK_WORKS())
    return ConditionResult(name=name, holds=configuration.replay.allow_motion is not True, reason=LOCK_FAILS(why=why))


def _newest(path: Path) -> float | None:
    try:
        with closing(connected(path, "ro")) as connection:
            ((at,),) = connection.execute("SELECT max(started_at_unix_s) FROM ledger").fetchall()
    except sqlite3.Error:
        return None
    return None if at is None else float(at)


def _synchronised() -> bool | None:
    """Whether systemd reports the host's clock as synchronised; None where there is no systemd."""
    command = ["timedatectl", "show", "--property=NTPSynchronized", "--value"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return {"yes": True, "no": False}.get(result.stdout.strip())
