"""The commands on the history: `schedule` (past and coming windows), `history`, `export`, `import`, and `query` in SQL."""

import math
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor.cli.options import (
    CONFIG_HELP,
    CONFIG_VARIABLE,
    ColumnsOption,
    Commands,
    ConfigOption,
    ForceOption,
    FromOption,
    IntervalOption,
    JsonOption,
    ManifestOption,
    RateOption,
    ToOption,
    joint_number,
    load_configuration,
    print_json,
    refuse_overwriting,
)
from monitor.cli.plant import plant_database
from monitor.errors import BadInput, StoreError

if TYPE_CHECKING:
    from monitor.store.store import Store
    from monitor.studies.query import Answer, Source

ROWS_PER_READ = 10_000  # the store gives its history in pages of at most so many rows
HISTORY_HELP = "An arm's history, a folder of many, or a plant's database; may be given again."
PLANT_HELP = "A plant's file: the histories of all its arms, from its database."
ARCHIVE_HELP = "s3://BUCKET/PREFIX or a folder: its recordings, without their histories."


def schedule(
    config: ConfigOption,
    count: Annotated[int, typer.Option(min=1, max=1000, help="So many windows to come.")] = 10,
    as_json: JsonOption = False,
) -> None:
    """The next windows, and what became of the last ones; works without the daemon."""
    from monitor.service.history.status import schedule_document
    from monitor.views.terminal.arm import borrowed_text

    configuration = load_configuration(config)
    settings, document = configuration.schedule, schedule_document(configuration, time.time(), count)
    if as_json:
        print_json(document)
        return
    count_text = f"{len(document['windows'])} windows to come"
    typer.echo(f"{configuration.robot.id}: {count_text}, {settings.timezone}; each is open for {settings.grace_s:g} s")
    if not document["motion_allowed"]:
        typer.echo("  nothing moves: [replay] allow_motion is not true, and every window is skipped")
    for row in document["last"]:
        typer.echo(f"  {row['window']}  {row['state']}{': ' + row['reason'] if row['reason'] else ''}")
        if row.get("borrowed"):
            typer.echo(f"    {borrowed_text(row['borrowed'])}")
        for number, each in enumerate(row.get("tries", ()), start=1):
            typer.echo(f"    try {number} ended {each['at']}: {each['reason']}")
    if document["due"]:
        typer.echo(f"  due since {document['due']['since']} ({document['due']['why']}): waits for the program's node")
    if needed := document.get("needed"):
        typer.echo(f"  replay = when_needed: the next one from {needed['needed_from'] or 'now'}, {needed['why']}")
    for window in document["windows"]:
        typer.echo(f"  {window['local']}  opens {window['opens']}  {window['why']}")
    if document["learning_until"]:
        typer.echo(f"  learning until {document['learning_until']}")
    for text in settings.blackout:
        typer.echo(f"  none on {text}")
    if not document["windows"]:
        typer.echo("  none within 400 days: [schedule] cron and every_h say none")


def history(
    config: ConfigOption,
    joint: Annotated[str | None, typer.Option(help="Only this one, by number or name: 3 or elbow.", show_default=False)] = None,
    since: FromOption = None,
    until: ToOption = None,
    limit: Annotated[int, typer.Option(min=1, max=1_000_000, help="The newest so many rows.")] = 24,
    as_json: JsonOption = False,
) -> None:
    """What was learnt of each joint, replay by replay; works without the daemon."""
    from monitor.publish.timestamps import outside
    from monitor.store.store import Store
    from monitor.views.terminal.arm import print_history

    configuration = load_configuration(config)
    number = None if joint is None else joint_number(joint, configuration.robot_description.joints)
    begin, end = _when(since, "--from"), _when(until, "--to")
    with Store.reader(configuration.state_directory) as store:
        rows = _all_rows(store, number, begin, end)
    shown: Any = outside(rows[-limit:])
    left_out = max(0, len(rows) - limit)
    if as_json:
        print_json({"robot": configuration.robot.id, "rows": shown, "left_out": left_out})
    else:
        print_history(shown, left_out, configuration.schedule.zone())


def export(
    config: ConfigOption,
    output: Annotated[Path, typer.Option("--output", "-o", help="A .csv or .parquet.", show_default=False)],
    what: Annotated[str, typer.Option(help="friction, ledger, events, assessments, or recording.")] = "friction",
    replay: Annotated[int | None, typer.Option(help="Which, for --what recording.", show_default=False)] = None,
    since: FromOption = None,
    until: ToOption = None,
    force: ForceOption = False,
) -> None:
    """The history as a table for other programs: CSV or Parquet, times in UTC; or one recording."""
    from monitor.service.history.transfer import export_recording, table, write_table
    from monitor.store.store import Store

    if output.suffix not in {".csv", ".parquet"}:
        raise BadInput(f"{output}: expected a name that ends in .csv or .parquet")
    if not output.parent.is_dir():
        raise BadInput(f"{output}: the folder {output.parent} does not exist")
    if (what == "recording") != (replay is not None):
        raise BadInput("--what recording and --replay NUMBER belong together; one of them is missing")
    refuse_overwriting(output, force)
    configuration = load_configuration(config)
    with Store.reader(configuration.state_directory, configuration.archive) as store:
        if replay is not None:
            typer.echo(f"{output}: replay {replay}, {export_recording(store, replay, output).samples} samples")
            return
        frame = table(store, what, _when(since, "--from"), _when(until, "--to"))
    write_table(frame, output)
    typer.echo(f"{output}: {len(frame)} rows of {what}")


