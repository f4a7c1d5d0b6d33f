"""The commands `serviced` and `inspected`, by which a person says what was done to an arm: while the daemon runs, and without it."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.options import Commands, ConfigOption, JsonOption, client_of, joint_number, load_configuration, print_json, refuse_no_time
from monitor.errors import BadInput, BusError, StoreError, StoreInUse

if TYPE_CHECKING:
    from monitor.config.schema import Configuration
    from monitor.publish.client import Client
    from monitor.publish.documents import Answer
    from monitor.publish.queries import ServicedRequest, UndoServicedRequest


def check_words(by: str, why: str, at: str | None, *, undo: bool) -> None:
    """Raises BadInput, before any history or daemon is asked: --by or --why is empty, --at stands beside --undo, or is no time."""
    for option, text in (("--by", by), ("--why", why)):
        if not text.strip():
            raise BadInput(f"{option} is empty: it is kept in the history, and somebody will ask")
    if undo and at is not None:
        raise BadInput("--at and --undo: a mistake is taken back as a whole; expected one of them")
    if at is not None:
        refuse_no_time("--at", at)


def declared(
    configuration: "Configuration", offline: Callable[[float], "Answer"], asked: Callable[["Client"], "Answer"], nothing_yet: str
) -> "Answer":
    """The answer of `offline`, which writes into the history where no daemon runs on it, at a time since 1970; else `asked` on the bus.

    nothing_yet : what it means that there is no history, for the message. Raises BadInput, BusError, StoreError.
    """
    from monitor.service.monitor_document import present_unix_s, read_monitor_document
    from monitor.store.backup import present

    where, refused = configuration.state_directory, None
    try:
        if present(where):
            return offline(present_unix_s(read_monitor_document(where), time.time()))  # a trial that is over has its own time
    except StoreError as error:  # a daemon has it, or this user may not write it: the daemon can be asked
        refused = error
    try:
        with client_of(configuration) as client:
            return asked(client)
    except BusError:
        if refused is None:
            raise StoreError(f"{where}: no history yet{nothing_yet}") from None
        if isinstance(refused, StoreInUse):
            raise
        raise refused from None


def serviced(
    config: ConfigOption,
    joint: Annotated[str, typer.Option("--joint", help="Number from the base, or name: 3 or elbow, 4 or wrist-1.", show_default=False)],
    by: Annotated[str, typer.Option("--by", help="Who did it, or says so: it is kept in the history.", show_default=False)],
    why: Annotated[str, typer.Option("--why", help="What was found and done.", show_default=False)],
    replaced: Annotated[bool, typer.Option("--replaced", help="Another joint is in its place: everything is learnt anew.")] = False,
    greased: Annotated[bool, typer.Option("--greased", help="Friction may have moved either way: the next replays show it.")] = False,
    overhauled: Annotated[bool, typer.Option("--overhauled", help="Likewise: gears, bearings, seals or brake.")] = False,
    undo: Annotated[bool, typer.Option("--undo", help="The last declared maintenance of this joint was a mistake.")] = False,
    at: Annotated[str | None, typer.Option("--at", help="When it was done: a date, or a time; else now.", show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """Say that a joint was replaced, greased or overhauled: its alerts end, or wait for their proof. Works without the daemon."""
    from monitor.publish.queries import ServicedRequest, UndoServicedRequest
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
        ", so there is nothing that maintenance could change; the first replay begins it",
    )
    if as_json:
        print_json(answer.model_dump(mode="json"))
        return
    assert answer.maintenance is not None
    typer.echo(f"{configuration.robot.id}: {'taken back: ' if undo else ''}{answer.maintenance.text}")
    for sentence in answer.text:
        typer.echo(f"  {sentence}")


def _asked(client: "Client", request: "ServicedRequest | UndoServicedRequest") -> "Answer":
    """The answer of a running daemon. Raises BadInput with its reason where it refuses, BusError where nobody answers."""
    from monitor.publish.queries import ServicedRequest

    if isinstance(request, ServicedRequest):
        return client.serviced(request.joint, request.kind, by=request.by, why=request.why, at=request.at)
    return client.undo_serviced(request.joint, by=request.by, why=request.why)


def inspected(
    config: ConfigOption,
    item: Annotated[str, typer.Argument(metavar="ITEM", help="Name of the check, as `joint-monitor status` shows it.", show_default=False)],
    by: Annotated[str, typer.Option("--by", help="Who did it, or says so: it is kept in the history.", show_default=False)],
    why: Annotated[str, typer.Option("--why", help="What was found.", show_default=False)],
    undo: Annotated[bool, typer.Option("--undo", help="The last record of this check was a mistake.")] = False,
    at: Annotated[str | None, typer.Option("--at", help="When it was done: a date, or a time; else now.", show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """Say that a check of [inspection] was made: its next due date counts from then. Works without the daemon."""
    from monitor.publish.queries import InspectedRequest, UndoInspectedRequest
    from monitor.service.history.inspection import offline

    check_words(by, why, at, undo=undo)
    configuration = load_configuration(config)
    request: InspectedRequest | UndoInspectedRequest
    request = UndoInspectedRequest(item=item, by=by, why=why) if undo else InspectedRequest(item=item, by=by, why=why, at=at)
    answer = declared(
        configuration,
        lambda now_unix_s: offline(configuration, request, now_unix_s),
        lambda client: client.inspected(request),
        "; the first start of `joint-monitor run` begins it",
    )
    if as_json:
        print_json(answer.model_dump(mode="json"))
        return
    for sentence in answer.text:
        typer.echo(f"{configuration.robot.id}: {'taken back: ' if undo else ''}{sentence}")


COMMANDS: Commands = {"serviced": serviced, "inspected": inspected}
