"""What happens on which day of the demo, and what the demo knows of its own course while it runs."""

import dataclasses
import math
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from monitor.acquire.replay import replay
from monitor.acquire.watch import Caller, ReplayProgress
from monitor.config.load import from_document
from monitor.config.schema import Configuration
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable
from monitor.identify.quality import quality_problem
from monitor.judge.friction.settings import DriftSettings
from monitor.model.fourier import Excitation
from monitor.reason import Reason
from monitor.recording import Array, Context, Recording
from monitor.service.motion import ReplayWindow
from monitor.simulate.launch import ended
from monitor.simulate.remote import Remote

DAY_S = 86_400.0
FIRST_DAY_UNIX_S = 1_767_582_000.0  # Monday 2026-01-05 03:00 UTC
DAYS = 28  # one replay each: two weeks healthy, two weeks with wear
LIVE_DAYS = (0, 27)  # replays of these days run over RTDE in real time, 15 s each; the others are stepped
WEARING_JOINT = 3  # numbered from 1
ONSET_DAY = 14  # from this day on the joint wears
WEAR_PER_REVOLUTION = 5e-5  # fraction of friction: thousands of times a healthy joint's, so that two weeks show what takes years
WORKING_H = 10.0  # of a day
DUTY = 0.5  # share of the working hours in which the arm moves
WEEKEND_DUTY = 0.1
WEEKEND = (5, 6)  # days of the week, counted from Monday
DUTY_BEFORE_REPLAY = (0.0, 0.15, 0.4, 0.7)  # of the last hour, day after day: the replays find the joints cold and warm
ROOM_C = 22.0
SEASON_K, SEASON_DAYS = 2.5, 9.0  # amplitude and period of the room's slow change, so that temperatures do not repeat every week
PRODUCTION_WARMS_ROOM_K = 2.0
COLD_DAYS = {7: -9.0, 21: -7.0}  # day → change of the room [K]: Mondays after a weekend without heating
REFERENCE_C = 27.0  # true friction is compared at one temperature: about that of a joint in this room


@dataclass(slots=True)
class DemoState:
    """The course of the demo up to now; the screen and the summary read it."""

    clock_unix_s: float = FIRST_DAY_UNIX_S  # the daemon's clock
    day: int = 0
    activity: str = "starting the simulated arm, the daemon and its bus"
    ambient_c: float = ROOM_C
    replays: list[str] = field(default_factory=list)  # a line each
    live_replays: int = 0
    stepped_replays: int = 0
    disturbed: list[str] = field(default_factory=list)  # live replays that were repeated: the day and the reason
    not_live: list[int] = field(default_factory=list)  # days whose live replay this machine could not keep in real time: stepped instead
    failed: list[str] = field(default_factory=list)  # replays that were not assessed: the day, how it ended and why
    true_wear: Array = field(default_factory=lambda: np.zeros(6))  # (J,) growth of friction by the simulator's own law


# --- The demo's world: a simulated arm in a process of its own, how its days pass, and the monitor's configuration for it ---

SITE, ROBOT_ID = "demo", "ur5"
CONTROLLER_PORTS = (29999, 30001, 30002, 30003, 30004, 30020)  # dashboard, the three client interfaces, RTDE, the simulator's commands


def study_folder(keep: Path | None, stack: ExitStack, name: str) -> Path:
    """The folder of a study's history: `keep`, or a temporary one with the study's name that the stack removes."""
    if keep is None:
        folder = Path(tempfile.mkdtemp(prefix=f"joint-monitor-{name}-"))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        return folder
    keep.mkdir(parents=True, exist_ok=True)
    return keep


@contextmanager
def simulated_arm(host: str, seed: int, *options: str) -> Iterator[Remote]:
    """A simulated arm, a UR5 unless `options` say otherwise, in a process of its own while the context lasts.

    Raises RobotUnreachable where it does not start.
    """
    command = [sys.executable, "-m", "monitor.simulate", "--bind", host, "--seed", str(seed), *(options or ("--robot", "ur5"))]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        if not process.stdout.readline():
            raise RobotUnreachable(f"the simulated controller on {host} ended with code {process.wait()} before it was ready")
        with Remote(host) as remote:
            yield remote
    finally:
        ended(process)


def true_friction_nm(remote: Remote) -> Array:
    """(J,) friction by the simulator's own law [N·m], at the monitor's reference speed and at REFERENCE_C."""
    speed_rad_s = DriftSettings().reference_speed_rad_s
    friction: Array = remote.friction([[speed_rad_s] * 6], REFERENCE_C)[0]
    return friction


def pass_day(remote: Remote, state: DemoState, day: int) -> None:
    """Let one day pass in the simulator: a day's work, a night, and an hour that warms the joints more or less before the replay."""
    state.day = day
    season_c = ROOM_C + SEASON_K * math.sin(2 * math.pi * day / SEASON_DAYS)
    state.ambient_c = season_c + COLD_DAYS.get(day, 0.0)
    state.activity = "work and night: heat and wear advance on command"
    if day == ONSET_DAY:
        remote.wear(WEARING_JOINT, per_revolution=WEAR_PER_REVOLUTION)
    if day > 0:
        state.clock_unix_s += DAY_S
        duty = WEEKEND_DUTY if day % 7 in WEEKEND else DUTY
        remote.advance(hours=WORKING_H, ambient_c=season_c + PRODUCTION_WARMS_ROOM_K, duty=duty)
        remote.advance(hours=24.0 - WORKING_H - 1.0, ambient_c=state.ambient_c, duty=0.0)
    remote.advance(hours=1.0, ambient_c=state.ambient_c, duty=DUTY_BEFORE_REPLAY[day % len(DUTY_BEFORE_REPLAY)])