def import_(
    config: ConfigOption,
    files: Annotated[list[Path] | None, typer.Argument(metavar="[FILE…]", help="Recordings of this arm.", show_default=False)] = None,
    manifest: ManifestOption = None,
    interval: IntervalOption = None,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    as_json: JsonOption = False,
) -> None:
    """Recordings made elsewhere into the history, judged in time order and marked as imported. The daemon must not run."""
    from monitor.service.history.transfer import import_recordings
    from monitor.store.from_files.series import given_entries
    from monitor.store.store import Store
    from monitor.views.terminal.progress import status as status_line

    configuration = load_configuration(config)
    entries = given_entries(files or [], manifest, interval)
    with status_line(f"importing {len(entries)} recordings"), Store.open(configuration.state_directory) as store:
        if store.ledger.unfinished():
            raise StoreError("the last run left a replay half-way: start `joint-monitor run` once, so that it is finished first")
        outcome = import_recordings(store, configuration, entries, columns, rate)
    if as_json:
        print_json({"robot": configuration.robot.id, **outcome})
        return
    typer.echo(
        f"{configuration.robot.id}: {outcome['assessed']} assessed, {len(outcome['rejected'])} rejected, "
        f"{outcome['known_already']} known already"
    )
    for each in outcome["rejected"]:
        typer.echo(f"  {each['file']}: {each['reason']}")


def _all_rows(store: "Store", joint: int | None, begin_unix_s: float | None, end_unix_s: float | None) -> list[dict[str, Any]]:
    """The rows of the history in a span of time, oldest first; of one joint (from 1), or of all."""
    rows: list[dict[str, Any]] = []
    after: int | None = 0
    while after is not None:
        page, after = store.assessments.history(
            joint=joint, from_unix_s=begin_unix_s, to_unix_s=end_unix_s, after=after, limit=ROWS_PER_READ
        )
        rows += page
    return rows


def _when(text: str | None, option: str) -> float | None:
    """The time of an option, in seconds since 1970; None where the option is absent. Raises BadInput."""
    from monitor.store.from_files.series import when

    return None if text is None else when(text, option)


def query(
    sql: Annotated[str, typer.Argument(metavar="SQL", help="One question to friction, events, ledger, recordings, or replay(NUMBER).")],
    config: Annotated[
        list[Path] | None,
        typer.Option("--config", "-c", help=CONFIG_HELP, envvar=CONFIG_VARIABLE, show_default=False),
    ] = None,
    history: Annotated[list[Path] | None, typer.Option(help=HISTORY_HELP, show_default=False)] = None,
    plant: Annotated[Path | None, typer.Option(help=PLANT_HELP, show_default=False)] = None,
    archive: Annotated[str | None, typer.Option(help=ARCHIVE_HELP, show_default=False)] = None,
    endpoint: Annotated[str | None, typer.Option(help="Of the archive's server; else $AWS_ENDPOINT_URL.", show_default=False)] = None,
    begin: FromOption = None,
    end: ToOption = None,
    limit: Annotated[int, typer.Option(min=1, max=10_000_000, help="At most so many rows of the answer.")] = 1000,
    csv: Annotated[bool, typer.Option("--csv", help="Comma-separated, with a header.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Ask histories and recordings in SQL (DuckDB); reads only, also while a daemon runs."""
    from monitor.studies.query import PlantSource, ask, plain, unique
    from monitor.views.terminal.progress import status as status_line

    if csv and as_json:
        raise BadInput("--csv and --json are both given; expected one of them")
    sources = _sources(config or [], history or [], archive, endpoint)
    if not sources and plant is None:
        raise BadInput("query: nothing to ask: expected --config FILE, --history FOLDER, --plant FILE or --archive ADDRESS")
    span = (_when(begin, "--from"), _when(end, "--to"))
    if plant is None and span != (None, None):
        raise BadInput("query: --from and --to are for --plant, which may hold years of many arms; expected a WHERE in the question")
    with ExitStack() as opened:
        if plant is not None:
            since, until = (-math.inf if span[0] is None else span[0]), (math.inf if span[1] is None else span[1])
            sources.append(PlantSource(opened.enter_context(plant_database(plant, migrates=False)), since, until))
        opened.enter_context(status_line(f"reading {len(sources)} sources"))
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
    """What is asked beside a plant, each once."""
    from monitor.store.archive.places import ArchiveSettings
    from monitor.studies.query import ArchiveSource, ArmSource, sources_at

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


COMMANDS: Commands = {"schedule": schedule, "history": history, "export": export, "import": import_, "query": query}
