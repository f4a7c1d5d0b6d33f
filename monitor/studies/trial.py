"""What a trial plays."""

import dataclasses
import logging
import shlex
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import typer

from monitor.acquire.schedule.windows import Window
from monitor.config.first_file import toml_text
from monitor.config.load import load
from monitor.config.schema import Configuration
from monitor.errors import BadInput, MonitorError
from monitor.model.fourier import Excitation
from monitor.reason import joint_name
from monitor.recording import DAY_S, Context, Recording
from monitor.service.motion import ReplayWindow
from monitor.service.replay import Replay
from monitor.service.run import Running, serve
from monitor.service.scheduler import Clocks
from monitor.simulate.arm.physics import drive_gain
from monitor.simulate.machine.state import RobotMode, SafetyMode
from monitor.simulate.remote import Remote
from monitor.studies.demo.world import free_host, free_port, known_facts, simulated_arm, study_folder


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What is tried."""

    robot: str
    scenario: str
    speed: float
    days: float | None  # ends after so many; None: when a person says so
    seed: int
    keep: Path | None  # folder of history and configuration; None: a temporary one
    config: Path | None  # a configuration of the person's own


# --- The clock of a trial: UTC that runs faster than the host's, waits at each window, and stands while the arm moves ---


class TrialClock:
    """Time that passes `speed` times as fast as the host's, but never beyond `stop_at` and never while somebody holds it."""

    def __init__(self, start_unix_s: float, speed: float, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._lock = threading.Lock()
        self._monotonic, self._speed = monotonic, speed
        self._begin_unix_s = self._unix_s = start_unix_s
        self._since = monotonic()
        self._held = 0
        self._stop_at_unix_s = start_unix_s  # nothing passes before somebody says until when

    def now(self) -> float:
        """UTC [s since 1970]."""
        with self._lock:
            self._pass()
            return self._unix_s

    def monotonic(self) -> float:
        """Seconds since the trial began; nobody sets them."""
        return self.now() - self._begin_unix_s

    def stop_at(self, unix_s: float) -> None:
        """Let time pass up to this moment, and wait there."""
        with self._lock:
            self._pass()
            self._stop_at_unix_s = unix_s

    def add(self, seconds: float) -> None:
        """Let so much pass at once, also while the clock is held: a motion that was computed has lasted so long."""
        with self._lock:
            self._pass()
            self._unix_s += seconds

    @contextmanager
    def held(self) -> Iterator[None]:
        """The clock stands while the context lasts."""
        with self._lock:
            self._pass()
            self._held += 1
        try:
            yield
        finally:
            with self._lock:
                self._pass()
                self._held -= 1

    @property
    def clocks(self) -> Clocks:
        """Both clocks as the scheduler takes them."""
        return Clocks(now=self.now, monotonic=self.monotonic)

    def _pass(self) -> None:
        now = self._monotonic()
        passed_s, self._since = (now - self._since) * self._speed, now
        if not self._held:
            self._unix_s = max(self._unix_s, min(self._unix_s + passed_s, self._stop_at_unix_s))


# --- What a trial prints: how to play with it, a line for each replay, a line for each change of an alert ---


class Obstructed(Protocol):
    """The simulated arm, as far as this module needs it."""

    @property
    def obstacle(self) -> str:
        """Why it does not age; empty where it does."""
        ...


class Says:
    """Prints what is new since the last call. One thread calls it."""

    def __init__(self, configuration: Configuration, host: str, trial: Trial) -> None:
        self._configuration, self._host, self._trial = configuration, host, trial
        self._replay = self._event = 0
        self._obstacle = ""

    def line(self, text: str) -> None:
        """One line, at once."""
        typer.echo(text)

    def beginning(self) -> None:
        """What runs, and what a person can do with it from another terminal."""
        configuration, path = self._configuration, shlex.quote(str(self._configuration.path))
        day_s = 86_400.0 / self._trial.speed
        self.line(
            f"a simulated {configuration.robot.model}, scenario {self._trial.scenario}, {self._trial.speed:g} times as fast as life: "
            f"a day in {day_s:.1f} s, and the time of its replay"
        )
        self.line(
            "replays are stepped by the simulated arm, and over RTDE in real time while something is broken; all that is judged and told "
            "is the daemon's own"
        )
        for what, command in (
            ("the status page", f"http://{configuration.page.listen}/"),
            ("what is known", f"joint-monitor status --config {path}"),
            ("alerts, and what they ask", f"joint-monitor alerts --config {path}"),
            ("somebody has seen one", f"joint-monitor ack --config {path} j3/wear_rising --by you"),
            ("a mechanic works on it", f"joint-monitor serviced --config {path} --joint 3 --replaced --by you --why worn"),
            ("something breaks", f"joint-monitor simulate --bind {self._host} --fault 'protective_stop'"),
            ("it is mended", f"joint-monitor simulate --bind {self._host} --fault recover"),
            ("somebody has looked", f"joint-monitor allow --config {path} --by you --why 'nothing was hit'"),
        ):
            self.line(f"  {what:<26} {command}")
        self.line("Ctrl-C ends it\n")

    def news(self, service: Running, now_unix_s: float, arm: Obstructed) -> None:
        """Replays that have ended and alerts that have changed since the last call. Raises StoreError."""
        if arm.obstacle and arm.obstacle != self._obstacle:
            self.line(f"{_date(now_unix_s)}  the arm does not work: {arm.obstacle}")
        self._obstacle = arm.obstacle
        newest = service.store.ledger.rows(limit=5)
        for row in newest:
            if row.id > self._replay and row.ended_at_unix_s is not None:
                self._replay = row.id
                self.line(f"{_date(row.window_unix_s)}  {row.state}{f': {row.reason}' if row.reason else self._worst(service)}")
        for event in service.store.events.rows(after=self._event):
            self._event = event.seq
            self.line(f"{_date(event.at_unix_s)}  {_event(event.document)}")

    def end(self, *, kept: bool) -> None:
        """Where the history is, where it stays."""
        if kept:
            path = shlex.quote(str(self._configuration.path))
            self.line(f"the history stays: joint-monitor report --config {path} -o report.html")

    def _worst(self, service: Running) -> str:
        """The joint that has changed most, by the newest estimates."""
        rows = service.store.assessments.friction(limit=self._configuration.robot_description.joints)
        if not rows:
            return ""
        worst: dict[str, Any] = max(rows, key=lambda row: abs(row["wear"]))
        return f"  {joint_name(worst['joint'])} {100 * worst['wear']:+z.1f} ± {100 * worst['wear_std']:.1f} %"


def _event(document: dict[str, Any]) -> str:
    """One change of an alert as a line."""
    where = "arm" if document.get("joint") is None else f"j{document['joint']}"
    kind = str(document.get("event") or document.get("kind") or "changed")
    text = str(document.get("text")).split("; ")[0]  # `alerts` has the whole of it
    return f"ALERT {where}/{document.get('condition')} {document.get('tier')} {kind}: {text}"


def _date(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).strftime("%a %Y-%m-%d %H:%M")


# --- The world of a trial: a simulated arm that ages with the clock, and a configuration that a person's commands can read ---

HOUR_S = 3600.0
TAKEN_AWAY = {"replaced": 1.0, "overhauled": 0.95, "greased": 0.8}  # share of a joint's wear, by the kind of work
LEAST_STEP_S = 300.0  # heat and wear change little within five minutes


class TrialArm:
    """A simulated arm that is as old as the clock says. Its methods may be called from any thread."""

    def __init__(self, remote: Remote, clock: TrialClock) -> None:
        self._remote, self._clock = remote, clock
        self._lock = threading.Lock()
        self._unix_s = clock.now()
        self.obstacle = ""  # why the arm does not age: a protective stop, a program of somebody else

    def follow(self, least_s: float = LEAST_STEP_S) -> None:
        """Let pass for the arm what has passed by the clock: heat, wear, and the events of its scenario."""
        with self._lock:
            passed_s = self._clock.now() - self._unix_s
            if passed_s < least_s:
                return
            try:
                self._remote.advance(hours=passed_s / HOUR_S)
            except BadInput as error:
                self.obstacle = str(error)
                return
            self._unix_s += passed_s
            self.obstacle = ""

    def replays(self, over_rtde: Replay) -> Replay:
        """How a recording is made: stepped by the simulator's physics in a fraction of its time while the arm is sound.

        Where somebody has made a fault, or the arm is not ready, it is made over RTDE in real time, and ends as on a real arm. The clock
        stands meanwhile, then it is as much later.
        """

        def play(excitation: Excitation, context: Context, should_stop: Callable[[], bool], window: ReplayWindow, /) -> Recording:
            with self._clock.held():
                self.follow(0.0)
                with self._lock:
                    recording = self._stepped(excitation, context)
                if recording is None:
                    recording = over_rtde(excitation, context, should_stop, window)
                with self._lock:
                    self._clock.add(recording.duration_s)
                    self._unix_s += recording.duration_s
            return recording

        return play

    def _stepped(self, excitation: Excitation, context: Context) -> Recording | None:
        """A replay of a sound arm; None where it is not sound."""
        truth = self._remote.truth()
        if truth["faults"] or (truth["robot_mode"], truth["safety_mode"]) != (RobotMode.RUNNING, SafetyMode.NORMAL):
            return None
        try:
            recording = self._remote.play(excitation)
        except BadInput:  # it has become unsound since
            return None
        return dataclasses.replace(recording, context=dataclasses.replace(recording.context, **known_facts(context)))

    def repair(self, joint: int, kind: str) -> None:
        """The work on one joint (from 1) that a person has declared, done on the simulated arm; unknown kinds change nothing."""
        if kind not in TAKEN_AWAY:
            return
        with self._lock:
            truth = self._remote.truth()
            left = 1.0 - TAKEN_AWAY[kind]
            coulomb, viscous = (1.0 + left * (truth[key][joint - 1] - 1.0) for key in ("wear_coulomb", "wear_viscous"))
            # grease does not mend what wears the joint; other parts wear as the healthiest joint does
            pace = None if kind == "greased" else min(truth["wear_per_revolution"])
            self._remote.wear(joint, coulomb_factor=coulomb, viscous_factor=viscous, per_revolution=pace)


def trial_file(folder: Path, document: dict[str, Any], host: str, bus_port: int, page_port: int) -> Path:
    """The configuration of the trial as a file, so that every command can be tried on it.

    document : of the robot's own configuration, or of a first one. The address, the history's place and the ports become the trial's.
    """
    document = {name: dict(table) for name, table in document.items()}
    document["robot"] |= {"host": host}
    document["robot"].pop("serial", None)  # that of the real arm
    document.setdefault("replay", {}).update(allow_motion=True, permit="none", windows_utc=[], hand_over="none")
    document.setdefault("store", {})["directory"] = "history"
    document["bus"] = {"listen": [f"tcp/127.0.0.1:{bus_port}"]}
    document["page"] = {"listen": f"127.0.0.1:{page_port}"}
    path = folder / "try.toml"
    path.write_text(toml_text(document, "A trial of joint-monitor: the arm is simulated, and its clock runs fast."), "utf-8")
    return path


# --- Plays a trial: the daemon of `joint-monitor run`, with a clock that is handed in and replays that the simulator steps ---

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
        serve(configuration, clocks=clock.clocks, play=arm.replays, running=running)
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
