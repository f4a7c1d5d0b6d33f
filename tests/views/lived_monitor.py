"""A monitor with a history: one identified replay of the simulator, repeated for many days with temperature, wear and noise added.

`python lived_monitor.py DIRECTORY [PORT]` serves its page until Enter is pressed.
"""

import itertools
import json
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from monitor.config.files import find_excitation
from monitor.config.load import from_document
from monitor.errors import DOES_NOT_HOLD
from monitor.identify.identify import identify
from monitor.judge.alerts.health import alert_document
from monitor.judge.assess import judge_identification
from monitor.judge.document import plain
from monitor.judge.torque.predictor import predict_torque
from monitor.model.robot import Mounting, load_robot
from monitor.service.daemon import Daemon
from monitor.service.page import page
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.store import Store

DAY_S = 86_400.0
FIRST_UNIX_S = 1_780_282_800.0  # Monday 2026-06-01 03:00 UTC
WEARING, ONSET, PER_DAY = 3, 20, 0.012  # joint that wears, day of the onset, growth of its friction a day
COLD = {12: -8.0, 33: -9.0}  # day → change of temperature [K]


def configuration(directory, listen="127.0.0.1:0", **page_settings):
    document = {
        "robot": {"model": "ur5", "site": "hall-2", "id": "cell-1", "payload_kg": 1.2, "tool": "gripper"},
        "store": {"directory": "history"},
        "bus": {"listen": ["tcp/127.0.0.110:0"]},
        "page": {"listen": listen, **page_settings},
    }
    return from_document(document, Path(directory) / "cell.toml")


@lru_cache
def identified(seed=0):
    """One identification and its context, shared by all tests of a process; nothing changes it."""
    excitation = replace(find_excitation("ur5-ground", Path()), repetitions=1)
    recording = stepped_replay(Controller(SimulateSettings(robot="ur5", seed=seed)), excitation)
    return identify([recording], load_robot("ur5"), Mounting(), method="wls"), recording.context


def live_through(store, settings, found, context, days, seed=0):
    """Fill the store with so many days, one replay each, assessed as the daemon assesses it; the windows of days 9 and 25 are skipped."""
    life = _life(settings, found, context, seed)
    for day in range(days):
        at = FIRST_UNIX_S + day * DAY_S
        ledger = store.ledger.claim(at, "scheduled", at)
        assessed = life.day(day)
        if assessed is None:
            store.ledger.end(ledger, "skipped", DOES_NOT_HOLD(condition="permit", why="the cell's door is open"), at)
            continue
        store.ledger.mark_recorded(ledger)
        for event in store.assessments.commit(ledger, at_unix_s=at + 60.0, recorded_at_unix_s=at + 40.0, **assessed):
            store.events.mark_published(event.seq)


class _Life:
    """What is stored of an arm's days. It is judged once a process, however many stores begin with it."""

    def __init__(self, settings, found, context, seed):
        self.of = (settings, context, seed)
        self.found = found
        self._known = []
        self._days = _judged(settings, found, context, seed)

    def day(self, number):
        while len(self._known) <= number:
            self._known.append(next(self._days))
        return self._known[number]


_LIVES = []


def _life(settings, found, context, seed):
    for life in _LIVES:
        if life.found is found and life.of == (settings, context, seed):
            return life
    _LIVES.append(_Life(settings, found, context, seed))
    return _LIVES[-1]


