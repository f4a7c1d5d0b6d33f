"""The commands of a service that lasts: `schedule`, `history`, `export`, `import`."""

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor.errors import BadInput, StoreError

if TYPE_CHECKING:
    from monitor.config.load import Configuration

ConfigOption = Annotated[Path, typer.Option("--config", "-c", help="The robot's TOML file.", show_default=False)]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]
FromOption = Annotated[str | None, typer.Option("--from", help="Time, e.g. 2026-01-31 or 2026-01-31T03:00:00Z.", show_default=False)]
ToOption = Annotated[str | None, typer.Option("--to", help="Time, not included.", show_default=False)]


def schedule(
    config: ConfigOption,
    count: Annotated[int, typer.Option(min=1, max=1000, help="So many windows to come.")] = 10,
    as_json: JsonOption = False,
) -> None:
    """The next windows, and what became of the last ones; works without the daemon."""
    from contextlib import ExitStack
    from datetime import datetime

    from monitor.acquire.schedule.windows import DAY_S, expected
    from monitor.config.load import load
    from monitor.publish.timestamps import rfc3339
    from monitor.store.backup import present
    from monitor.store.database import Store

    configuration = load(config)
    settings, now = configuration.schedule, time.time()
    with ExitStack() as stack:
        store = stack.enter_context(Store.reader(configuration.state_directory)) if present(configuration.state_directory) else None
        began, last = (None, []) if store is None else (store.began_unix_s(), store.ledger(limit=5))
        found = expected(settings, now, count, store, configuration.key_prefix)
    zone = settings.zone()
    learning = settings.learning_every_h > 0 and settings.learning_days > 0
    document: dict[str, Any] = {
        "robot": configuration.robot.id,
        "timezone": settings.timezone,
        "motion_allowed": configuration.replay.allow_motion is True,
        "learning_until": rfc3339(began + settings.learning_days * DAY_S) if learning and began is not None else None,
        "windows": [
            {
                "window": rfc3339(window.key_unix_s),
                "opens": rfc3339(window.opens_unix_s),
                "closes": rfc3339(window.closes_unix_s),
                "local": datetime.fromtimestamp(window.opens_unix_s, tz=zone).strftime("%a %Y-%m-%d %H:%M"),
                "why": window.why,
            }
            for window in found
        ],
        "blackout": list(settings.blackout),
        "last": [
            {"replay": row.id, "window": rfc3339(row.window_unix_s), "kind": row.kind, "state": row.state, "reason": row.reason}
            for row in last
        ],
    }
    if as_json:
        _print_json(document)
        return
    typer.echo(f"{configuration.robot.id}: {len(found)} windows to come, {settings.timezone}; each is open for {settings.grace_s:g} s")
    if not document["motion_allowed"]:
        typer.echo("  nothing moves: [replay] allow_motion is not true, and every window is skipped")
    for row in document["last"]:
        typer.echo(f"  {row['window']}  {row['state']}{': ' + row['reason'] if row['reason'] else ''}")
    for window in document["windows"]:
        typer.echo(f"  {window['local']}  opens {window['opens']}  {window['why']}")
    if document["learning_until"]:
        typer.echo(f"  learning until {document['learning_until']}")
    for text in settings.blackout:
        typer.echo(f"  none on {text}")
    if not found:
        typer.echo("  none within 400 days: [schedule] cron and every_h say none")


