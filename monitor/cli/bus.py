"""The commands `alerts`, `ack` and `shelve`, which ask a running daemon, and `schema`, which prints the form of its documents."""

from typing import Annotated

import typer

from monitor.cli.options import Commands, ConfigOption, JsonOption, client_of, load_configuration, print_json
from monitor.errors import BadInput

AlertArgument = Annotated[str, typer.Argument(metavar="ALERT", help="As `alerts` names it, e.g. j3/wear_rising or arm/common_mode.")]
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

    with client_of(load_configuration(config)) as client:
        documents = [alert.model_dump(mode="json") for alert in client.alerts(cleared=cleared)]
    if as_json:
        print_json({"alerts": documents})
    else:
        print_alerts(documents)


def ack(config: ConfigOption, alert: AlertArgument, by: ByOption, why: WhyOption = "", as_json: JsonOption = False) -> None:
    """Acknowledge an alert: somebody has seen it. It clears by itself once its condition is gone."""
    joint, condition = _joint_and_condition(alert)
    with client_of(load_configuration(config)) as client:
        done = client.acknowledge(joint, condition, by=by, why=why).model_dump(mode="json")
    if as_json:
        print_json(done)
    else:
        typer.echo(f"{alert}: acknowledged by {done['acknowledged_by']} at {done['acknowledged_at']}")


def shelve(
    config: ConfigOption,
    alert: AlertArgument,
    hours: Annotated[float, typer.Option(help="For so long it need not be shown.", show_default=False)],
    by: ByOption,
    why: WhyOption = "",
    as_json: JsonOption = False,
) -> None:
    """Shelve an alert: it stays active, and need not be shown for some hours."""
    joint, condition = _joint_and_condition(alert)
    if not 0.0 < hours <= 24.0 * LONGEST_SHELVING_DAYS:
        raise BadInput(f"--hours {hours:g}: expected more than 0, at most {24 * LONGEST_SHELVING_DAYS} ({LONGEST_SHELVING_DAYS} days)")
    with client_of(load_configuration(config)) as client:
        done = client.shelve(joint, condition, hours=hours, by=by, why=why).model_dump(mode="json")
    if as_json:
        print_json(done)
    else:
        typer.echo(f"{alert}: shelved by {done['shelved_by']} until {done['shelved_until']}")


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


def _joint_and_condition(alert: str) -> tuple[int | None, str]:
    """Joint (from 1; None: the arm) and condition of an alert's name: `j3/wear_rising` gives (3, "wear_rising"). Raises BadInput."""
    place, _, condition = alert.partition("/")
    if not condition or not (place == "arm" or (place[:1] == "j" and place[1:].isascii() and place[1:].isdigit())):
        raise BadInput(f"alert {alert!r}: expected j1/CONDITION … j6/CONDITION or arm/CONDITION, as `joint-monitor alerts` names them")
    return (None if place == "arm" else int(place[1:])), condition


COMMANDS: Commands = {"alerts": alerts, "ack": ack, "shelve": shelve, "schema": schema}
