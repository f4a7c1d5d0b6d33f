"""The command `serviced`, by which a person says what was done to a joint: while the daemon runs, and without it."""

import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor.cli.options import Commands, ConfigOption, JsonOption, client_of, joint_number, load_configuration, print_json
from monitor.errors import BadInput, BusError, StoreError, StoreInUse

if TYPE_CHECKING:
    from monitor.config.schema import Configuration
    from monitor.publish.documents import ServicedRequest, UndoServicedRequest


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

    chosen = [name for name, given in (("replaced", replaced), ("greased", greased), ("overhauled", overhauled), ("undo", undo)) if given]
    if len(chosen) != 1:
        raise BadInput("serviced: expected one of --replaced, --greased, --overhauled or --undo")
    for option, text in (("--by", by), ("--why", why)):
        if not text.strip():
            raise BadInput(f"{option} is empty: it is kept in the history, and somebody will ask")
    if undo and at is not None:
        raise BadInput("--at and --undo: a mistake is taken back as a whole; expected one of them")
    if at is not None:
        _refuse_no_time(at)
    configuration = load_configuration(config)
    number = joint_number(joint, configuration.robot_description.joints)
    request: ServicedRequest | UndoServicedRequest
    if undo:
        request = UndoServicedRequest(joint=number, by=by, why=why)
    else:
        request = ServicedRequest(joint=number, kind=chosen[0], by=by, why=why, at=at)
    answer = _declared(configuration, request)
    if as_json:
        print_json(answer)
        return
    typer.echo(f"{configuration.robot.id}: {'taken back: ' if undo else ''}{answer['work']['text'].split(').')[0]}).")
    for sentence in answer["text"]:
        typer.echo(f"  {sentence}")


def _refuse_no_time(at: str) -> None:
    """Raises BadInput where a text is no date or time, before any history or daemon is asked."""
    from monitor.publish.timestamps import unix_s

    try:
        unix_s(at)
    except ValueError:
        raise BadInput(f"--at {at!r}: not a date or time; expected e.g. 2026-01-31 or 2026-01-31T14:00:00Z") from None


def _declared(configuration: "Configuration", request: "ServicedRequest | UndoServicedRequest") -> dict[str, Any]:
    """The answer: written into the history where no daemon runs on it, else asked for on the bus. Raises BadInput, BusError, StoreError."""
    from monitor.service.history.work import offline
    from monitor.service.monitor_document import present_unix_s, read_monitor_document
    from monitor.store.backup import present

    refused: StoreError | None = None
    try:
        if present(configuration.state_directory):
            now = present_unix_s(read_monitor_document(configuration.state_directory), time.time())  # a trial that is over has its own time
            return offline(configuration, request, now)
    except StoreError as error:  # a daemon has it, or this user may not read it: the daemon can be asked
        refused = error
    try:
        return _asked(configuration, request)
    except BusError:
        if refused is None:
            where = configuration.state_directory
            raise StoreError(f"{where}: no history yet, so there is nothing that work could change; the first replay begins it") from None
        if isinstance(refused, StoreInUse):
            raise
        raise refused from None


def _asked(configuration: "Configuration", request: "ServicedRequest | UndoServicedRequest") -> dict[str, Any]:
    """The answer of a running daemon. Raises BadInput with its reason where it refuses, BusError where nobody answers."""
    from monitor.publish.documents import ServicedRequest

    with client_of(configuration) as client:
        if isinstance(request, ServicedRequest):
            answer = client.serviced(request.joint, request.kind, by=request.by, why=request.why, at=request.at)
        else:
            answer = client.undo_serviced(request.joint, by=request.by, why=request.why)
        return answer.model_dump(mode="json")


COMMANDS: Commands = {"serviced": serviced}
