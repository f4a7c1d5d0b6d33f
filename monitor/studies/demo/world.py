"""The demo's world: a simulated arm in a process of its own, how its days pass, and the monitor's configuration for it."""

import math
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from monitor.config.load import from_document
from monitor.config.schema import Configuration
from monitor.errors import RobotUnreachable
from monitor.judge.drift.settings import DriftSettings
from monitor.recording import Array
from monitor.simulate.launch import ended
from monitor.simulate.remote import Remote
from monitor.studies.demo.plan import (
    COLD_DAYS,
    DAY_S,
    DUTY,
    DUTY_BEFORE_REPLAY,
    ONSET_DAY,
    PRODUCTION_WARMS_ROOM_K,
    REFERENCE_C,
    ROOM_C,
    SEASON_DAYS,
    SEASON_K,
    WEAR_PER_REVOLUTION,
    WEARING_JOINT,
    WEEKEND,
    WEEKEND_DUTY,
    WORKING_H,
    DemoState,
)

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
