"""Plays a trial: the daemon of `joint-monitor run`, with a clock that is handed in and replays that the simulator steps."""

import logging
import threading
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from monitor.acquire.schedule.windows import Window
from monitor.config.load import load
from monitor.errors import MonitorError
from monitor.recording import DAY_S
from monitor.service.run import Running, serve
from monitor.simulate.arm.physics import drive_gain
from monitor.studies.demo.world import free_host, free_port, simulated_arm, study_folder
from monitor.studies.trial.clock import TrialClock
from monitor.studies.trial.plan import Trial
from monitor.studies.trial.says import Says
from monitor.studies.trial.world import TrialArm, trial_file

STEP_S = 0.05  # between two looks at the clock: at 20 000 times the pace a quarter of an hour
STARTS_UNIX_S = 1_767_571_200.0  # Monday 2026-01-05 00:00 UTC, where scenarios begin too


def play(trial: Trial) -> None:
    """Run the trial until it is over, or until SIGINT or SIGTERM. Raises MonitorError where arm, bus or page cannot start."""
    with ExitStack() as stack:
        folder = study_folder(trial.keep, stack, "try")
        host = free_host()
        path = trial_file(folder, _document(trial), host, free_port(), free_port())
        configuration = load(path)
        says = Says(configuration, host, trial)
        robot = configuration.robot
        options = ("--robot", robot.model, "--scenario", trial.scenario, "--mounting", robot.mounting, "--payload", str(robot.payload_kg))
        remote = stack.enter_context(simulated_arm(host, trial.seed, *options))
        clock = TrialClock(STARTS_UNIX_S, trial.speed)
        arm = TrialArm(remote, clock)

        @contextmanager
        def running(service: Running) -> Iterator[None]:
            says.beginning()
            thread = threading.Thread(target=_advance, args=(trial, clock, arm, service, says), name="clock")
            thread.start()
            try:
                yield
            finally:
                service.daemon.state.stopping.set()
                thread.join()

        # what the log of a service would say of every window is printed here in one line
        logging.getLogger("monitor").setLevel(logging.ERROR)
        serve(configuration, clocks=clock.clocks, play=arm.play, running=running)
        says.end(kept=trial.keep is not None)


def _advance(trial: Trial, clock: TrialClock, arm: TrialArm, service: Running, says: Says) -> None:
    """Let time pass from window to window, and with it the arm; do declared work, say what happens; until the end of the days."""
    stopping = service.daemon.state.stopping
    end_unix_s = STARTS_UNIX_S + (trial.days * DAY_S if trial.days is not None else float("inf"))
    due: Window | None = None
    done = 0  # works that the simulated mechanic has carried out
    while not stopping.wait(STEP_S):
        try:
            if service.daemon.state.replaying.locked():  # also while it is judged: an alert has the time of its replay
                clock.stop_at(clock.now())
                continue
            if due is None or due.key_unix_s in service.store.ledger.windows(due.key_unix_s - 1.0, due.key_unix_s + 1.0):
                due = next(iter(service.scheduler.coming(1)), None)
            until = end_unix_s if due is None else min(due.opens_unix_s, end_unix_s)
            clock.stop_at(until)
            arm.follow()
            for act in service.store.maintenance.rows()[done:]:
                done += 1
                arm.repair(act.joint, str(act.document["kind"]))
            says.news(service, clock.now(), arm)
        except MonitorError as error:
            says.line(str(error))
            continue
        if clock.now() >= end_unix_s:
            stopping.set()
        elif clock.now() >= until:
            service.requests.wake()  # the scheduler looks once a second: hours of this clock


def _document(trial: Trial) -> dict[str, Any]:
    """The tables of the configuration that is tried."""
    if trial.config is None:
        document: dict[str, Any] = {"robot": {"model": trial.robot, "site": "try", "id": trial.robot}, "replay": {"repetitions": 1}}
    else:
        load(trial.config)  # a mistake is named with its line
        document = tomllib.loads(trial.config.read_text("utf-8-sig"))
        for table, key in (("replay", "excitation"), ("replay", "cell")):
            _absolute(document.get(table, {}), key, trial.config.parent)
    if not document["robot"].get("gains_nm_per_a"):
        from monitor.model.robot import load_robot

        document["robot"]["gains_nm_per_a"] = [round(value, 3) for value in drive_gain(load_robot(document["robot"]["model"])).tolist()]
    return document


def _absolute(table: dict[str, Any], key: str, beside: Path) -> None:
    if key in table and (beside / str(table[key])).is_file():
        table[key] = str((beside / table[key]).resolve())