def history(
    config: ConfigOption,
    joint: Annotated[int | None, typer.Option(min=1, max=8, help="Only this one.", show_default=False)] = None,
    since: FromOption = None,
    until: ToOption = None,
    limit: Annotated[int, typer.Option(min=1, max=1_000_000, help="The newest so many rows.")] = 24,
    as_json: JsonOption = False,
) -> None:
    """What was learnt of each joint, replay by replay; works without the daemon."""
    from monitor.config.load import load
    from monitor.publish.timestamps import outside
    from monitor.store.database import Store
    from monitor.views.terminal.tables import print_history

    configuration = load(config)
    begin, end = _when(since, "--from"), _when(until, "--to")
    with Store.reader(configuration.state_directory) as store:
        rows, after = [], 0
        while True:
            page, following = store.history(joint=joint, from_unix_s=begin, to_unix_s=end, after=after, limit=10_000)
            rows += page
            if following is None:
                break
            after = following
    told: Any = outside(rows[-limit:])
    if as_json:
        _print_json({"robot": configuration.robot.id, "rows": told, "left_out": max(0, len(rows) - limit)})
    else:
        print_history(told, max(0, len(rows) - limit))


def export(
    config: ConfigOption,
    output: Annotated[Path, typer.Option("--output", "-o", help="A .csv or .parquet.", show_default=False)],
    what: Annotated[str, typer.Option(help="friction, ledger, events, assessments, or recording.")] = "friction",
    replay: Annotated[int | None, typer.Option(help="Which, for --what recording.", show_default=False)] = None,
    since: FromOption = None,
    until: ToOption = None,
) -> None:
    """The history as a table for other programs: CSV or Parquet, times in UTC; or one recording."""
    from monitor.service.transfer import export_recording, table, write_table
    from monitor.store.database import Store

    if output.suffix not in {".csv", ".parquet"}:
        raise BadInput(f"{output}: expected a name that ends in .csv or .parquet")
    if not output.parent.is_dir():
        raise BadInput(f"{output}: the folder {output.parent} does not exist")
    if (what == "recording") != (replay is not None):
        raise BadInput("--what recording and --replay NUMBER belong together; one of them is missing")
    with Store.reader(_configuration(config).state_directory) as store:
        if replay is not None:
            typer.echo(f"{output}: replay {replay}, {export_recording(store, replay, output).samples} samples")
            return
        frame = table(store, what, _when(since, "--from"), _when(until, "--to"))
    write_table(frame, output)
    typer.echo(f"{output}: {len(frame)} rows of {what}")


def import_(
    config: ConfigOption,
    files: Annotated[list[Path] | None, typer.Argument(metavar="[FILE…]", help="Recordings of this arm.", show_default=False)] = None,
    manifest: Annotated[Path | None, typer.Option(help="CSV: file, recorded_at[, payload_kg, mounting, note].", show_default=False)] = None,
    interval: Annotated[str | None, typer.Option(help="Files say no time: they are so far apart, e.g. 1d.", show_default=False)] = None,
    columns: Annotated[str | None, typer.Option(help="Names and widths for files without RTDE names.", show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """Recordings made elsewhere into the history, judged in time order and marked as imported. The daemon must not run."""
    from monitor.service.transfer import import_recordings
    from monitor.store.database import Store
    from monitor.store.series import given_entries
    from monitor.views.terminal.tables import status as status_line

    configuration = _configuration(config)
    entries = given_entries(files or [], manifest, interval)
    with status_line(f"importing {len(entries)} recordings"), Store.open(configuration.state_directory) as store:
        if store.unfinished():
            raise StoreError("the last run left a replay half-way: start `joint-monitor run` once, so that it is finished first")
        told = import_recordings(store, configuration, entries, columns)
    if as_json:
        _print_json({"robot": configuration.robot.id, **told})
        return
    typer.echo(
        f"{configuration.robot.id}: {told['assessed']} assessed, {len(told['rejected'])} rejected, {told['known_already']} known already"
    )
    for each in told["rejected"]:
        typer.echo(f"  {each['file']}: {each['reason']}")


def _configuration(path: Path) -> "Configuration":
    from monitor.config.load import load

    return load(path)


def _when(text: str | None, option: str) -> float | None:
    from monitor.store.series import when

    return None if text is None else when(text, option)


def _print_json(document: Any) -> None:
    typer.echo(json.dumps(document, ensure_ascii=False, allow_nan=False, indent=1))