def _judged(settings, found, context, seed):
    """What each day's replay leaves in a store; None where the window was skipped."""
    rng = np.random.default_rng(seed)
    belief = health = None
    fall = np.array([0.013, 0.016, 0.014, 0.019, 0.018, 0.015])
    level = found.temperature_c
    for day in itertools.count():
        if day in {9, 25}:
            yield None
            continue
        warm = 5.0 + 3.0 * np.sin(day / 5.0) + COLD.get(day, 0.0) + rng.normal(0.0, 0.5, 6)
        worn = np.ones(6)
        worn[WEARING - 1] += PER_DAY * max(day - ONSET, 0)
        wobble = np.exp(rng.normal(0.0, 0.006, 6))
        today = replace(
            found,
            coulomb_nm=found.coulomb_nm * worn * wobble * (1 - 0.001 * warm),
            viscous_nm_s_per_rad=found.viscous_nm_s_per_rad * worn * wobble * np.exp(-fall * warm),
            temperature_c=level + warm,
        )
        now = replace(context, recorded_at_unix_s=FIRST_UNIX_S + day * DAY_S + 40.0)
        outcome = judge_identification(today, now, belief=belief, health=health, settings=settings, source=f"replay-{day + 1}")
        belief, health = outcome.belief, outcome.health
        yield {
            "assessment": outcome.as_document(),
            "friction": [plain(joint) for joint in outcome.friction],
            "belief": belief.as_document(),
            "health": health.as_document(),
            "model": outcome.model.as_document(),
            "events": [{"kind": transition.kind, **alert_document(transition.alert)} for transition in outcome.transitions],
        }


def grow(store, replays):
    """Add many replays to the history, copies of the last one: for tests of speed, which do not read the figures."""
    last = store.assessments.replays()[-1]
    rows = [(joint, json.dumps(one)) for _, joint, _, one in store.assessments.friction_of([last])]
    with store.database.transaction() as db:
        for k in range(1, replays + 1):
            at = FIRST_UNIX_S - k * DAY_S / 4
            number = last + k
            db.execute(
                "INSERT INTO ledger (id, window_unix_s, kind, state, started_at_unix_s, ended_at_unix_s) "
                "VALUES (?, ?, 'scheduled', 'assessed', ?, ?)",
                (number, at, at, at + 60),
            )
            db.execute("INSERT INTO assessment (ledger_id, recorded_at_unix_s, document) VALUES (?, ?, '{}')", (number, at))
            db.executemany("INSERT INTO friction VALUES (?, ?, ?, ?)", [(number, joint, at, text) for joint, text in rows])


def no_arm(excitation, context, should_stop, window):
    """A replay that must not be played."""
    raise AssertionError("nothing moves here")


@contextmanager
def monitor(directory, days=45, settings=None, moving=True, before=None, later_days=0):
    """A daemon and its page; yields page server, daemon and store. `later_days` is how long ago the last replay was."""
    settings = settings or configuration(directory)
    with ExitStack() as stack:
        store = stack.enter_context(Store.open(settings.state_directory))
        if days and store.assessments.state() is None:
            found, context = identified()
            live_through(store, settings.assess, found, replace(settings.context, firmware=context.firmware), days)
        if before is not None:
            before(store)
        clock = [FIRST_UNIX_S + (max(days, 1) + later_days) * DAY_S]
        daemon = stack.enter_context(Daemon(settings, store, now=lambda: clock[0], play=no_arm))
        daemon.monitor.next_due(clock[0] + DAY_S)
        served = stack.enter_context(page(settings, daemon.bus, store, now=lambda: clock[0]))
        if moving:
            done = threading.Event()
            arm = threading.Thread(target=_move, args=(daemon, clock, done))
            arm.start()
            stack.callback(arm.join)
            stack.callback(done.set)
        yield served, daemon, store


def _move(daemon, clock, done):
    """Feed the daemon with an arm at work, as the listener would."""
    excitation = daemon.state.configuration.excitation
    gains = load_robot("ur5").drive_gain_nm_per_a
    rng = np.random.default_rng(1)
    began = time.monotonic()
    while not done.wait(0.2):
        t = time.monotonic() - began
        clock[0] += 0.2
        q, qd, qdd = (row[0] for row in excitation.at(np.array([t % excitation.period_s])))
        temperature = np.array([28.0, 28.5, 29.0, 30.0, 29.5, 30.5])
        if daemon.state.torque_model is None:
            continue
        torque = predict_torque(daemon.state.torque_model, load_robot("ur5"), q[None], qd[None], qdd[None], temperature[None]).torque[0]
        daemon.live.sample(q, qd, qdd, (torque + rng.normal(0.0, 0.3, 6)) / gains, temperature)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    with monitor(folder, settings=configuration(folder, f"127.0.0.1:{sys.argv[2] if len(sys.argv) > 2 else 0}")) as (server, _, _):
        print(server.url, flush=True)
        sys.stdin.readline()
