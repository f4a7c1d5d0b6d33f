"""The command `try`: months of an arm's life in minutes, with the real daemon, page and alerts, for a person to play with."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import Commands, complete_model, complete_scenario
from monitor.errors import BadInput

LEAST_SPEED, MOST_SPEED = 1.0, 1_000_000.0


def try_it(
    robot: Annotated[str, typer.Option(help="Model of the simulated arm.", autocompletion=complete_model)] = "ur5",
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Try this configuration, on a simulated arm instead of its own.")
    ] = None,
    speed: Annotated[float, typer.Option(help="So many times as fast as life; 20000: a day in four seconds.")] = 20_000.0,
    scenario: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="What happens in the arm's life.", autocompletion=complete_scenario)
    ] = "try",
    days: Annotated[float | None, typer.Option(help="End after so many days; else with Ctrl-C.", show_default=False)] = None,
    seed: Annotated[int, typer.Option(help="Of the simulated arm.")] = 0,
    keep: Annotated[Path | None, typer.Option(help="Keep history and configuration in this folder.", show_default=False)] = None,
) -> None:
    """Months in minutes: the real daemon with page and alerts, beside a simulated arm that wears. Nothing real moves."""
    from monitor.simulate.scenario import load_scenario
    from monitor.studies.trial.plan import Trial
    from monitor.studies.trial.play import play

    if not LEAST_SPEED <= speed <= MOST_SPEED:
        raise BadInput(f"--speed {speed:g}: expected {LEAST_SPEED:g} to {MOST_SPEED:g}")
    if days is not None and not days > 0.0:
        raise BadInput(f"--days {days:g}: expected more than 0")
    if keep is not None and (keep / "try.toml").exists():
        raise BadInput(f"{keep}: holds a trial already; give another folder, because time cannot begin again in its history")
    load_scenario(scenario)  # a wrong name is said before anything starts
    play(Trial(robot=robot, scenario=scenario, speed=speed, days=days, seed=seed, keep=keep, config=config))


COMMANDS: Commands = {"try": try_it}
