"""What a person sees while the demo runs: a live table on a terminal, one line for each replay elsewhere."""

from types import TracebackType
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from monitor.publish.timestamps import rfc3339
from monitor.reason import joint_name
from monitor.studies.demo.bus import Received
from monitor.studies.demo.plan import DAYS, ONSET_DAY, WEARING_JOINT, DemoState
from monitor.studies.demo.ticker import Ticker
from monitor.views.terminal.figures import remaining_life

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
