"""The command `query`: questions in SQL over histories and recordings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.options import CONFIG_HELP, CONFIG_VARIABLE, Commands, JsonOption, load_configuration, print_json
from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.service.history.query import Answer, Source

HISTORY_HELP = "An arm's history, a folder of many, or a plant's database; may be given again."
ARCHIVE_HELP = "s3://BUCKET/PREFIX or a folder: its recordings, without their histories."


def query(
    sql: Annotated[str, typer.Argument(metavar="SQL", help="One question to friction, events, ledger, recordings, or replay(NUMBER).")],
    config: Annotated[
        list[Path] | None,
        typer.Option("--config", "-c", help=CONFIG_HELP, envvar=CONFIG_VARIABLE, show_default=False),
    ] = None,
    history: Annotated[list[Path] | None, typer.Option(help=HISTORY_HELP, show_default=False)] = None,
    archive: Annotated[str | None, typer.Option(help=ARCHIVE_HELP, show_default=False)] = None,
    endpoint: Annotated[str | None, typer.Option(help="Of the archive's server; else $AWS_ENDPOINT_URL.", show_default=False)] = None,
    limit: Annotated[int, typer.Option(min=1, max=10_000_000, help="At most so many rows of the answer.")] = 1000,
    csv: Annotated[bool, typer.Option("--csv", help="Comma-separated, with a header.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Ask histories and recordings in SQL (DuckDB); reads alone, beside a running daemon."""
    from monitor.service.history.query import ask, plain, unique
    from monitor.views.terminal.progress import status as status_line

    if csv and as_json:
        raise BadInput("--csv and --json are both given; expected one of them")
    sources = _sources(config or [], history or [], archive, endpoint)
    with status_line(f"reading {len(sources)} sources"):
        answer = ask(sql, sources, limit)
    rows = [[plain(value) for value in row] for row in answer.rows]
    if as_json:
        names = unique(answer.columns)
        print_json({"columns": names, "rows": [dict(zip(names, row, strict=True)) for row in rows], "more": answer.more}, indent=None)
        return
    if csv:
        _print_csv(answer.columns, rows)
    else:
        _print_table(answer)
    if answer.more:
        typer.echo(f"the first {limit} rows; --limit gives more", err=True)


def _sources(config: list[Path], history: list[Path], archive: str | None, endpoint: str | None) -> "list[Source]":
    """What is asked, each once. Raises BadInput where nothing is named."""
    from monitor.service.history.query import ArchiveSource, ArmSource, sources_at
    from monitor.store.archive.settings import ArchiveSettings

    found: dict[object, Source] = {}
    for path in config:
        settings = load_configuration(path)
        directory = settings.state_directory
        found[directory] = ArmSource(directory, settings.robot.site, settings.robot.id, settings.archive)
    for path in history:
        for source in sources_at(path):
            found.setdefault(source.directory.resolve() if isinstance(source, ArmSource) else source, source)
    if archive is not None:
        address = archive if "://" in archive else str(Path(archive).resolve())
        found[address] = ArchiveSource(ArchiveSettings(address=address, endpoint=endpoint or ""))
    if not found:
        raise BadInput("query: nothing to ask: expected --config FILE, --history FOLDER or --archive ADDRESS")
    return list(found.values())


def _print_csv(columns: tuple[str, ...], rows: list[list[object]]) -> None:
    import csv
    import io
    import json

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([json.dumps(value) if isinstance(value, list | dict | bool) else value for value in row] for row in rows)
    typer.echo(text.getvalue(), nl=False)


def _print_table(answer: "Answer") -> None:
    from monitor.views.terminal.answer import print_answer

    print_answer(answer.columns, answer.rows)


COMMANDS: Commands = {"query": query}
