"""No silence: whoever waits for the demo sees every few seconds what it does. It imports nothing heavy, so that it speaks at once."""

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from monitor.config.schema import Configuration
from monitor.identify.validate import errors_of
from monitor.publish.client import Client
from monitor.publish.timestamps import rfc3339
from monitor.reason import joint_name, joint_text
from monitor.simulate.remote import Remote
from monitor.studies.demo.world import DAYS, ONSET_DAY, WEARING_JOINT, DemoState
from monitor.studies.figures import SLIDING_RAD_S
from monitor.views.terminal.figures import remaining_life

SILENCE_S = 2.0  # without a line; a busy machine may wake us seconds later


class Ticker:
    """A context manager: while it lasts, a line says what is done whenever nothing else was printed for SILENCE_S."""

    def __init__(self, write: Callable[[str], None], activity: str) -> None:
        """`write` prints one line, and flushes it."""
        self.activity: Callable[[], str] = lambda: activity  # what is done now
        self._write = write
        self._spoke = time.monotonic()
        self._quiet = self._done = False
        self._doing, self._since = "", self._spoke
        self._wake = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="ticker", daemon=True)

    def __enter__(self) -> "Ticker":
        self._write(self.activity())
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with self._wake:
            self._done = True
            self._wake.notify()
        self._thread.join()

    def spoke(self) -> None:
        """Somebody else has printed a line."""
        self._spoke = time.monotonic()

    def quiet(self, quiet: bool) -> None:
        """Whether a screen that is redrawn all the time says it instead."""
        self._quiet = quiet
        self.spoke()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait(0.25)
                if self._done:
                    return
            now, doing = time.monotonic(), self.activity().split(":")[0]
            if doing != self._doing:
                self._doing, self._since = doing, now
            if not self._quiet and now - self._spoke >= SILENCE_S:
                self._spoke = now
                self._write(f"  … {self.activity()}, {now - self._since:.0f} s")


# --- The demo as a client of the bus: what it receives of the monitor's documents, and one torque query beside the truth ---

QUERY_AMBIENT_C = 20.0  # a room that no replay had, so that the joints' temperatures lie between those of the replays
QUERY_SAMPLES = 200  # along one pass of the excitation


@dataclass(slots=True)
class Received:
    """The newest document of each kind, as any subscriber receives it over Zenoh."""

    friction: dict[int, dict[str, Any]] = field(default_factory=dict)  # by joint, numbered from 1
    health: dict[str, Any] = field(default_factory=dict)
    alerts: dict[str, dict[str, Any]] = field(default_factory=dict)  # by key
    raised: list[tuple[str, str]] = field(default_factory=list)  # time by the daemon's clock, and key with tier
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

    @property
    def active_alerts(self) -> list[tuple[str, dict[str, Any]]]:
        """Alerts that are active now: key and document, in the order of arrival."""
        return [(key, alert) for key, alert in self.alerts.items() if alert.get("active")]


def receive(client: Client, received: Received, done: threading.Event) -> None:
    """Keep every document of the robot until `done` is set; a thread of its own runs this."""
    for message in client.watch("**", until=done.is_set):
        received.take(message.key, message.document)


def query_torque(client: Client, remote: Remote, configuration: Configuration) -> dict[str, Any]:
    """Query torque at temperatures that no replay had, and compare it with the simulated truth.

    Returns figures of every joint at one moment, and RMS of error and torque in motion along the excitation, all [N·m].
    """
    remote.advance(hours=14.0, ambient_c=QUERY_AMBIENT_C, duty=0.0)
    remote.advance(hours=0.6, ambient_c=QUERY_AMBIENT_C, duty=0.35)
    temperature_c = list(remote.truth()["motor_temperature_c"])
    t_s = np.linspace(0.0, configuration.excitation.pass_s, QUERY_SAMPLES, endpoint=False)
    q, qd, qdd = configuration.excitation.at(t_s)
    rows = {"q": q.tolist(), "qd": qd.tolist(), "qdd": qdd.tolist()}
    true_nm = np.array(remote.torque(rows["q"], rows["qd"], rows["qdd"]))
    predicted_nm = np.array(client.torque(**rows, temperature_c=[temperature_c]).torque_nm)
    moving = np.abs(qd) > SLIDING_RAD_S
    error_nm, size_nm = (errors_of(true_nm, one, moving).rms_nm for one in (predicted_nm, np.zeros_like(true_nm)))
    moment = int(np.argmax(np.min(np.abs(qd), axis=1)))  # at this moment the slowest joint is fastest: every joint moves
    answer = client.torque(q=q[moment].tolist(), qd=qd[moment].tolist(), qdd=qdd[moment].tolist(), temperature_c=temperature_c)
    return {
        "temperature_c": temperature_c,
        "predicted_nm": answer.torque_nm,
        "std_nm": answer.std_nm,
        "true_nm": true_nm[moment].tolist(),
        "friction_nm": answer.friction_nm,
        "rms_error_nm": error_nm.tolist(),
        "rms_torque_nm": size_nm.tolist(),
    }


