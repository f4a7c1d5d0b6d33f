"""The state of a running simulator in the terminal, in a process of its own, so that the arm keeps its time."""

import logging
import math
import os
import subprocess
import sys
import time
from contextlib import suppress
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from monitor.errors import RobotUnreachable
from monitor.simulate.launch import ended
from monitor.simulate.remote import Remote
from monitor.simulate.settings import SimulateSettings

PERIOD_S = 0.25  # between two pictures
PRINT_PERIOD_S = 2.0  # where the output is no terminal
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


def watch(host: str, port: int) -> None:
    """Show a simulator until it ends: on a terminal one picture in place of the other, into a file or a pipe one after the other.

    Raises BrokenPipeError where nobody reads any more.
    """
    console = Console()
    with Remote(host, port) as remote, suppress(RobotUnreachable):
        if console.is_terminal:
            with Live(screen(remote.truth()), console=console, refresh_per_second=1.0 / PERIOD_S) as live:
                while True:
                    time.sleep(PERIOD_S)
                    live.update(screen(remote.truth()))
        while True:
            console.print(screen(remote.truth()))
            console.file.flush()
            time.sleep(PRINT_PERIOD_S)


def simulate_and_watch(settings: SimulateSettings) -> None:
    """Simulate in this process, and show it in another one, until Ctrl-C or until nobody reads what is shown.

    Raises BadInput if a port is in use or the address cannot be bound.
    """
    from monitor.simulate.server import serve

    command = [sys.executable, "-m", "monitor.simulate.view", settings.bind, str(settings.command_port)]
    views: list[subprocess.Popen[str]] = []
    logging.disable()  # a line of the log would stand in the picture
    try:
        serve(settings, lambda: views.append(subprocess.Popen(command, text=True)))
    finally:
        for view in views:
            ended(view)


def main() -> None:
    """Watch the simulator at this address and port; where that ends, end the simulator."""
    host, port = sys.argv[1], int(sys.argv[2])
    try:
        watch(host, port)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in the buffer has no reader
    except KeyboardInterrupt:  # of a terminal: the simulator ends by it too
        return
    finally:  # also where rich has ended this process, because nobody reads
        with suppress(RobotUnreachable), Remote(host, port) as remote:
            remote.shutdown()


if __name__ == "__main__":
    main()
