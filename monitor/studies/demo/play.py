"""Plays the demo: a simulated arm, a real daemon, four weeks, a verdict.

Real are the controller's wire and the unmodified ur-rtde (a process each), the daemon with its store and its assessment, and Zenoh over
TCP. Two things are handed in: the daemon's clock, and for the days between the live replays a replay that the simulator steps faster than
real time with the same physics.
"""

import json
import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console

from monitor.acquire.listen import Listener, ListenSettings
from monitor.errors import MonitorError
from monitor.publish.client import Client
from monitor.publish.timestamps import rfc3339
from monitor.service.daemon import Daemon
from monitor.service.live import LiveFeed
from monitor.service.page import page
from monitor.simulate.remote import Remote
from monitor.store.store import Store
from monitor.studies.demo.display import Received, Screen, Summary, Ticker, busy_text, query_torque, receive
from monitor.studies.demo.world import (
    DAYS,
    LIVE_DAYS,
    ROBOT_ID,
    SITE,
    DemoReplay,
    DemoState,
    demo_configuration,
    free_host,
    free_port,
    pass_day,
    simulated_arm,
    study_folder,
    true_friction_nm,
)

PLAIN_WIDTH = 120  # characters, where standard output is no terminal
PATIENCE_S = 60.0  # for an answer on the bus: a busy machine gives no processor time for many seconds
SETTLE_S = 0.05  # after a replay: its documents arrive before the screen shows them


def play(*, ticker: Ticker, seed: int = 0, keep: Path | None = None, as_json: bool = False) -> int:
    """Run the demo and print its verdict.

    ticker : says what is done while nothing else is printed. seed : of the simulated arm. keep : a folder for the history; without it a
    temporary one, removed at the end. as_json : print one JSON
    object on standard output and everything else on standard error. Returns 0 where the wear alert came for the right joint and for no
    other, else 1. An error that ends it says how busy this machine is.
    """
    began = time.monotonic()
    logging.getLogger("monitor").addHandler(logging.NullHandler())  # what the daemon logs is on the screen in words
    console = Console(stderr=as_json, width=None if sys.stdout.isatty() else PLAIN_WIDTH)
    state, received = DemoState(), Received()
    ticker.activity = lambda: state.activity
    with ExitStack() as stack, _busy_machine_named(console):
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        configuration = demo_configuration(study_folder(keep, stack, "demo"), free_host(), endpoint)
        remote = stack.enter_context(simulated_arm(configuration.robot.host, seed))
        store = stack.enter_context(Store.open(configuration.state_directory))
        replay = DemoReplay(configuration, remote, state)
        daemon = stack.enter_context(Daemon(configuration, store, now=lambda: state.clock_unix_s, play=replay))
        served = stack.enter_context(page(configuration, daemon.bus, store, now=lambda: state.clock_unix_s))
        assert served is not None  # the configuration names an address
        console.print(f"status page while it runs: {served.url}", highlight=False)
        ticker.spoke()
        client = stack.enter_context(Client(endpoint, SITE, ROBOT_ID, timeout_s=PATIENCE_S))
        done = threading.Event()
        for name, work in (
            ("watcher", lambda: receive(client, received, done)),
            ("listener", lambda: _listen(daemon, configuration.robot.host, done)),
        ):
            thread = threading.Thread(target=work, name=name)
            thread.start()
            stack.callback(thread.join)
        stack.callback(done.set)  # runs before the joins
        with Screen(console, state, received, ticker) as screen:
            _four_weeks(daemon, remote, state, screen)
            state.activity = "a cold evening: asking the model for torque at temperatures between those of the replays"
            torque = query_torque(client, remote, configuration)
            state.activity = "closing the daemon and the simulated arm"
    summary = Summary(state=state, received=received, torque=torque, took_s=time.monotonic() - began)
    if as_json:
        print(json.dumps(summary.as_document(), ensure_ascii=False, allow_nan=False))  # noqa: T201
    else:
        summary.print(console)
    return 1 if summary.problems else 0


@contextmanager
def _busy_machine_named(console: Console) -> Iterator[None]:
    """An error on a busy machine is said to be one: nothing here depends on time but that everything answers in time."""
    try:
        yield
    except MonitorError:
        if (busy := busy_text()) is not None:
            console.print(f"the demo ends early: {busy}", style="bold red")
        raise


def _four_weeks(daemon: Daemon, remote: Remote, state: DemoState, screen: Screen) -> None:
    """DAYS times: a day passes in the simulator, and the daemon performs one window."""
    healthy_nm = true_friction_nm(remote)
    for day in range(DAYS):
        pass_day(remote, state, day)
        row = daemon.monitor.perform(state.clock_unix_s)
        assert row is not None  # every day is a new window
        live = day in LIVE_DAYS and day not in state.not_live
        state.live_replays += live
        state.stepped_replays += not live
        if row.state != "assessed":
            state.failed.append(f"day {day + 1} {row.state}: {row.reason}")
        state.true_wear = true_friction_nm(remote) / healthy_nm - 1.0
        how = "RTDE, real time" if live else "stepped"
        state.replays.append(f"{rfc3339(state.clock_unix_s)[:10]}  {how:<15}  {row.state}{f': {row.reason}' if row.reason else ''}")
        time.sleep(SETTLE_S)
        screen.replay_done()


def _listen(daemon: Daemon, host: str, done: threading.Event) -> None:
    """Compare live torque while the arm stands and while it moves, as the service does, until `done` is set."""
    listener = Listener(ListenSettings(host=host, rate_hz=daemon.live.rate_hz))
    feed = LiveFeed(daemon.live, daemon.bus, listener)
    listener.start()
    try:
        while not feed.wait(done):
            feed.step()
    finally:
        listener.stop()
