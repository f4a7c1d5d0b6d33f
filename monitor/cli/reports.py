"""The commands `reproduce` and `report`, which write a page to print, and `deploy-files`, which writes what is shipped."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import Commands, ForceOption, JsonOption, ReportOutputOption, load_configuration, print_json, refuse_overwriting
from monitor.errors import BadInput, StoreError
from monitor.publish.timestamps import unix_s


def reproduce(
    robot: Annotated[list[str] | None, typer.Option(help="ur3 or ur5; may be given again. Both where none is.", show_default=False)] = None,
    output: ReportOutputOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Of searches and noise: the same seed, the same figures.")] = 0,
    replays: Annotated[int, typer.Option(min=2, max=61, help="Of the half hour's warm-up, identified.")] = 13,
    evaluations: Annotated[int, typer.Option(min=100, max=100_000, help="Of each search for a trajectory.")] = 3000,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """The paper's tables and figures on the simulated arms, compared with the paper's own. Exit 1: something that must agree does not."""
    from monitor.studies.paper.campaign import CampaignSettings
    from monitor.studies.paper.reproduce import reproduce as play
    from monitor.views.terminal.progress import campaign_progress
    from monitor.views.terminal.studies import print_reproduction

    refuse_overwriting(output, force)
    settings = CampaignSettings(seed=seed, replays=replays, evaluations=evaluations)
    robots = robot or ["ur3", "ur5"]
    with campaign_progress(robots) as show:
        document = play(robots, settings, show, output)
    if as_json:
        print_json(document, indent=None)
    else:
        print_reproduction(document, None if output is None else str(output))
    raise typer.Exit(0 if document["passed"] else 1)


def report(
    config: Annotated[list[Path], typer.Option("--config", "-c", help="A robot's TOML file; may be given again.", show_default=False)],
    since: Annotated[
        str | None, typer.Option("--from", help="Begin, e.g. 2026-06-01 (UTC); else the first replay.", show_default=False)
    ] = None,
    until: Annotated[str | None, typer.Option("--to", help="End, not included; else now.", show_default=False)] = None,
    output: ReportOutputOption = None,
    language: Annotated[str | None, typer.Option(help="en or de; else that of [page] language, or English.", show_default=False)] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """One page to print for the maintenance file: verdicts, evidence, context changes, what was not monitored and why."""
    import time

    from monitor.service.history.report import report as collect
    from monitor.store.store import Store
    from monitor.views.language.catalogue import LANGUAGES
    from monitor.views.language.catalogue import language as say_in
    from monitor.views.report.html import check_page
    from monitor.views.report.page import report_page

    if output is None and not as_json:
        raise BadInput("report: expected -o FILE.html, or --json")
    if output is not None:
        check_page(output)
    begin, end = (None if text is None else _moment(text, option) for text, option in ((since, "--from"), (until, "--to")))
    if language is not None and language not in LANGUAGES:
        raise BadInput(f"--language {language}: expected one of {', '.join(LANGUAGES)}")
    if output is not None:
        refuse_overwriting(output, force)
    now, reports, left_out = time.time(), [], []
    for path in config:
        configuration = load_configuration(path)
        language = language or (configuration.page.language if configuration.page.language in LANGUAGES else None)
        try:
            with Store.reader(configuration.state_directory) as store:
                reports.append(collect(configuration, store, begin, end, now))
        except (BadInput, StoreError) as why:  # a new arm must not cost the page of all others
            if len(config) == 1:
                raise
            left_out.append({"site": configuration.robot.site, "id": configuration.robot.id, "why": str(why)})
    if not reports:
        raise BadInput("; ".join(one["why"] for one in left_out))
    if output is not None:
        try:
            output.write_text(report_page(reports, say_in(language or "en"), left_out), encoding="utf-8")
        except OSError as wrong:
            raise BadInput(f"-o {output}: cannot be written: {wrong.strerror}") from None
    if as_json:
        print_json({"reports": reports, "left_out": left_out}, indent=None)
    else:
        typer.echo(f"written: {output}")
        for one in left_out:
            typer.echo(f"  not in it: {one['site']}/{one['id']}: {one['why']}")


def _moment(text: str, option: str) -> float:
    """The time of an option, in seconds since 1970. Raises BadInput."""
    try:
        return unix_s(text)
    except ValueError:
        raise BadInput(f"{option} {text!r}: expected a day or a time, e.g. 2026-06-01 or 2026-06-01T03:00:00Z") from None


def deploy_files(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where they go; it is made where it does not exist.", show_default=False)],
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write units of systemd, examples for Zenoh, Prometheus and Grafana, and these pages into a folder. Nothing is installed."""
    from monitor.config.deploy import write_deploy_files

    written = write_deploy_files(folder, force=force)
    if as_json:
        print_json({"files": [str(path) for path in written]})
        return
    for path in written:
        typer.echo(path)


COMMANDS: Commands = {"report": report, "deploy-files": deploy_files, "reproduce": reproduce}
