"""The command `serviced`, by which a person says what was done to a joint: while the daemon runs, and without it."""

from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.arm.declaring import check_words, declared
from monitor.cli.options import Commands, ConfigOption, JsonOption, joint_number, load_configuration, print_json
from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.publish.client import Client
    from monitor.publish.documents import Answer, ServicedRequest, UndoServicedRequest


def serviced(
    config: ConfigOption,
    joint: Annotated[str, typer.Option("--joint", help="Number from the base, or name: 3 or elbow, 4 or wrist-1.", show_default=False)],
    by: Annotated[str, typer.Option("--by", help="Who did it, or says so: it is kept in the history.", show_default=False)],
    why: Annotated[str, typer.Option("--why", help="What was found and done.", show_default=False)],
    replaced: Annotated[bool, typer.Option("--replaced", help="Another joint is in its place: everything is learnt anew.")] = False,
    greased: Annotated[bool, typer.Option("--greased", help="Friction may have moved either way: the next replays show it.")] = False,
    overhauled: Annotated[bool, typer.Option("--overhauled", help="Likewise: gears, bearings, seals or brake.")] = False,
    undo: Annotated[bool, typer.Option("--undo", help="The last declared work on this joint was a mistake.")] = False,
    at: Annotated[str | None, typer.Option("--at", help="When it was done: a date, or a time; else now.", show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """Say that a joint was replaced, greased or overhauled: its alerts end, or wait for their proof. Works without the daemon."""
    from monitor.publish.documents import ServicedRequest, UndoServicedRequest
    from monitor.service.history.maintenance import offline

    chosen = [name for name, given in (("replaced", replaced), ("greased", greased), ("overhauled", overhauled), ("undo", undo)) if given]
    if len(chosen) != 1:
        raise BadInput("serviced: expected one of --replaced, --greased, --overhauled or --undo")
    check_words(by, why, at, undo=undo)
    configuration = load_configuration(config)
    number = joint_number(joint, configuration.robot_description.joints)
    request: ServicedRequest | UndoServicedRequest
    if undo:
        request = UndoServicedRequest(joint=number, by=by, why=why)
    else:
        request = ServicedRequest(joint=number, kind=chosen[0], by=by, why=why, at=at)
    answer = declared(
        configuration,
        lambda now_unix_s: offline(configuration, request, now_unix_s),
        lambda client: _asked(client, request),
        ", so there is nothing that work could change; the first replay begins it",
    )
    if as_json:
        print_json(answer)
        return
    typer.echo(f"{configuration.robot.id}: {'taken back: ' if undo else ''}{answer['work']['text'].split(').')[0]}).")
    for sentence in answer["text"]:
        typer.echo(f"  {sentence}")


def _asked(client: "Client", request: "ServicedRequest | UndoServicedRequest") -> "Answer":
    """The answer of a running daemon. Raises BadInput with its reason where it refuses, BusError where nobody answers."""
    from monitor.publish.documents import ServicedRequest

    if isinstance(request, ServicedRequest):
        return client.serviced(request.joint, request.kind, by=request.by, why=request.why, at=request.at)
    return client.undo_serviced(request.joint, by=request.by, why=request.why)


COMMANDS: Commands = {"serviced": serviced}
