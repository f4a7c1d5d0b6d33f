"""The commands on alerts, which ask a running daemon (`alerts`, `ack`, `unack`, `shelve`, `unshelve`), and `schema`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor.cli.options import Commands, ConfigOption, JsonOption, client_of, load_configuration, print_json
from monitor.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from monitor.publish.client import Client
    from monitor.publish.documents import Alert

AlertArgument = Annotated[
    str, typer.Argument(metavar="ALERT", help="As `alerts` names it, e.g. j3/wear_rising or arm/common_mode; the beginning is enough: j3.")
]

ByOption = Annotated[str, typer.Option("--by", help="Who acts: it is kept with the alert.", show_default=False)]

WhyOption = Annotated[str, typer.Option("--why", help="Why: for whoever reads it later.")]

LONGEST_SHELVING_DAYS = 90  # `cmd/shelve` on the bus has the same bound: an alert must come back before it is forgotten


def alerts(
    config: ConfigOption,
    cleared: Annotated[bool, typer.Option("--all", help="Also the last cleared one of each condition.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List the alerts of a running daemon. Exit 0 whether there are any or not."""
    from monitor.views.terminal.arm import print_alerts

    configuration = load_configuration(config)
    with client_of(configuration) as client:
        documents = [alert.model_dump(mode="json") for alert in client.alerts(cleared=cleared)]
    if as_json:
        print_json({"alerts": documents})
    else:
        print_alerts(documents, configuration.schedule.zone())


def ack(config: ConfigOption, alert: AlertArgument, by: ByOption, why: WhyOption = "", as_json: JsonOption = False) -> None:
    """Acknowledge an alert: somebody has seen it. It clears by itself once its condition is gone."""
    _act(config, alert, as_json, lambda client, which: client.acknowledge(*which, by=by, why=why), _acknowledged)


def unack(config: ConfigOption, alert: AlertArgument, by: ByOption, why: WhyOption = "", as_json: JsonOption = False) -> None:
    """Take the acknowledgements of an alert back: it waits for a person again. Who acknowledged it stays on record."""
    said = "not acknowledged any more; it waits for a person again"
    _act(config, alert, as_json, lambda client, which: client.unacknowledge(*which, by=by, why=why), lambda _: said)


def shelve(
    config: ConfigOption,
    alert: AlertArgument,
    hours: Annotated[float, typer.Option(help="For so long it need not be shown.", show_default=False)],
    by: ByOption,
    why: WhyOption = "",
    as_json: JsonOption = False,
) -> None:
    """Shelve an alert: it stays active, and need not be shown for some hours."""
    if not 0.0 < hours <= 24.0 * LONGEST_SHELVING_DAYS:
        raise BadInput(f"--hours {hours:g}: expected more than 0, at most {24 * LONGEST_SHELVING_DAYS} ({LONGEST_SHELVING_DAYS} days)")

    def shelved(done: dict[str, Any]) -> str:
        return f"shelved by {done['shelved_by']} until {done['shelved_until']}"

    _act(config, alert, as_json, lambda client, which: client.shelve(*which, hours=hours, by=by, why=why), shelved)


def unshelve(config: ConfigOption, alert: AlertArgument, by: ByOption, why: WhyOption = "", as_json: JsonOption = False) -> None:
    """End the shelving of an alert: it is shown again from now on."""
    _act(config, alert, as_json, lambda client, which: client.unshelve(*which, by=by, why=why), lambda _: "shown again")


def _act(
    config: Path,
    given: str,
    as_json: bool,
    send: "Callable[[Client, tuple[int | None, str]], Alert]",
    said: "Callable[[dict[str, Any]], str]",
) -> None:
    """Do something to the active alert that is `given`, and print the alert after it, or what is said of it."""
    with client_of(load_configuration(config)) as client:
        name, joint, condition = _active_alert(client, given)
        done = send(client, (joint, condition)).model_dump(mode="json")
    if as_json:
        print_json(done)
    else:
        typer.echo(f"{name}: {said(done)}")


def _acknowledged(done: dict[str, Any]) -> str:
    [*_, last] = done["acknowledgements"]
    lines = [f"acknowledged by {last['by']} at {last['at']}"]
    if last["by"] != done["acknowledged_by"] or last["at"] != done["acknowledged_at"]:
        lines.append(f"  it was acknowledged before by {done['acknowledged_by']} at {done['acknowledged_at']}, which stays")
    if not done["active"]:
        lines.append(f"  cleared: {done['cleared_why']}")
    return "\n".join(lines)


def schema(
    kind: Annotated[
        str | None, typer.Argument(metavar="KIND", help="Of document; without it the kinds are listed.", show_default=False)
    ] = None,
) -> None:
    """Print the JSON Schema of a published document."""
    from monitor.publish.registry import KINDS
    from monitor.publish.registry import schema as schema_of

    if kind is None:
        for name, registered in KINDS.items():
            typer.echo(f"{name:16} {(registered.model.__doc__ or '').strip().splitlines()[0]}")
        return
    if kind not in KINDS:
        raise BadInput(f"kind {kind!r} is not known; known are {', '.join(KINDS)}")
    print_json(schema_of(kind))


def _active_alert(client: "Client", given: str) -> tuple[str, int | None, str]:
    """Name, joint (from 1; None: the arm) and condition of the active alert that `j3/wear_rising`, `j3/wear` or `j3` names.

    Raises BadInput where none begins so, or several do: the message lists the active ones.
    """
    place, _, condition = given.strip().casefold().partition("/")
    if not (place == "arm" or (place[:1] == "j" and place[1:].isascii() and place[1:].isdigit())):
        raise BadInput(f"alert {given!r}: expected j1/CONDITION … j6/CONDITION or arm/CONDITION, as `joint-monitor alerts` names them")
    joint = None if place == "arm" else int(place[1:])
    active = client.alerts()
    found = [each for each in active if each.joint == joint and each.condition == condition]
    found = found or [each for each in active if each.joint == joint and each.condition.startswith(condition.replace("-", "_"))]
    if len(found) != 1:
        names = ", ".join(f"{'arm' if each.joint is None else f'j{each.joint}'}/{each.condition}" for each in active) or "none"
        raise BadInput(f"{given!r} names {'no active alert' if not found else f'{len(found)} active alerts'}; active: {names}")
    return f"{place}/{found[0].condition}", joint, found[0].condition


COMMANDS: Commands = {"alerts": alerts, "ack": ack, "unack": unack, "shelve": shelve, "unshelve": unshelve, "schema": schema}
