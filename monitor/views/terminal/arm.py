"""Tables about one arm: `status`, `alerts`, `history`, `check`, and why a joint does not alert."""

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from monitor.views.terminal.figures import STATE_STYLE, TIER_STYLE, number, pair, remaining_life, standard_output, table_of


def print_alerts(alerts: list[dict[str, Any]]) -> None:
    """The `alerts` command's list: what, how grave, since when, why, what to do, who has seen it."""
    console = standard_output(120)
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
    console = standard_output(120, highlight=True)
    health = document["health"]
    console.print(
        f"{document['robot']}: {health['state'] if health else 'no replay has been assessed yet'}, model {document['model_revision']}"
    )
    if health and health.get("stale"):
        console.print(f"[yellow]{health['stale_why']}[/]", highlight=False)
    if document["friction"]:
        states = {joint["joint"]: joint["state"] for joint in health["joints"]} if health else {}
        old = {joint["joint"] for joint in health["joints"] if joint.get("stale")} if health else set()
        table = table_of(
            ("joint", "state", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "wear [%]", "rate [%/month]", "remaining life"), left=("state",)
        )
        for row in document["friction"]:
            state = states.get(row["joint"], "")
            table.add_row(
                str(row["joint"]),
                f"[{STATE_STYLE.get(state, 'white')}]{state}{' STALE' if row['joint'] in old else ''}",
                number(row.get("temperature_c"), ".1f"),
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


def print_conditions(title: str, found: list[tuple[str, str, str]]) -> None:
    """Every condition: its name, ok or NO or not checked, and what was found."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for column in ("condition", "holds", "found"):
        table.add_column(column, overflow="fold", no_wrap=column != "found")
    style = {"ok": "green", "NO": "bold red", "not checked": "yellow"}
    for name, word, told in found:
        table.add_row(name, Text(word, style=style[word]), Text(told))
    standard_output(140, highlight=True).print(table)
    failed = [name for name, word, _ in found if word == "NO"]
    print(f"the arm may not move: {', '.join(failed)}" if failed else "the arm may move")  # noqa: T201


def print_bus(found: list[dict[str, Any]]) -> None:
    """How far one gets on the bus, and what to do where it is not far enough."""
    console = standard_output(140)
    for row in found:
        word = "[green]ok[/]" if row["cause"] == "reached" else f"[bold yellow]{row['cause']}[/]"
        console.print(f"bus, {row['who']} at {escape(row['endpoint'])}: {word}: {escape(row['told'])}")


def print_not_alerting(joint: int, reasons: Sequence[str]) -> None:
    """Why a joint does not alert."""
    console = Console()
    console.print(f"joint {joint}: {'the highest tier stands' if not reasons else 'no further alert, for'}", highlight=False)
    for reason in reasons:
        console.print(f"  {reason}", highlight=False, markup=False)


def print_history(rows: list[dict[str, Any]], left_out: int) -> None:
    """The `history` command's table."""
    console = standard_output(120, highlight=True)
    if not rows:
        console.print("no replay has been assessed in that time")
        return
    table = table_of(
        ("recorded", "replay", "joint", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "F at v*, T0 [Nm]", "wear [%]"), left=("recorded",)
    )
    for row in rows:
        table.add_row(
            row["recorded_at"],
            str(row["replay"]),
            str(row["joint"]),
            number(row.get("temperature_c"), ".1f"),
            pair(row.get("coulomb_nm"), row.get("coulomb_std_nm")),
            pair(row.get("viscous_nm_s_per_rad"), row.get("viscous_std_nm_s_per_rad")),
            pair(row.get("reference_torque_nm"), row.get("reference_torque_std_nm")),
            f"{100 * row['wear']:+z.1f} ± {100 * row['wear_std']:.1f}",
        )
    console.print(table)
    if left_out:
        console.print(f"{left_out} earlier rows are left out: --limit, --from, --to, --joint", highlight=False)
