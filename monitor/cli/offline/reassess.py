"""The command `reassess`, which judges the past of an arm, a site or a plant once more, on many processes."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import Commands, JsonOption, print_json
from monitor.errors import BadInput

INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it


def reassess(
    histories: Annotated[
        list[Path],
        typer.Argument(metavar="HISTORY…", help="A history's folder, a folder of such, or an arm's TOML file.", show_default=False),
    ],
    settings: Annotated[
        Path | None, typer.Option(help="TOML: its keys of assessment replace those of then; else as then.", show_default=False)
    ] = None,
    results: Annotated[str, typer.Option(help="Folder or address (s3://…) where finished arm-months are kept and found.")] = "var/reassess",
    scheduler: Annotated[
        str | None, typer.Option(help="Of a Dask cluster, e.g. tcp://host:8786; else processes of this machine.", show_default=False)
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes of this machine; one a core.", show_default=False)] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for a picture of each arm of which something else would be said.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """The past by today's program or other settings: which alerts come earlier, later, no more, or anew. Exit 1: one arm failed."""
    from monitor.studies.reassess.reassess import reassess as again
    from monitor.studies.reassess.settings import read_changes
    from monitor.views.plots.picture import needs_drawing
    from monitor.views.terminal.progress import count_progress
    from monitor.views.terminal.reassess import print_reassessment

    if scheduler is not None and workers is not None:
        raise BadInput("--workers is of this machine's processes, --scheduler is of another cluster; expected one of them")
    if pictures is not None:
        needs_drawing("--pictures")
        if pictures.exists() and not pictures.is_dir():
            raise BadInput(f"--pictures {pictures}: is a file; expected a folder")
    changes = {} if settings is None else read_changes(settings)
    try:
        with count_progress("reassess", "recordings") as show:
            document = again(histories, results=results, changes=changes, scheduler=scheduler, workers=workers, show=show)
    except KeyboardInterrupt:
        typer.echo(f"joint-monitor: stopped; what is finished is kept in {results}: the same command goes on from there", err=True)
        raise typer.Exit(INTERRUPTED) from None
    drawn = []
    if pictures is not None:
        from monitor.views.plots.reassess import draw_arms

        drawn = [str(path) for path in draw_arms(pictures, document)]
    if as_json:
        print_json(document | {"pictures": drawn}, indent=None)
    else:
        print_reassessment(document, drawn)
    if document["failed"]:
        raise typer.Exit(1)


COMMANDS: Commands = {"reassess": reassess}
