"""The commands that end in a page to print: `reproduce` and `report`."""

import json
from pathlib import Path
from typing import Annotated

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]


def reproduce(
    robot: Annotated[list[str] | None, typer.Option(help="ur3 or ur5; may be given again. Both where none is.", show_default=False)] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="The report (.html), one file.", show_default=False)] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of searches and noise: the same seed, the same figures.")] = 0,
    replays: Annotated[int, typer.Option(min=2, max=61, help="Of the half hour's warm-up, identified.")] = 13,
    evaluations: Annotated[int, typer.Option(min=100, max=100_000, help="Of each search for a trajectory.")] = 1600,
    as_json: JsonOption = False,
) -> None:
    """The paper's tables and figures on the simulated arms, beside the paper's own. Exit 1: something that must agree does not."""
    from monitor.studies.campaign import CampaignSettings
    from monitor.studies.reproduce import reproduce as play
    from monitor.terminal import campaign_progress, print_reproduction

    settings = CampaignSettings(seed=seed, replays=replays, evaluations=evaluations)
    robots = robot or ["ur3", "ur5"]
    with campaign_progress(robots) as show:
        document = play(robots, settings, show, output)
    if as_json:
        typer.echo(json.dumps(document, ensure_ascii=False, allow_nan=False))
    else:
        print_reproduction(document, None if output is None else str(output))
    raise typer.Exit(0 if document["passed"] else 1)
