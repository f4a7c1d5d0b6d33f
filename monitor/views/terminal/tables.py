"""What people see on a terminal: tables, progress, one line a message. Progress goes to standard error, results to standard output."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

STATE_STYLE = {
    "NORMAL": "green",
    "CHECK_FUNCTION": "yellow",
    "OFF_SPEC": "yellow",
    "MAINTENANCE_REQUIRED": "bold magenta",
    "FAILURE": "bold red",
}
TIER_STYLE = {"advisory": "yellow", "wear": "bold magenta", "limit": "bold red", "cleared": "green"}


@contextmanager
def progress(title: str) -> Iterator[Callable[[str, float, float], None]]:
    """A bar for phases whose length is known, a spinner for others; nothing where standard error is no terminal."""
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.1f} s"))
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=None)

        def show(phase: str, elapsed_s: float, duration_s: float) -> None:
            bar.update(task, description=f"{title}: {phase}", completed=elapsed_s, total=duration_s or None)

        yield show


@contextmanager
def status(text: str) -> Iterator[None]:
    """A spinner while something is computed; nothing where standard error is no terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(text):
        yield


@contextmanager
def search_progress(title: str, budget: int) -> Iterator[Callable[[int, float], None]]:
    """A bar over a budget of evaluations with the best value and the time left; nothing where standard error is no terminal."""
    console = Console(stderr=True)
    text = TextColumn("{task.description}  best {task.fields[best]}")
    columns = (SpinnerColumn(), text, BarColumn(), TextColumn("{task.completed:.0f} of {task.total:.0f}"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=budget, best="–")

        def show(done: int, best: float) -> None:
            bar.update(task, completed=done, best=f"{best:.4g}" if best < float("inf") else "none allowed yet")

        yield show


@contextmanager
def campaign_progress(robots: Sequence[str]) -> Iterator[Callable[[str, str, float], None]]:
    """A bar for each robot with what is being done to it; nothing where standard error is no terminal."""
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.fields[robot]}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %  {task.description}"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        tasks = {name: bar.add_task("waiting", total=1.0, robot=name) for name in robots}

        def show(robot: str, doing: str, share: float) -> None:
            bar.update(tasks[robot], completed=share, description=doing)

        yield show


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def _whole_percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _pair(value: float | None, std: float | None) -> str:
    return "–" if value is None else f"{value:.3f} ± {_number(std, '.3f')}"


def _percent(fraction: float | None) -> str:
    return "–" if fraction is None else f"{100 * fraction:.1f} %"


def print_alerts(alerts: list[dict[str, Any]]) -> None:
    """The `alerts` command's list: what, how grave, since when, why, what to do, who has seen it."""
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    if not alerts:
        console.print("no alerts")
    for alert in alerts:
        place = "arm" if alert["joint"] is None else f"j{alert['joint']}"
        state = alert["tier"] if alert["active"] else "cleared"
        console.print(f"[bold]{place}/{alert['condition']}[/] [{TIER_STYLE.get(state, 'white')}]{state}[/] since {alert['raised_at']}")
        console.print(f"  {alert['text']}")
        console.print(f"  do: {alert['action']}")
        if alert["acknowledged_at"]:
            why = f": {alert['acknowledged_why']}" if alert["acknowledged_why"] else ""
            console.print(f"  acknowledged by {alert['acknowledged_by']} at {alert['acknowledged_at']}{why}", markup=False)
        if alert["shelved_until"]:
            console.print(f"  shelved by {alert['shelved_by']} until {alert['shelved_until']}", markup=False)


