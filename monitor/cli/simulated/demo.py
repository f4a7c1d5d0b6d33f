"""The command `demo`: a simulated arm and its monitor on one machine, without hardware."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import Commands, JsonOption


def demo(
    seed: Annotated[int, typer.Option(help="Of the simulated arm.")] = 0,
    keep: Annotated[Path | None, typer.Option(help="Keep the history in this folder.", show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """The main job with nothing installed around it: a simulated UR5, weeks of replays, a joint that wears."""
    from monitor.studies.demo.ticker import Ticker

    with Ticker(lambda line: typer.echo(line, err=as_json), "loading the program") as ticker:
        from monitor.studies.demo.play import play

        code = play(seed=seed, keep=keep, as_json=as_json, ticker=ticker)
    raise typer.Exit(code)


COMMANDS: Commands = {"demo": demo}
