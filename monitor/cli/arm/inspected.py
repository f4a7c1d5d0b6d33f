"""The command `inspected`, by which a person says that a check was made: while the daemon runs, and without it."""

from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.arm.declaring import check_words, declared
from monitor.cli.options import Commands, ConfigOption, JsonOption, load_configuration, print_json

if TYPE_CHECKING:
    pass


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
    from monitor.publish.documents import InspectedRequest, UndoInspectedRequest
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
        print_json(answer)
        return
    for sentence in answer["text"]:
        typer.echo(f"{configuration.robot.id}: {'taken back: ' if undo else ''}{sentence}")


COMMANDS: Commands = {"inspected": inspected}