def print_status(document: dict[str, Any]) -> None:
    """The `status` command's table."""
    console = Console(width=None if sys.stdout.isatty() else 120)
    health = document["health"]
    console.print(
        f"{document['robot']}: {health['state'] if health else 'no replay has been assessed yet'}, model {document['model_revision']}"
    )
    if health and health.get("stale"):
        console.print(f"[yellow]{health['stale_why']}[/]", highlight=False)
    if document["friction"]:
        states = {joint["joint"]: joint["state"] for joint in health["joints"]} if health else {}
        old = {joint["joint"] for joint in health["joints"] if joint.get("stale")} if health else set()
        table = Table()
        for title in ("joint", "state", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "wear [%]", "rate [%/month]", "remaining life"):
            table.add_column(title, justify="right" if title != "state" else "left")
        for row in document["friction"]:
            state = states.get(row["joint"], "")
            table.add_row(
                str(row["joint"]),
                f"[{STATE_STYLE.get(state, 'white')}]{state}{' STALE' if row['joint'] in old else ''}",
                _number(row.get("temperature_c"), ".1f"),
                f"{row['coulomb_nm']:.2f} ± {row['coulomb_std_nm']:.2f}",
                f"{row['viscous_nm_s_per_rad']:.2f} ± {row['viscous_std_nm_s_per_rad']:.2f}",
                f"{100 * row['wear']:+z.1f} ± {100 * row['wear_std']:.1f}",
                f"{3000 * row['wear_rate_per_day']:+z.1f}",
                remaining_life(row.get("remaining_life")),
            )
        console.print(table)
    for alert in health["alerts"] if health else []:
        if alert.get("active"):
            console.print(
                f"[bold]{'arm' if alert['joint'] is None else 'J' + str(alert['joint'])} {alert['condition']}[/]: {alert['text']}"
            )
    if document.get("monitor"):
        if (silent_s := document.get("monitor_silent_s")) is not None:
            ago = f"{abs(silent_s) / 60.0:.0f} min {'ago' if silent_s > 0 else 'in the future: the clock was set back'}"
            console.print(
                f"[bold red]the monitor does not run[/], or cannot write: what follows it said {ago}; look at the service and at its disk",
                highlight=False,
            )
        console.print(monitor_line(document["monitor"]), highlight=False, markup=False)
    for row in document["ledger"]:
        console.print(
            f"  replay {row['replay']}  {row['window']}  {row['state']}{'  ' + row['reason'] if row['reason'] else ''}", highlight=False
        )


def remaining_life(life: dict[str, Any] | None) -> str:
    """`no trend`, or the median with its P10–P90 in days."""
    if not life or life.get("p50_days") is None:
        return "no trend"
    return f"{life['p50_days']:.0f} d ({_number(life.get('p10_days'), '.0f')}–{_number(life.get('p90_days'), '.0f')})"


def print_identification(document: dict[str, Any]) -> None:
    """The `identify` command's tables."""
    console = Console(width=None if sys.stdout.isatty() else 120)
    for recording in document["recordings"]:
        why = ", ".join(f"{count} {reason}" for reason, count in recording["rejected_why"].items())
        rejected = f", {recording['rejected_samples']} rows rejected ({why})" if recording["rejected_samples"] else ""
        size = f"{recording['samples']} samples, {recording['rate_hz']:.0f} Hz, {recording['duration_s']:.1f} s"
        line = f"{escape(recording['file'])}: {size}{rejected}"
        console.print(line, highlight=False)
    base = document["base_parameters"]
    console.print(
        f"{base['count']} base parameters by {document['method']}, condition number {_number(base['condition_number'], '.0f')}",
        highlight=False,
    )
    friction, fit = document["friction"], document["fit"]
    table = Table()
    titles = ["joint", "fc [Nm]", "fv [Nm·s/rad]", "T [°C]", "RMS [Nm]", "relative"]
    for validation in document["validation"]:
        titles.append(f"held out: {validation['file'].rsplit('/', 1)[-1][-24:]}")
    for title in titles:
        table.add_column(title, justify="right")
    temperatures = friction["temperature_c"] or [None] * len(friction["coulomb_nm"])
    for j, temperature in enumerate(temperatures):
        cells = [
            str(j + 1),
            _pair(friction["coulomb_nm"][j], friction["coulomb_std_nm"][j]),
            _pair(friction["viscous_nm_s_per_rad"][j], friction["viscous_std_nm_s_per_rad"][j]),
            _number(temperature, ".1f"),
            _number(fit["rms_nm"][j], ".3f"),
            _percent(fit["relative_rms"][j]),
        ]
        for held in document["validation"]:
            cells.append(
                f"{_percent(held['relative_rms'][j])} (before {_number(held['nominal_rms_nm'][j], '.1f')} Nm, "
                f"after {_number(held['rms_nm'][j], '.2f')} Nm)"
            )
        table.add_row(*cells)
    console.print(table)
    _print_beyond(console, document)
    for warning in document["warnings"]:
        console.print(f"[yellow]{warning['code']}[/]: {warning['text']}", highlight=False)


