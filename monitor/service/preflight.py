"""Preflight: the conditions that the service itself needs, each by name: configuration, history, disk, clock, and the kernel's filter."""

import os
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

from monitor.acquire.safety.inputs import ConditionResult
from monitor.config.schema import Configuration
from monitor.errors import StoreError
from monitor.publish.timestamps import rfc3339
from monitor.service.node import node_conditions
from monitor.store.archive.archive import Archive
from monitor.store.backup import HISTORY, backups, connected, lost, made_at_unix_s, present
from monitor.store.history.database import version_of
from monitor.store.store import Store

BEFORE_THIS_PROGRAM_UNIX_S = 1_767_225_600.0  # 2026-01-01: an earlier clock is wrong, and the preflight check says so
BOUND_TO = "SELECT json_extract(belief, '$.robot'), json_extract(belief, '$.reference_speed_rad_s') FROM state"


def service_conditions(configuration: Configuration, now_unix_s: float | None = None) -> tuple[ConditionResult, ...]:
    """All conditions of the service; checking them changes nothing."""
    now = time.time() if now_unix_s is None else now_unix_s
    return (
        _configuration(configuration),
        _history(configuration),
        _disk(configuration),
        _clock(configuration, now),
        _socket_lock(configuration),
        *_archive(configuration),
        *node_conditions(configuration),
    )


def _configuration(configuration: Configuration) -> ConditionResult:
    overrides = ", ".join(configuration.overrides)
    text = f"{configuration.path} is right" + (f"; the environment stands in for it: {overrides}" if overrides else "")
    prior = configuration.assess.drift.prior
    told = [] if prior is None else [f"joints begin with the prior of a fleet of {prior.arms} {prior.model} ({prior.digest})"]
    text = "; ".join([text, *told])
    return ConditionResult(name="configuration", holds=True, text=text)


def _history(configuration: Configuration) -> ConditionResult:
    directory = configuration.state_directory
    path = directory / HISTORY
    try:
        is_there = present(directory)
    except StoreError as error:
        return ConditionResult(name="history", holds=False, text=str(error))
    if not is_there and (wrong := lost(directory)) is None:
        parent = next(folder for folder in (directory, *directory.parents) if os.access(folder, os.F_OK))
        if not os.access(parent, os.W_OK):
            return ConditionResult(name="history", holds=False, text=f"{directory}: cannot be made: {parent} cannot be written to")
        return ConditionResult(name="history", holds=True, text=f"{directory}: nothing yet; the first run makes it")
    if not is_there:
        return ConditionResult(name="history", holds=False, text=f"{path}: {wrong}; the next `joint-monitor run` restores what can be")
    try:
        with closing(connected(path, "ro")) as connection:
            result = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
            version = version_of(connection, directory)
            rows = connection.execute("SELECT count(*) FROM ledger").fetchone()[0] if version else 0
            bound = connection.execute(BOUND_TO).fetchone() if version else None
    except StoreError as error:
        return ConditionResult(name="history", holds=False, text=str(error))
    except sqlite3.Error as error:
        return ConditionResult(
            name="history", holds=False, text=f"{path}: {error}; the next `joint-monitor run` restores the newest good backup"
        )
    if result != "ok":
        return ConditionResult(
            name="history", holds=False, text=f"{path}: damaged ({result}); the next run restores the newest good backup"
        )
    if not os.access(path, os.W_OK) or not os.access(directory, os.W_OK):
        return ConditionResult(name="history", holds=False, text=f"{path}: cannot be written by this user")
    if bound is not None and (why := misfit(configuration, *bound)) is not None:
        return ConditionResult(name="history", holds=False, text=f"{path}: {why}")
    newest = next(iter(backups(directory)), None)
    backup = f"the newest backup is of {rfc3339(made_at_unix_s(newest))}" if newest else "no backup yet"
    return ConditionResult(name="history", holds=True, text=f"sound, {rows} windows; {backup}")


