"""The state of a running simulator in the terminal. The view is a process of its own and asks the command port."""

import math
import subprocess
import sys
import tempfile
import time
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from monitor.errors import BadInput, MonitorError, RobotUnreachable
from monitor.simulate.launch import ended
from monitor.simulate.remote import Remote

PERIOD_S = 0.25  # between two pictures
PRINT_PERIOD_S = 2.0  # where the output is no terminal
START_S = 30.0  # time that a simulator may need to report why it does not start
SAFETY = {1: "normal", 2: "reduced", 3: "PROTECTIVE STOP", 5: "SAFEGUARD STOP", 7: "EMERGENCY STOP"}
MODE = {3: "power off", 4: "power on", 5: "idle", 7: "running"}
RUNTIME = {1: "stopped", 2: "playing", 4: "paused"}


def screen(truth: dict[str, Any]) -> Group:
    """One picture of the arm from its true state."""
    table = Table()
    for title in ("joint", "q [°]", "q̇ [°/s]", "torque [Nm]", "motor [°C]", "grease [°C]", "dry wear", "viscous wear"):
        table.add_column(title, justify="right")
    for j in range(len(truth["q"])):
        table.add_row(
            str(j + 1),
            f"{math.degrees(truth['q'][j]):.2f}",
            f"{math.degrees(truth['qd'][j]):.2f}",
            f"{truth['torque_nm'][j]:.2f}",
            f"{truth['motor_temperature_c'][j]:.2f}",
            f"{truth['grease_temperature_c'][j]:.2f}",
            f"{100 * (truth['wear_coulomb'][j] - 1):+.2f} %",
            f"{100 * (truth['wear_viscous'][j] - 1):+.2f} %",
        )
    safety = SAFETY[truth["safety_mode"]]
    modes = f"{MODE[truth['robot_mode']]}, {safety}, program {RUNTIME[truth['runtime_state']]} ({truth['program'] or 'none'})"
    life = f"day {truth['lived_days']:.3f} of {truth['scenario']}, room {truth['ambient_c']:.1f} °C, controller up {truth['clock_s']:.1f} s"
    ticks = truth["ticks"]
    timing = f"{ticks['run']} ticks, {ticks['late']} late, {ticks['dropped']} dropped"
    runs = [_program(run) for run in truth["programs"][-2:]]
    stops = [f"{stop['at_s']:.2f} s  {stop['kind']}: {stop['reason']}" for stop in truth["stops"][-3:]]
    return Group(
        Text(f"{truth['robot']}: {modes}", style="" if safety == "normal" else "bold red"),
        Text(life),
        table,
        Text(timing, style="dim"),
        *(Text(line, style="dim") for line in [*truth["happened"][-3:], *runs, *stops]),
    )


def _program(run: dict[str, Any]) -> str:
    """A line on one program of the logbook."""
    begin = f"{run['began_s']:.2f} s  program {run['number']} of {'the ' if run['owner'] == 'client' else ''}{run['owner']}"
    return begin if run["ended_s"] is None else f"{begin}, ended at {run['ended_s']:.2f} s by {run['stopped_by']}"


def watch(host: str, port: int, seconds: float | None = None) -> None:
    """Show a simulator until Ctrl-C, until it ends, or for the given time."""
    console = Console()
    until = math.inf if seconds is None else time.monotonic() + seconds
    if not console.is_terminal:
        _print_pictures(console, host, port, until)
        return
    with Remote(host, port) as remote, Live(screen(remote.truth()), console=console, refresh_per_second=1.0 / PERIOD_S) as live:
        while time.monotonic() < until:
            time.sleep(PERIOD_S)
            try:
                live.update(screen(remote.truth()))
            except RobotUnreachable:
                return


def _print_pictures(console: Console, host: str, port: int, until: float) -> None:
    """Print one picture after the other, for a file or a pipe."""
    with Remote(host, port) as remote:
        while time.monotonic() < until:
            try:
                console.print(screen(remote.truth()))
                console.file.flush()
            except (RobotUnreachable, BrokenPipeError):
                return
            time.sleep(min(PRINT_PERIOD_S, max(0.0, until - time.monotonic())))


def simulate_and_watch(arguments: list[str], host: str, port: int, seconds: float | None = None) -> None:
    """Start a simulator in a process of its own and show it until Ctrl-C. The simulator ends with the view.

    Raises BadInput if its arguments or ports are wrong, MonitorError with its message if it does not start for another reason.
    """
    command = [sys.executable, "-m", "monitor.simulate", *arguments]
    with tempfile.TemporaryFile("w+") as log:  # a pipe would block the simulator when it is full
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            assert process.stdout is not None
            if not process.stdout.readline():
                process.wait(timeout=START_S)
                log.seek(0)
                wrong = BadInput if process.returncode == BadInput.exit_code else MonitorError
                raise wrong(log.read().strip() or f"the simulator ended with code {process.returncode}")
            watch(host, port, seconds)
        except KeyboardInterrupt:
            pass
        finally:
            ended(process)