def _print_beyond(console: Console, document: dict[str, Any]) -> None:
    """What an identification found besides, where it was asked: law, validation before and after, gains, arm, payload."""
    friction = document["friction"]
    if "coulomb_misfit_std_nm" in friction:
        fc, fv = (
            "  ".join(_number(value, ".2f") for value in friction[key])
            for key in ("coulomb_misfit_std_nm", "viscous_misfit_std_nm_s_per_rad")
        )
        console.print(f"± is noise; another motion may change fc by ± {fc} and fv by ± {fv}, as the law is not quite the arm's")
    law = friction["law"]
    if law.get("values"):
        for name in law["parameters"]:
            pairs = zip(law["values"][name], law["std"][name], strict=True)
            told = "  ".join(f"{_number(value, '.3f')} ± {_number(std, '.3f')}" for value, std in pairs)
            console.print(f"friction law {law['name']}, {name}: {told}", highlight=False)
    if law.get("held_out"):
        errors = ", ".join(f"{name} {_number(error, '.3f')}" for name, error in law["held_out"].items())
        console.print(f"chosen by the error on data left out, in units of the noise: {errors}", highlight=False)
    for held in document["validation"]:
        before, after = held["nominal_normalised_error_nm"], held["normalised_error_nm"]
        console.print(f"{held['file']}: e_N before {before:.4f}, after {after:.4f} Nm ({held['samples']} samples)", highlight=False)
    if "gains" in document:
        gains = document["gains"]
        pairs = zip(gains["values_nm_per_a"], gains["std_nm_per_a"], strict=True)
        told = "  ".join("– " if value is None else f"{value:.2f} ± {std:.2f}" for value, std in pairs)
        console.print(f"joint gains from the payload pair [Nm/A]: {told}", highlight=False)
    if "physical" in document:
        physical = document["physical"]
        masses = "  ".join(f"{link['mass_kg']:.2f}" for link in physical["links"])
        console.print(
            f"physically consistent: masses {masses} kg; residual {100 * (physical['residual_ratio'] - 1):+z.2f} % beside unconstrained",
            highlight=False,
        )
    if "payload" in document:
        payload = document["payload"]
        centre = ", ".join(_number(value, ".3f") for value in payload["com_m"])
        console.print(
            f"payload: {payload['mass_kg']:.3f} ± {payload['mass_std_kg']:.3f} kg, centre ({centre}) m in the flange's frame",
            highlight=False,
        )


def print_base(document: dict[str, Any]) -> None:
    """The `base` command's tables."""
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    sigma, count = document["singular_values"], document["count"]
    console.print(f"{escape(document['robot'])}: {count} base parameters of {len(sigma)} standard ones")
    table = Table()
    table.add_column("", justify="right")
    table.add_column("base parameter, led by the column that is kept")
    for number, row in enumerate(document["combinations"]):
        table.add_row(str(number + 1), row["text"])
    console.print(table)
    console.print("singular values of the regressor at 25 random states, and their cumulative energy Σσ²:")
    pairs = [f"{value:.3g} ({100 * share:.2f} %)" for value, share in zip(sigma, document["cumulative_energy"], strict=True)]
    console.print("  " + ", ".join(pairs[:count]) + (f"; then {sigma[count]:.1g} and less" if count < len(sigma) else ""))
    counts = Table()
    for title in ("parameters", "fully", "in combination", "not identifiable"):
        counts.add_column(title, justify="left" if title == "parameters" else "right")
    for title, key in (("by columns", "by_column"), ("as the paper counts", "as_in_paper")):
        row = document["classification"][key]
        counts.add_row(title, str(row["fully"]), str(row["in_combination"]), str(row["not_identifiable"]))
    console.print(counts)
    quotable = document["quotable"]
    console.print(f"may be quoted alone, in {quotable['frames']} frames: {', '.join(quotable['parameters']['fully'])}")
    console.print(f"without effect on any torque: {', '.join(quotable['parameters']['not_identifiable'])}")
    for note in document["notes"]:
        console.print(f"[yellow]note[/]: {note}")


