"""The main job on one machine with no hardware: a simulated UR5, weeks of its life, a joint that wears, a real daemon.

Real: the controller's wire and the unmodified ur-rtde (a process each), the daemon with its store and its assessment,
Zenoh over TCP. Handed in: the daemon's clock, and for the days between the live replays a replay that the simulator
steps through faster than real time with the same physics.
"""

import dataclasses
import json
import math
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from monitor.acquire.listen import Listener, ListenSettings
from monitor.acquire.replay import replay
from monitor.acquire.watch import ReplayProgress
from monitor.config.load import Configuration, from_document
from monitor.errors import ReplayAborted, RobotUnreachable
from monitor.identify.signals.quality import quality_problem
from monitor.identify.validate import errors_of
from monitor.judge.drift.observation import DriftSettings
from monitor.model.fourier import Excitation
from monitor.publish.client import Client
from monitor.publish.timestamps import rfc3339
from monitor.recording import Array, Context, Recording
from monitor.service.daemon import Daemon
from monitor.service.page import page
from monitor.simulate.launch import ended
from monitor.simulate.remote import Remote
from monitor.store.store import Store
from monitor.studies.figures import MOVING_RAD_S
from monitor.views.terminal.figures import remaining_life

DAY_S = 86_400.0
FIRST_DAY_UNIX_S = 1_767_582_000.0  # Monday 2026-01-05 03:00 UTC
DAYS = 28
LIVE_DAYS = (0, 7, 14, 20, 27)  # these replays go through the RTDE wire in real time
WEARING_JOINT = 3
ONSET_DAY = 14  # until then every joint is healthy
WEAR_PER_REVOLUTION = 5e-5  # from then on, of that joint: thousands of times a healthy one's, so that two weeks show what takes years
LIVE_ATTEMPTS = 3
DUTY = 0.5  # share of the working day in which the arm moves
WORKING_H = 10.0
COLD_DAYS = {7: -9.0, 21: -7.0}  # Mondays after a weekend with the heating off [K]
REFERENCE_C = 27.0
WEAR_TIERS = ("wear", "limit")


@dataclass(slots=True)
class Seen:
    """What came over Zenoh, as any subscriber would have it."""

    friction: dict[int, dict[str, Any]] = field(default_factory=dict)
    health: dict[str, Any] = field(default_factory=dict)
    alerts: dict[str, dict[str, Any]] = field(default_factory=dict)
    raised: list[tuple[str, str]] = field(default_factory=list)  # when (virtual), which
    live_samples: int = 0

    def take(self, key: str, document: dict[str, Any]) -> None:
        """Keep one document."""
        if key.endswith("/friction"):
            self.friction[int(key.split("/")[1])] = document
        elif key == "health":
            self.health = document
        elif key == "torque/live":
            self.live_samples += 1
        elif key.startswith("alert/"):
            before = self.alerts.get(key, {})
            self.alerts[key] = document
            if document.get("active") and (not before.get("active") or before.get("tier") != document.get("tier")):
                self.raised.append((str(document.get("updated_at") or document.get("raised_at")), f"{key} {document.get('tier')}"))


@dataclass(slots=True)
class Diary:
    """What the demo did, for the screen and the summary."""

    clock_unix_s: float = FIRST_DAY_UNIX_S
    day: int = 0
    doing: str = "starting the simulated arm"
    ambient_c: float = 22.0
    replays: list[str] = field(default_factory=list)
    live_replays: int = 0
    disturbed: list[str] = field(default_factory=list)  # live replays that were played again, and why
    stepped_replays: int = 0
    true_wear: Array = field(default_factory=lambda: np.zeros(6))  # (J,) growth of friction by the simulator's own law