# --- What a person sees while the demo runs: a live table on a terminal, one line for each replay elsewhere ---

REFRESH_PER_S = 4.0  # fast enough for a person, and cheap beside a live replay
REPLAYS_SHOWN = 4  # newest lines below the table


class Screen:
    """A context manager. On a terminal the table is redrawn all the time; elsewhere it is printed once, at the end."""

    def __init__(self, console: Console, state: DemoState, received: Received, ticker: Ticker) -> None:
        self._console, self._state, self._received, self._ticker = console, state, received, ticker
        self._live = Live(get_renderable=self._table, console=console, refresh_per_second=REFRESH_PER_S) if console.is_terminal else None

    def __enter__(self) -> "Screen":
        if self._live is not None:
            self._ticker.quiet(True)
            self._live.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, trace)  # its last table stays on the screen
            self._ticker.quiet(False)
        else:
            self._console.print(self._table())
            self._ticker.spoke()

    def replay_done(self) -> None:
        """Print the newest replay, unless the live table shows it."""
        if self._live is None:
            friction = self._received.friction.get(WEARING_JOINT)
            wear = f"  J{WEARING_JOINT} wear {wear_percent(friction)}" if friction else ""
            alerts = ", ".join(f"{key} {alert['tier']}" for key, alert in self._received.active_alerts)
            self._console.print(f"{self._state.replays[-1]}{wear}  {alerts}", highlight=False)
            self._ticker.spoke()

    def _table(self) -> Group:
        state, received = self._state, self._received
        table = Table(title="what comes over Zenoh, beside what the simulator knows", title_justify="left")
        for title in ("joint", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "wear", "true wear", "remaining life", "state"):
            table.add_column(title, justify="left" if title in {"joint", "state"} else "right")
        states = {joint["joint"]: joint["state"] for joint in received.health.get("joints", [])}
        for j, row in sorted(received.friction.items()):
            joint_state = states.get(j, "")
            table.add_row(
                f"{j} {joint_name(j)}",
                f"{row['temperature_c']:.1f}" if row["temperature_c"] is not None else "–",
                f"{row['coulomb_nm']:.2f} ± {row['coulomb_std_nm']:.2f}",
                f"{row['viscous_nm_s_per_rad']:.2f} ± {row['viscous_std_nm_s_per_rad']:.2f}",
                wear_percent(row),
                percent(state.true_wear[j - 1]),
                remaining_life(row["remaining_life"]),
                Text(joint_state, style="green" if joint_state == "NORMAL" else "bold magenta"),
            )
        condition = f"J{WEARING_JOINT} wears with use" if state.day >= ONSET_DAY else "all joints healthy"
        today = f"day {state.day + 1} of {DAYS}, {rfc3339(state.clock_unix_s)[:10]} (the daemon's clock)"
        counts = f"{state.live_replays} replays in real time over RTDE, {state.stepped_replays} stepped"
        lines = [
            Text(f"{today}, room {state.ambient_c:.0f} °C; {condition}"),
            Text(f"{counts}; now: {state.activity}", style="dim"),
        ]
        alerts = [
            Text(f"ALERT {key}, {alert['tier']}: {alert['text']}", style="bold magenta") for key, alert in sorted(received.active_alerts)
        ]
        return Group(*lines, table, *alerts, *(Text(line, style="dim") for line in state.replays[-REPLAYS_SHOWN:]))


def wear_percent(friction: dict[str, Any]) -> str:
    """Estimated wear of one joint with its standard deviation, in per cent."""
    return f"{100 * friction['wear']:+z.1f} ± {100 * friction['wear_std']:.1f} %"


def percent(fraction: float) -> str:
    """A signed fraction in per cent."""
    return f"{100 * fraction:+z.1f} %"


# --- The demo's verdict: did the wear alert come for the right joint and for no other? As JSON, and as text ---