def print_energy(document: dict[str, Any]) -> None:
    """The `energy` command's tables."""
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    energy, speed = document["kinetic_energy_j"], document["flange_speed_m_s"]
    std = _number(energy["std_at_max"], ".2g")
    console.print(
        f"{escape(document['robot'])} along {escape(document['along'])}: {document['samples']} samples, {document['duration_s']:.1f} s"
    )
    console.print(f"kinetic energy at most {energy['max']:.2f} ± {std} J (at {energy['at_s']:.2f} s), {energy['mean']:.2f} J on average")
    console.print(f"flange at most {speed['max']:.2f} m/s (at {speed['at_s']:.2f} s)")
    if document.get("regions"):
        mass = document["effective_mass"]
        console.print(f"effective mass of the robot {mass['robot_kg']:.2f} kg with {mass['payload_kg']:g} kg payload: {mass['formula']}")
        table = Table()
        for title in ("region", "limit [J]", "its mass [kg]", "transfer energy [J]", "time above", "below limit", "whole arm below"):
            table.add_column(title, justify="left" if title == "region" else "right")
        words = {True: "[green]yes[/]", False: "[bold red]no[/]", None: "unknown"}
        for row in document["regions"]:
            table.add_row(
                escape(row["region"]),
                f"{row['limit_j']:g}",
                _number(row["body_mass_kg"], "g") if row["body_mass_kg"] is not None else "cannot yield",
                f"{row['transfer_energy_max_j']:.3f}",
                f"{100 * row['share_of_time_above']:.1f} %",
                words[row["transfer_energy_below_limit"]],
                words[row["whole_arm_below_limit"]],
            )
        console.print(table)
    console.print(f"[bold]{document['statement']}[/]")
    for warning in document["warnings"]:
        console.print(f"[yellow]{warning['code']}[/]: {warning['text']}")


def print_design(file: str, document: dict[str, Any]) -> None:
    """The `design` command's tables."""
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    proof, merits = document["proof"], document["objectives"]
    console.print(f"{file}: {document['robot']}, {document['repetitions']} × {document['period_s']:g} s; {document['source']}")
    clearance = proof["clearance"]
    console.print(f"clear of itself by {1000 * clearance['to_itself_m']:.0f} mm ({clearance['itself']})")
    if "to_cell_m" in clearance:
        cell = document["cell"]["cell"]
        console.print(f"clear of the cell {cell['name']!r} by {1000 * clearance['to_cell_m']:.0f} mm ({clearance['cell']})")
    for approach in proof["approaches"]:
        gap = min(approach["to_itself_m"], approach.get("to_cell_m", float("inf")))
        pose = ", ".join(f"{angle:.2f}" for angle in approach["from_rad"])
        console.print(f"approach from [{pose}]: clear by {1000 * gap:.0f} mm", markup=False)
    console.print(
        f"condition number {_number(merits['condition_number'], '.0f')}, of scaled columns "
        f"{_number(merits['scaled_condition_number'], '.0f')}; log det of the covariance: all "
        f"{_number(merits['log_det_covariance_all'], '.1f')}, friction {_number(merits['log_det_covariance_friction'], '.1f')}"
    )
    console.print(f"flange at most {proof['flange_speed_m_s']:.2f} m/s")
    table = Table()
    titles = ("joint", "fc std [Nm]", "fv std [Nm·s/rad]", "speeds [rad/s]", "moving", "position", "speed", "acceleration", "torque")
    for title in titles:
        table.add_column(title, justify="right")
    for j, (slow, fast) in enumerate(merits["speed_range_rad_s"]):
        shares = (proof[f"{name}_share"][j] for name in ("position", "speed", "acceleration", "torque"))
        table.add_row(
            str(j + 1),
            _number(merits["coulomb_std_nm"][j], ".3f"),
            _number(merits["viscous_std_nm_s_per_rad"][j], ".3f"),
            f"{_number(slow, '.2f')} – {_number(fast, '.2f')}",
            f"{100 * merits['moving_share'][j]:.0f} %",
            *(f"{100 * share:.0f} %" for share in shares),
        )
    console.print(table)
    console.print("deviations to expect of one repetition, residuals correlated; shares are of the limits")