def demo_configuration(folder: Path, host: str, endpoint: str) -> Configuration:
    """The monitor's configuration: the arm at `host`, the bus at `endpoint`, history in `folder`, the page at a free port."""
    document = {
        "robot": {"model": "ur5", "site": SITE, "id": ROBOT_ID, "host": host, "mounting": "ground"},
        "replay": {"allow_motion": True, "excitation": "ur5-ground", "repetitions": 1, "approach_speed_rad_s": 0.8},
        "store": {"directory": "history"},
        "bus": {"listen": [endpoint]},
        "page": {"listen": "127.0.0.1:0"},
    }
    return from_document(document, folder / "demo.toml")


def free_host() -> str:
    """A loopback address where the controller's fixed ports are free. Raises RobotUnreachable where there is none."""
    for last in range(2, 250):
        host = f"127.0.77.{last}"
        try:
            for port in CONTROLLER_PORTS:
                with socket.socket() as probe:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    probe.bind((host, port))
        except OSError:
            continue
        return host
    raise RobotUnreachable("no loopback address 127.0.77.x has the controller's ports 29999 and 30001–30004 free")


def free_port() -> int:
    """A TCP port of 127.0.0.1 that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


# --- How the demo makes a day's recording: a live replay over RTDE on some days, a replay that the simulator steps on the others ---

LIVE_ATTEMPTS = 3  # of one live replay: other work on this machine may disturb one; more than that is a machine without real time
OF_LATE_TARGETS = {"following_error", "torque_band"}  # a person must look at a real arm; nothing can be in the way of a simulated one


class DemoReplay:
    """Makes the recording of the present day; the daemon calls it in the place of a replay of a real arm."""

    def __init__(self, configuration: Configuration, remote: Remote, state: DemoState) -> None:
        self._configuration, self._remote, self._state = configuration, remote, state

    def __call__(self, excitation: Excitation, context: Context, should_stop: Callable[[], bool], _: ReplayWindow) -> Recording:
        """One replay. Raises MotionRefused, RobotUnreachable and ReplayAborted like `replay`."""
        if self._state.day in LIVE_DAYS:
            return self._undisturbed(excitation, context, lambda: self._live(excitation, context, should_stop))
        self._state.activity = "stepped replay: the simulator plays it faster than real time"
        recording = self._remote.play(excitation)
        return _of_daemon(recording, context)

    def _live(self, excitation: Excitation, context: Context, should_stop: Callable[[], bool]) -> Recording:
        robot, settings = self._configuration.robot_description, self._configuration.replay
        return replay(excitation, robot, settings, context=context, caller=Caller(on_progress=self._show, should_stop=should_stop))

    def _show(self, at: ReplayProgress) -> None:
        total = f" of {at.duration_s:.0f}" if at.duration_s else ""
        self._state.activity = f"live replay over RTDE, servoJ at 125 Hz: {at.phase} {at.elapsed_s:.1f}{total} s"

    def _undisturbed(self, excitation: Excitation, context: Context, live: Callable[[], Recording]) -> Recording:
        """Repeat a live replay that other work on this machine disturbed: here the arm is a process among others.

        A replay that ended on its way leaves the arm far from the start, where the next one would be refused. The simulator therefore
        steps one replay first: it ends at the start. The daemon itself waits before it tries again. After the last try the stepped replay
        is the day's, and the summary says so: a slow machine is no fault of the arm or of the monitor.
        """
        for attempt in range(1, LIVE_ATTEMPTS + 1):
            try:
                recording = live()
            except (MotionRefused, RobotUnreachable) as error:  # what does not answer in time is a simulator without processor time
                reason: str | Reason | None = str(error)
            except ReplayAborted as error:
                if error.needs_a_person and error.cause not in OF_LATE_TARGETS:
                    raise
                reason = error.cause
            else:
                reason = quality_problem(recording.quality, recording.samples, self._configuration.assess.quality)
                if reason is None:
                    return recording
            self._state.disturbed.append(f"day {self._state.day + 1}, try {attempt}: {reason}")
            self._state.activity = (
                f"live replay disturbed by other work on this machine ({reason}): the simulator steps the arm to the start"
            )
            recording = self._remote.play(excitation)
        self._state.not_live.append(self._state.day)
        return _of_daemon(recording, context)


def _of_daemon(recording: Recording, context: Context) -> Recording:
    """A stepped recording with what the daemon knows of its context."""
    return dataclasses.replace(recording, context=dataclasses.replace(recording.context, **known_facts(context)))


def known_facts(context: Context) -> dict[str, Any]:
    """The fields of a context that are known, by name."""
    facts = {field.name: getattr(context, field.name) for field in dataclasses.fields(context)}
    return {name: value for name, value in facts.items() if value is not None}
