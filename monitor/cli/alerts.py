"""The commands on alerts, which ask a running daemon (`alerts`, `ack`, `unack`, `shelve`, `unshelve`), and `schema`."""

from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.options import Commands, ConfigOption, JsonOption, client_of, load_configuration, print_json
from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.publish.client import Client

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
    with client_of(load_configuration(config)) as client:
        name, joint, condition = _active_alert(client, alert)
        done = client.acknowledge(joint, condition, by=by, why=why).model_dump(mode="json")
    if as_json:
        print_json(done)
        return
    [*_, last] = done["acknowledgements"]
    typer.echo(f"{name}: acknowledged by {last['by']} at {last['at']}")
    if last["by"] != done["acknowledged_by"] or last["at"] != done["acknowledged_at"]:
        typer.echo(f"  it was acknowledged before by {done['acknowledged_by']} at {done['acknowledged_at']}, which stays")
    if not done["active"]:
        typer.echo(f"  cleared: {done['cleared_why']}")


def unack(config: ConfigOption, alert: AlertArgument, by: ByOption, why: WhyOption = "", as_json: JsonOption = False) -> None:
    """Take the acknowledgements of an alert back: it waits for a person again. Who acknowledged it stays on record."""
    with client_of(load_configuration(config)) as client:
        name, joint, condition = _active_alert(client, alert)
        done = client.unacknowledge(joint, condition, by=by, why=why).model_dump(mode="json")
    if as_json:
        print_json(done)
    else:
        typer.echo(f"{name}: not acknowledged any more; it waits for a person again")


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
    with client_of(load_configuration(config)) as client:
        name, joint, condition = _active_alert(client, alert)
        done = client.shelve(joint, condition, hours=hours, by=by, why=why).model_dump(mode="json")
    if as_json:
        print_json(done)
    else:
        typer.echo(f"{name}: shelved by {done['shelved_by']} until {done['shelved_until']}")


def unshelve(config: ConfigOption, alert: AlertArgument, by: ByOption, why: WhyOption = "", as_json: JsonOption = False) -> None:
    """End the shelving of an alert: it is shown again from now on."""
    with client_of(load_configuration(config)) as client:
        name, joint, condition = _active_alert(client, alert)
        done = client.unshelve(joint, condition, by=by, why=why).model_dump(mode="json")
    if as_json:
        print_json(done)
    else:
        typer.echo(f"{name}: shown again")


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