def print_conditions(title: str, found: list[tuple[str, str, str]]) -> None:
    """Every condition: its name, ok or NO or not checked, and what was found."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for column in ("condition", "holds", "found"):
        table.add_column(column, overflow="fold", no_wrap=column != "found")
    style = {"ok": "green", "NO": "bold red", "not checked": "yellow"}
    for name, word, told in found:
        table.add_row(name, Text(word, style=style[word]), Text(told))
    Console(width=None if sys.stdout.isatty() else 140).print(table)
    failed = [name for name, word, _ in found if word == "NO"]
    print(f"the arm may not move: {', '.join(failed)}" if failed else "the arm may move")  # noqa: T201


def print_bus(found: list[dict[str, Any]]) -> None:
    """How far one gets on the bus, and what to do where it is not far enough."""
    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False)
    for row in found:
        word = "[green]ok[/]" if row["cause"] == "reached" else f"[bold yellow]{row['cause']}[/]"
        console.print(f"bus, {row['who']} at {escape(row['endpoint'])}: {word}: {escape(row['told'])}")


def print_not_alerting(joint: int, reasons: Sequence[str]) -> None:
    """Why a joint does not alert."""
    console = Console()
    console.print(f"joint {joint}: {'the highest tier stands' if not reasons else 'no further alert, for'}", highlight=False)
    for reason in reasons:
        console.print(f"  {reason}", highlight=False, markup=False)


def print_assessment(document: dict[str, Any], why: int | None = None) -> None:
    """A series of recordings, judged: what is believed now, and every alert with its reasons; of joint `why`, why not."""
    console = Console()
    table = Table(title=f"{document['robot']}: {document['health']['arm']}, {document['why']['arm']}", title_justify="left")
    for title in ("recording", "made at", "verdict", *(f"J{j + 1} wear [%]" for j in range(len(document["health"]["joints"])))):
        table.add_column(title, justify="right" if "wear" in title else "left")
    by_file: dict[str, list[dict[str, Any]]] = {}
    for row in document["friction"]:
        by_file.setdefault(row["recorded_at"], []).append(row)
    for row in document["recordings"]:
        wear = [f"{100 * j['wear']:+z.1f} ± {100 * j['wear_std']:.1f}" for j in by_file.get(row["recorded_at"], [])]
        table.add_row(row["file"], row["recorded_at"], row["verdict"], *wear)
    console.print(table)
    for alert in document["alerts"]:
        place = "arm" if alert["joint"] is None else f"joint {alert['joint']}"
        active = "" if alert["active"] else " (cleared)"
        console.print(f"{place}: {alert['condition']}, {alert['tier']}{active}: {alert['text']} {alert['action']}", highlight=False)
    if not document["alerts"]:
        console.print("no alert")
    for row in document["not_alerting"]:
        if row["joint"] == why:
            print_not_alerting(row["joint"], row["reasons"])
    for code in sorted({warning["code"] for warning in document["warnings"]}):
        first = next(warning for warning in document["warnings"] if warning["code"] == code)
        count = sum(warning["code"] == code for warning in document["warnings"])
        more = f" (and {count - 1} more like it)" if count > 1 else ""
        console.print(f"warning {code}: {first['file']}: {first['text']}{more}", highlight=False, markup=False)
    for row in document["recordings"]:
        if row["reason"]:
            console.print(f"rejected {row['file']}: {row['reason']}", highlight=False, markup=False)


def print_rehearsal(document: dict[str, Any]) -> None:
    """What the thresholds would do on the simulated fleet."""
    console = Console()
    years, noise = document["robot_years"], 100 * document["between_std"]
    console.print(
        f"{years:.0f} robot-years on which nothing wears, friction {noise:.1f} % from replay to replay with "
        f"ρ = {document['autocorrelation']:g}; the first {document['learning_days']} days left out",
        highlight=False,
    )
    table = Table(title="alerts that mean nothing, advisories counted", title_justify="left")
    for title in ("scenario", "alerts", "a robot-year", "at most (95 %)"):
        table.add_column(title, justify="left" if title == "scenario" else "right")
    for name, rate in document["false_alarms"].items():
        table.add_row(name, str(rate["events"]), f"{rate['per_year']:.3f}", f"{rate['at_most']:.3f}")
    console.print(table)
    table = Table(title="days from the onset to the first tier", title_justify="left")
    for title in ("wear of one joint", "arms", "median", "9 of 10", "within 30", "right joint", "wear tier, median"):
        table.add_column(title, justify="left" if title == "wear of one joint" else "right")
    for row in document["detection"]:
        days = [_number(row[key], ".0f") for key in ("median_days", "p90_days")]
        shares = [_whole_percent(row[key]["share"]) for key in ("within_30_days", "right_joint")]
        table.add_row(row["wear"], str(row["arms"]), *days, *shares, _number(row["wear_tier_median_days"], ".0f"))
    console.print(table)
    life = document["remaining_life"]
    console.print(
        f"90 % intervals of friction hold the truth in {_whole_percent(document['friction_interval_90']['value'])}; "
        f"P10–P90 of remaining life in {_whole_percent(life['p10_p90_holds']['share'])}; P50 within 20 % at half-life in "
        f"{_whole_percent(life['alpha_lambda_at_half_life']['share'])}",
        highlight=False,
    )


def monitor_line(document: dict[str, Any]) -> str:
    """How the monitor itself was when it last said so."""
    store = document["store"]
    free = "unknown" if store["free_bytes"] is None else f"{store['free_bytes'] / 1e9:.1f} GB"
    lines = [
        f"monitor {document['version']} at {document['said_at']}: next replay {document['next_replay_due'] or 'none'}; "
        f"backup {store['last_backup_at'] or 'none yet'}; {free} free"
    ]
    lag, waiting, process = document["lag_s"], document["bus"], document["process"]
    resident = f"{process['resident_bytes'] / 1e6:.0f} MB of memory, " if process["resident_bytes"] else ""
    lines.append(
        f"  up {document['uptime_s'] / 3600.0:.1f} h; {resident}{process['cpu_s']:.0f} s of processor; "
        f"{'' if lag is None else f'last window begun {lag:.0f} s after its opening; '}"
        f"bus: {', '.join(f'{count} {name.replace(chr(95), chr(32))}' for name, count in waiting.items())}"
    )
    lines += [f"  since {trouble['since']} {trouble['name']}: {trouble['text']}" for trouble in document["troubles"]]
    if document.get("reload"):
        reload = document["reload"]
        lines.append(f"  configuration {'reloaded' if reload['done'] else 'NOT reloaded'} at {reload['at']}: {reload['told']}")
    return "\n".join(lines)


def print_history(rows: list[dict[str, Any]], left_out: int) -> None:
    """The `history` command's table."""
    console = Console(width=None if sys.stdout.isatty() else 120)
    if not rows:
        console.print("no replay has been assessed in that time")
        return
    table = Table()
    for title in ("recorded", "replay", "joint", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "F at v*, T0 [Nm]", "wear [%]"):
        table.add_column(title, justify="left" if title == "recorded" else "right")
    for row in rows:
        table.add_row(
            row["recorded_at"],
            str(row["replay"]),
            str(row["joint"]),
            _number(row.get("temperature_c"), ".1f"),
            _pair(row.get("coulomb_nm"), row.get("coulomb_std_nm")),
            _pair(row.get("viscous_nm_s_per_rad"), row.get("viscous_std_nm_s_per_rad")),
            _pair(row.get("reference_torque_nm"), row.get("reference_torque_std_nm")),
            f"{100 * row['wear']:+z.1f} ± {100 * row['wear_std']:.1f}",
        )
    console.print(table)
    if left_out:
        console.print(f"{left_out} earlier rows are left out: --limit, --from, --to, --joint", highlight=False)


def print_reproduction(document: dict[str, Any], output: str | None) -> None:
    """Every statement of the paper that was looked at, by robot."""
    console = Console(width=None if sys.stdout.isatty() else 150, highlight=False)
    marks = {True: "[green]holds[/]", False: "[bold red]DOES NOT HOLD[/]", None: "[dim]must differ[/]"}
    for robot in document["robots"]:
        table = Table(title=robot["robot"], title_justify="left")
        for title in ("", "statement", "paper", "ours"):
            table.add_column(title, overflow="fold")
        for section in robot["sections"]:
            for check in section["checks"]:
                table.add_row(marks[check["holds"]], escape(check["what"]), escape(check["paper"]), escape(check["ours"]))
        console.print(table)
    checks = [check["holds"] for robot in document["robots"] for section in robot["sections"] for check in section["checks"]]
    console.print(
        f"{checks.count(True)} statements that must agree hold, {checks.count(False)} do not; {checks.count(None)} figures must differ, "
        f"as the arms are simulated; {document['took_s']:.0f} s"
    )
    if output is not None:
        console.print(f"written: {output}", markup=False)