def misfit(configuration: Configuration, model: str | None, speed_rad_s: float | None) -> str | None:
    """Why a history of this model and reference speed cannot be continued with this configuration; None where it can."""
    robot, speed = configuration.robot_description.name, configuration.assess.drift.reference_speed_rad_s
    other = "or begin a new history with another [store] directory"
    if model is not None and model != robot:
        return f"it is of a {model}, robot.model is {robot}: every replay would be rejected; set robot.model back, {other}"
    if speed_rad_s is not None and speed_rad_s != speed:
        why = f"its friction refers to {speed_rad_s:g} rad/s, drift.reference_speed_rad_s is {speed:g}: every replay would be rejected"
        return f"{why}; set it back to {speed_rad_s:g}, {other}"
    return None


def _disk(configuration: Configuration) -> ConditionResult:
    directory = configuration.state_directory
    folder = next(each for each in (directory, *directory.parents) if os.access(each, os.F_OK))
    free_mb = shutil.disk_usage(folder).free / 1e6
    least_mb = configuration.store.least_free_mb
    text = f"{free_mb:.0f} MB are free in {folder}; replays want {least_mb:.0f} MB"
    return ConditionResult(name="disk", holds=free_mb >= least_mb, text=text)


def _archive(configuration: Configuration) -> tuple[ConditionResult, ...]:
    """Whether the archive of recordings is there and lets us in; nothing where none is configured."""
    settings = configuration.archive
    if settings is None:
        return ()
    try:
        Archive.open(settings).look()
    except StoreError as error:
        return (ConditionResult(name="archive", holds=False, text=f"{error}; recordings wait here until then, and replays go on"),)
    text = f"{settings.address} answers"
    try:
        if present(configuration.state_directory):
            with Store.reader(configuration.state_directory) as store:
                text += f"; {store.archived.count()} recordings are in it, {store.archived.waits()[0]} wait"
    except StoreError:
        pass  # the condition `history` says why
    return (ConditionResult(name="archive", holds=True, text=text),)


def _clock(configuration: Configuration, now: float) -> ConditionResult:
    if now < BEFORE_THIS_PROGRAM_UNIX_S:
        return ConditionResult(name="clock", holds=False, text=f"{rfc3339(now)}: before this program existed")
    newest = _newest(configuration.state_directory / HISTORY)
    if newest is not None and newest > now + 3600.0:
        return ConditionResult(
            name="clock", holds=False, text=f"{rfc3339(now)}: the history knows of {rfc3339(newest)}; set the clock right"
        )
    synchronised = _synchronised()
    if synchronised is None:
        return ConditionResult(
            name="clock", holds=True, text=f"{rfc3339(now)}; whether it is synchronised, nobody here says", checked=False
        )
    words = "synchronised" if synchronised else "not synchronised: drifting hours would shift the windows"
    return ConditionResult(name="clock", holds=True, text=f"{rfc3339(now)}, {words}", checked=synchronised)


SOCKET_LOCK = "from monitor.acquire.driver import usual_driver; print(usual_driver().lock_sockets() or '')"
SOCKET_LOCK_S = 10.0  # for a process that starts, tries it and ends


def _socket_lock(configuration: Configuration) -> ConditionResult:
    """Whether the process that moves an arm could forbid itself new connections. Another process tries it: it cannot be undone."""
    name = "socket_lock"
    try:
        tried = subprocess.run([sys.executable, "-c", SOCKET_LOCK], capture_output=True, text=True, timeout=SOCKET_LOCK_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return ConditionResult(name=name, holds=True, text=f"it could not be tried: {error}", checked=False)
    why = tried.stdout.strip() if tried.returncode == 0 else f"the process that tried ended with {tried.returncode}"
    if not why:
        return ConditionResult(name=name, holds=True, text="the kernel lets the process that moves the arm forbid itself new connections")
    text = f"{why}: nothing moves without it; a systemd unit must permit the system call seccomp"
    return ConditionResult(name=name, holds=configuration.replay.allow_motion is not True, text=text)


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