def play(*, seed: int = 0, keep: Path | None = None, as_json: bool = False) -> int:
    """Run the demo.

    Returns 0 where the wear alert came for the right joint and for no other, else 1.
    """
    began = time.monotonic()
    console = Console(stderr=as_json, width=None if sys.stdout.isatty() else 120)
    with ExitStack() as stack:
        if keep is None:
            folder = Path(tempfile.mkdtemp(prefix="joint-monitor-demo-"))
            stack.callback(shutil.rmtree, folder, ignore_errors=True)
        else:
            folder = keep
            folder.mkdir(parents=True, exist_ok=True)
        host = _free_host()
        endpoint = f"tcp/127.0.0.1:{_free_port()}"
        configuration = _configuration(folder, host, endpoint)
        remote = stack.enter_context(_simulated_arm(host, seed))
        diary, seen = Diary(), Seen()
        healthy_nm = _friction_nm(remote)
        on_screen = _Screen(console, diary, seen)

        def have(excitation: Excitation, context: Context, should_stop: Callable[[], bool]) -> Recording:
            if diary.day in LIVE_DAYS:

                def on_progress(at: ReplayProgress) -> None:
                    total = f" of {at.duration_s:.0f}" if at.duration_s else ""
                    diary.doing = f"live replay over RTDE, servoJ at 125 Hz: {at.phase} {at.elapsed_s:.1f}{total} s"

                def live() -> Recording:
                    model, settings = configuration.robot_description, configuration.replay
                    return replay(excitation, model, settings, context=context, on_progress=on_progress, should_stop=should_stop)

                return _undisturbed(live, configuration, diary)
            diary.doing = "stepped replay: the simulator plays it faster than real time"
            recording = remote.play(excitation)
            known = dataclasses.replace(recording.context, **_known(context))
            return dataclasses.replace(recording, context=known)

        store = stack.enter_context(Store.open(configuration.state_directory))
        daemon = stack.enter_context(Daemon(configuration, store, now=lambda: diary.clock_unix_s, play=have))
        served = stack.enter_context(page(configuration, daemon.bus, store, now=lambda: diary.clock_unix_s))
        assert served is not None  # the demo configures an address
        console.print(f"status page while it runs: {served.url}", highlight=False)
        client = stack.enter_context(Client(endpoint, "demo", "ur5"))
        done = threading.Event()
        watcher = threading.Thread(target=_follow, args=(client, seen, done), name="watcher")
        watcher.start()
        stack.callback(watcher.join)
        stack.callback(done.set)
        ears = threading.Thread(target=_listen, args=(daemon, host, done), name="listener")
        ears.start()
        stack.callback(ears.join)
        stack.callback(done.set)

        with on_screen:
            for day in range(DAYS):
                _live_a_day(remote, diary, day)
                row = daemon.monitor.perform(diary.clock_unix_s)
                assert row is not None
                live = day in LIVE_DAYS
                diary.live_replays += live
                diary.stepped_replays += not live
                diary.true_wear = _friction_nm(remote) / healthy_nm - 1.0
                how = "RTDE, real time" if live else "stepped"
                diary.replays.append(f"{rfc3339(diary.clock_unix_s)[:10]}  {how:<15}  {row.state}{': ' + row.reason if row.reason else ''}")
                time.sleep(0.05)  # what was published arrives
                on_screen.refresh()
            diary.doing = "a cold evening: asking the model for torque at temperatures between those of the replays"
            asked = _ask_torque(client, remote, configuration)
        return _summary(console, diary, seen, asked, time.monotonic() - began, as_json=as_json)


# --- the world ---------------------------------------------------------------------------------------