WEAR_TIERS = ("wear", "limit")  # an advisory alone is no finding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Summary:
    """What the demo ends with. `torque` is the document of `query_torque`."""

    state: DemoState
    received: Received
    torque: dict[str, Any]
    took_s: float

    @property
    def wear_alerts(self) -> list[dict[str, Any]]:
        """Active alerts of the wear tier or above."""
        return [alert for _, alert in self.received.active_alerts if alert["tier"] in WEAR_TIERS]

    @property
    def problems(self) -> list[str]:
        """Why the demo failed, in words; empty where it passed."""
        found = []
        if self.state.failed:
            found.append(f"{len(self.state.failed)} of {DAYS} replays were not assessed ({'; '.join(self.state.failed)})")
        alerts = {(alert["joint"], alert["condition"]) for alert in self.wear_alerts}
        if not any(joint == WEARING_JOINT for joint, _ in alerts):
            found.append(f"no wear alert for joint {WEARING_JOINT}")
        wrong = sorted(str(alert) for alert in alerts if alert[0] != WEARING_JOINT)
        if wrong:
            found.append(f"alerts for {', '.join(wrong)}")
        return found

    def as_document(self) -> dict[str, Any]:
        """What `demo --json` prints."""
        return {
            "passed": not self.problems,
            "days": DAYS,
            "live_replays": self.state.live_replays,
            "stepped_replays": self.state.stepped_replays,
            "not_live_days": [day + 1 for day in self.state.not_live],
            "problems": self.problems,
            "live_torque_samples": self.received.live_samples,
            "alerts": [{key: alert[key] for key in ("joint", "condition", "tier", "text")} for alert in self.wear_alerts],
            "raised": [{"at": at, "alert": which} for at, which in self.received.raised],
            "wear": [
                {"joint": j, "estimated": row["wear"], "std": row["wear_std"], "true": float(self.state.true_wear[j - 1])}
                for j, row in sorted(self.received.friction.items())
            ],
            "torque": self.torque,
            "took_s": round(self.took_s, 1),
        }

    def print(self, console: Console) -> None:
        """Print the torque query, when which alert was raised, the wear beside the truth, and the verdict."""
        state, received = self.state, self.received
        console.print(_torque_table(self.torque))
        for at, which in received.raised:
            console.print(f"  {at[:10]}  raised {which}", highlight=False)
        row = received.friction.get(WEARING_JOINT)
        if row:
            true = percent(state.true_wear[WEARING_JOINT - 1])
            console.print(f"{joint_text(WEARING_JOINT)} wore by {true} in truth; the monitor says {wear_percent(row)}")
        counts = f"{state.live_replays} replays over RTDE, {state.stepped_replays} stepped, {received.live_samples} live torque samples"
        console.print(f"{counts}, {self.took_s:.0f} s")
        for repeated in state.disturbed:
            console.print(f"live replay disturbed, this machine had other work to do: {repeated}", highlight=False)
        if state.not_live:
            days = ", ".join(str(day + 1) for day in state.not_live)
            text = f"this machine could not keep the live replay of day {days} in real time: the simulator stepped it instead"
            console.print(text, style="yellow", highlight=False)
        if self.problems:
            console.print(f"FAILED: {'; '.join(self.problems)}", style="bold red")
            if (busy := busy_text()) is not None:
                console.print(busy, style="bold red")
        else:
            console.print("the wear alert came for the right joint and for no other", style="green")


def busy_text() -> str | None:
    """How busy this machine is, where that may be the cause of a failure; else None."""
    load, processors = os.getloadavg()[0], os.cpu_count() or 1
    if load <= processors:
        return None
    return f"this machine is busy: {load:.1f} programs want its {processors} processors; try again with less beside the demo"


def _torque_table(torque: dict[str, Any]) -> Table:
    table = Table(title="one torque query over Zenoh at a temperature between those of the replays", title_justify="left")
    for title in ("joint", "T [°C]", "predicted [Nm]", "truth [Nm]", "of it friction [Nm]", "RMS error, in motion"):
        table.add_column(title, justify="left" if title == "joint" else "right")
    for j in range(6):
        table.add_row(
            f"{j + 1} {joint_name(j + 1)}",
            f"{torque['temperature_c'][j]:.1f}",
            f"{torque['predicted_nm'][j]:.2f} ± {torque['std_nm'][j]:.2f}",
            f"{torque['true_nm'][j]:.2f}",
            f"{torque['friction_nm'][j]:.2f}",
            f"{torque['rms_error_nm'][j]:.2f} Nm ({100 * torque['rms_error_nm'][j] / torque['rms_torque_nm'][j]:.1f} %)",
        )
    return table