@contextmanager
def _simulated_arm(host: str, seed: int) -> Iterator[Remote]:
    """A simulated UR5 in a process of its own."""
    command = [sys.executable, "-m", "monitor.simulate", "--robot", "ur5", "--bind", host, "--seed", str(seed)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        if not process.stdout.readline():
            raise RobotUnreachable(f"the simulated controller on {host} ended with code {process.wait()} before it was ready")
        with Remote(host) as remote:
            yield remote
    finally:
        ended(process)


def _friction_nm(remote: Remote) -> Array:
    """(J,) what the simulator knows of friction, at the speed that the monitor refers to and one temperature."""
    speed = DriftSettings().reference_speed_rad_s
    friction: Array = remote.friction([[speed] * 6], REFERENCE_C)[0]
    return friction


def _live_a_day(remote: Remote, diary: Diary, day: int) -> None:
    """One day of the arm's life: a night, a day's work, and how warm it is when the replay comes."""
    diary.day = day
    season = 22.0 + 2.5 * math.sin(2 * math.pi * day / 9.0)
    diary.ambient_c = season + COLD_DAYS.get(day, 0.0)
    diary.doing = "work and night: heat and wear advance on command"
    weekend = day % 7 in (5, 6)
    if day == ONSET_DAY:
        remote.wear(WEARING_JOINT, per_revolution=WEAR_PER_REVOLUTION)
    if day > 0:
        diary.clock_unix_s += DAY_S
        remote.advance(hours=WORKING_H, ambient_c=season + 2.0, duty=0.1 if weekend else DUTY)
        remote.advance(hours=24.0 - WORKING_H - 1.0, ambient_c=diary.ambient_c, duty=0.0)
    remote.advance(hours=1.0, ambient_c=diary.ambient_c, duty=(0.0, 0.15, 0.4, 0.7)[day % 4])


def _configuration(folder: Path, host: str, endpoint: str) -> Configuration:
    document = {
        "robot": {"model": "ur5", "site": "demo", "id": "ur5", "host": host, "mounting": "ground"},
        "replay": {"allow_motion": True, "excitation": "ur5-ground", "repetitions": 1, "approach_speed_rad_s": 0.8},
        "store": {"directory": "history"},
        "bus": {"listen": [endpoint]},
        "page": {"listen": "127.0.0.1:0"},
    }
    return from_document(document, folder / "demo.toml")


def _known(context: Context) -> dict[str, Any]:
    facts = {f.name: getattr(context, f.name) for f in dataclasses.fields(context)}
    return {name: value for name, value in facts.items() if value is not None}


def _undisturbed(live: Callable[[], Recording], configuration: Configuration, diary: Diary) -> Recording:
    """A live replay, once more where other work on this machine disturbed it: the arm shares its processors with everything else here.

    The daemon itself never does so: it tells why, and waits for the next window.
    """
    for _ in range(LIVE_ATTEMPTS - 1):
        try:
            recording = live()
        except ReplayAborted as error:
            if error.needs_a_person and error.cause != "following_error":
                raise
            why: str | None = error.cause
        else:
            why = quality_problem(recording.quality, recording.samples, configuration.assess.trust)
            if why is None:
                return recording
        diary.disturbed.append(f"day {diary.day + 1}: {why}")
    return live()


def _free_host() -> str:
    """A loopback address on which nobody has the controller's fixed ports."""
    for last in range(2, 250):
        host = f"127.0.77.{last}"
        try:
            for port in (29999, 30001, 30002, 30003, 30004, 30020):
                with socket.socket() as probe:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    probe.bind((host, port))
        except OSError:
            continue
        return host
    raise RobotUnreachable("no loopback address 127.0.77.x has the controller's ports 29999 and 30001–30004 free")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


# --- who listens ---------------------------------------------------------------------------------------


def _follow(client: Client, seen: Seen, done: threading.Event) -> None:
    for message in client.watch("**", until=done.is_set):
        seen.take(message.key, message.document)


def _listen(daemon: Daemon, host: str, done: threading.Event) -> None:
    """The daemon's ears: live predictions while the arm stands and while it moves."""
    listener = Listener(ListenSettings(host=host, rate_hz=5.0))
    listener.start()
    try:
        while not done.wait(0.1):
            for state in listener.poll()[-1:]:
                daemon.live.sample(state.q, state.qd, state.target_qdd, state.current, state.temperature_c)
            daemon.bus.robot_alive(listener.reachable)
    finally:
        listener.stop()


def _ask_torque(client: Client, remote: Remote, configuration: Configuration) -> dict[str, Any]:
    """One query over Zenoh at a temperature that no replay had, beside the simulated truth."""
    remote.advance(hours=14.0, ambient_c=20.0, duty=0.0)
    remote.advance(hours=0.6, ambient_c=20.0, duty=0.35)
    truth = remote.truth()
    temperature = list(truth["motor_temperature_c"])
    t_s = np.linspace(0.0, configuration.excitation.pass_s, 200, endpoint=False)
    q, qd, qdd = configuration.excitation.at(t_s)
    true = np.array(remote.torque(q.tolist(), qd.tolist(), qdd.tolist()))
    rows = {"q": q.tolist(), "qd": qd.tolist(), "qdd": qdd.tolist()}
    answer = client.torque(**rows, temperature_c=[temperature])
    moving = np.abs(qd) > MOVING_RAD_S
    error, size = (errors_of(true, predicted, moving).rms_nm for predicted in (np.array(answer.torque_nm), np.zeros_like(true)))
    moment = int(np.argmax(np.min(np.abs(qd), axis=1)))  # every joint moves
    one = client.torque(q=q[moment].tolist(), qd=qd[moment].tolist(), qdd=qdd[moment].tolist(), temperature_c=temperature)
    return {
        "temperature_c": temperature,
        "predicted_nm": one.torque_nm,
        "std_nm": one.std_nm,
        "true_nm": true[moment].tolist(),
        "friction_nm": one.friction_nm,
        "rms_error_nm": error.tolist(),
        "rms_torque_nm": size.tolist(),
    }


# --- what is shown -------------------------------------------------------------------------------------


class _Screen:
    """A live table on a terminal; one line a replay elsewhere."""

    def __init__(self, console: Console, diary: Diary, seen: Seen) -> None:
        self._console, self._diary, self._seen = console, diary, seen
        self._live = Live(get_renderable=self._table, console=console, refresh_per_second=4) if console.is_terminal else None

    def __enter__(self) -> "_Screen":
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        if self._live is not None:
            self._live.__exit__(*error)  # its last table stays on the screen
        else:
            self._console.print(self._table())

    def refresh(self) -> None:
        """Say the newest replay where no live table does."""
        if self._live is None:
            friction = self._seen.friction.get(WEARING_JOINT)
            wear = f"  J{WEARING_JOINT} wear {_wear(friction)}" if friction else ""
            alerts = ", ".join(f"{key} {a['tier']}" for key, a in self._seen.alerts.items() if a.get("active"))
            self._console.print(f"{self._diary.replays[-1]}{wear}  {alerts}", highlight=False)

    def _table(self) -> Group:
        diary, seen = self._diary, self._seen
        table = Table(title="what comes over Zenoh, beside what the simulator knows", title_justify="left")
        for title in ("joint", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "wear", "true wear", "remaining life", "state"):
            table.add_column(title, justify="left" if title == "state" else "right")
        states = {joint["joint"]: joint["state"] for joint in seen.health.get("joints", [])}
        for j, row in sorted(seen.friction.items()):
            state = states.get(j, "")
            table.add_row(
                str(j),
                f"{row['temperature_c']:.1f}" if row["temperature_c"] is not None else "–",
                f"{row['coulomb_nm']:.2f} ± {row['coulomb_std_nm']:.2f}",
                f"{row['viscous_nm_s_per_rad']:.2f} ± {row['viscous_std_nm_s_per_rad']:.2f}",
                _wear(row),
                _percent(diary.true_wear[j - 1]),
                remaining_life(row["remaining_life"]),
                Text(state, style="green" if state == "NORMAL" else "bold magenta"),
            )
        condition = f"J{WEARING_JOINT} wears with use" if diary.day >= ONSET_DAY else "all joints healthy"
        today = f"day {diary.day + 1} of {DAYS}, {rfc3339(diary.clock_unix_s)[:10]} (the daemon's clock)"
        lines = [
            Text(f"{today}, room {diary.ambient_c:.0f} °C; {condition}"),
            Text(f"{diary.live_replays} replays in real time over RTDE, {diary.stepped_replays} stepped; now: {diary.doing}", style="dim"),
        ]
        active = [(key, alert) for key, alert in sorted(seen.alerts.items()) if alert.get("active")]
        alerts = [Text(f"ALERT {key}, {alert['tier']}: {alert['text']}", style="bold magenta") for key, alert in active]
        return Group(*lines, table, *alerts, *(Text(line, style="dim") for line in diary.replays[-4:]))


def _wear(friction: dict[str, Any]) -> str:
    return f"{100 * friction['wear']:+z.1f} ± {100 * friction['wear_std']:.1f} %"


def _percent(fraction: float | None) -> str:
    return "–" if fraction is None else f"{100 * fraction:+z.1f} %"


def _summary(console: Console, diary: Diary, seen: Seen, asked: dict[str, Any], took_s: float, *, as_json: bool) -> int:
    active = [alert for alert in seen.alerts.values() if alert.get("active") and alert["tier"] in WEAR_TIERS]
    alerts = {(alert["joint"], alert["condition"]): alert["tier"] for alert in active}
    right = any(joint == WEARING_JOINT for joint, _ in alerts)
    wrong = sorted(str(place) for place in alerts if place[0] != WEARING_JOINT)
    complete = len(diary.replays) == DAYS and all("assessed" in line for line in diary.replays)
    passed = right and not wrong and complete
    table = Table(title="one torque query over Zenoh at a temperature between those of the replays", title_justify="left")
    for title in ("joint", "T [°C]", "predicted [Nm]", "truth [Nm]", "of it friction [Nm]", "RMS error, in motion"):
        table.add_column(title, justify="right")
    for j in range(6):
        table.add_row(
            str(j + 1),
            f"{asked['temperature_c'][j]:.1f}",
            f"{asked['predicted_nm'][j]:.2f} ± {asked['std_nm'][j]:.2f}",
            f"{asked['true_nm'][j]:.2f}",
            f"{asked['friction_nm'][j]:.2f}",
            f"{asked['rms_error_nm'][j]:.2f} Nm ({100 * asked['rms_error_nm'][j] / asked['rms_torque_nm'][j]:.1f} %)",
        )
    if as_json:
        document = {
            "passed": passed,
            "days": DAYS,
            "live_replays": diary.live_replays,
            "stepped_replays": diary.stepped_replays,
            "live_torque_samples": seen.live_samples,
            "alerts": [{key: alert[key] for key in ("joint", "condition", "tier", "text")} for alert in active],
            "raised": [{"at": at, "alert": which} for at, which in seen.raised],
            "wear": [
                {"joint": j, "estimated": row["wear"], "std": row["wear_std"], "true": float(diary.true_wear[j - 1])}
                for j, row in sorted(seen.friction.items())
            ],
            "torque": asked,
            "took_s": round(took_s, 1),
        }
        print(json.dumps(document, ensure_ascii=False, allow_nan=False))  # noqa: T201
    else:
        console.print(table)
        for at, which in seen.raised:
            console.print(f"  {at[:10]}  raised {which}", highlight=False)
        row = seen.friction.get(WEARING_JOINT)
        if row:
            true = _percent(diary.true_wear[WEARING_JOINT - 1])
            console.print(f"joint {WEARING_JOINT} wore by {true} in truth; the monitor says {_wear(row)}")
        counts = f"{diary.live_replays} replays over RTDE, {diary.stepped_replays} stepped, {seen.live_samples} live torque samples"
        console.print(f"{counts}, {took_s:.0f} s")
        for again in diary.disturbed:
            console.print(f"live replay played again, this machine had other work to do: {again}")
        verdict = "the wear alert came for the right joint and for no other" if passed else "FAILED: "
        if not complete:
            verdict += "not every replay was assessed; "
        if not right:
            verdict += f"no wear alert for joint {WEARING_JOINT}; "
        if wrong:
            verdict += f"alerts for {', '.join(wrong)}"
        console.print(verdict, style="green" if passed else "bold red")
    return 0 if passed else 1
