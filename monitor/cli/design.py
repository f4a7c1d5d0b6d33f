"""The command `design`: search an excitation trajectory, prove it, write its file and print what it is worth."""

import json
import signal
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from monitor import __version__
from monitor.cli.options import (
    Commands,
    ForceOption,
    JsonOption,
    complete_model,
    figures,
    optional_figures,
    print_json,
    refuse_overwriting,
    stop_on,
)
from monitor.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from monitor.design.optimise import Progress

POSE_HELP = "one angle a joint [rad], comma-separated"


def design(
    robot: Annotated[str, typer.Option(help="Model, e.g. ur5.", autocompletion=complete_model, show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", help="Where the trajectory goes (.json).", show_default=False)],
    mounting: Annotated[str, typer.Option(help="ground, ceiling, wall or ROLL,PITCH,YAW in degrees.")] = "ground",
    cell: Annotated[Path | None, typer.Option(help="The site's cell (.toml); else the plain one of the mounting.")] = None,
    objective: Annotated[str, typer.Option(help="friction (what is tracked), condition (the paper's), scaled or dopt.")] = "friction",
    harmonics: Annotated[int, typer.Option(help="Of the Fourier series.")] = 5,
    period: Annotated[float, typer.Option(help="Of one repetition [s].")] = 10.0,
    repetitions: Annotated[int, typer.Option(help="As the file says; a configuration may say otherwise.")] = 3,
    offset: Annotated[str | None, typer.Option(help=f"About which pose it swings: {POSE_HELP}; else upright.", show_default=False)] = None,
    start: Annotated[str | None, typer.Option(help=f"Start and end there instead: {POSE_HELP}.", show_default=False)] = None,
    approach_from: Annotated[
        list[str] | None,
        typer.Option("--from", help=f"Where the arm rests: the way from there must be free; {POSE_HELP}. May be given again."),
    ] = None,
    speed_limit: Annotated[float | None, typer.Option(help="Of every joint [rad/s], where stricter than the robot's.")] = None,
    acceleration_limit: Annotated[float | None, typer.Option(help="Of every joint [rad/s²], where stricter than 5.5π.")] = None,
    flange_speed_limit: Annotated[float | None, typer.Option(help="Of the flange [m/s]; else none.")] = None,
    torque_share: Annotated[float, typer.Option(help="Of the robot's torque limit that the model may ask for.")] = 0.9,
    noise: Annotated[str | None, typer.Option(help="Torque noise of each joint [N·m]; else a share of its limit.")] = None,
    optimiser: Annotated[str, typer.Option(help="cma, or ga: the paper's, population 300.")] = "cma",
    evaluations: Annotated[int, typer.Option(help="Budget; the same command gives the same file.")] = 4000,
    time_limit: Annotated[float | None, typer.Option("--time", help="Stop after so many seconds; not reproducible.")] = None,
    seed: Annotated[int, typer.Option(help="Of the search.")] = 0,
    random: Annotated[int | None, typer.Option(metavar="SEED", help="A pseudo-random trajectory for validation instead.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw it (.png or .html).", show_default=False)] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find a trajectory that makes friction visible and hits nothing; write it with its proof. Ctrl-C keeps the best so far."""
    from monitor.config.files import load_cell
    from monitor.design.trajectory import Task
    from monitor.design.trajectory import design as design_trajectory
    from monitor.model.robot import Mounting, load_robot
    from monitor.views.plots.picture import check_target

    _check(output, time_limit)
    refuse_overwriting(output, force)
    refuse_overwriting(plot, force)
    if plot is not None:
        check_target(plot)
    arm = load_robot(robot)
    task = Task(
        robot=arm,
        mounting=Mounting.parse(mounting),
        cell=None if cell is None else load_cell(cell),
        objective=objective,
        harmonics=harmonics,
        period_s=period,
        repetitions=repetitions,
        offset_rad=optional_figures(offset, "--offset", arm.joints),
        start_rad=optional_figures(start, "--start", arm.joints),
        approaches_rad=tuple(figures(text, "--from", arm.joints) for text in approach_from or []),
        speed_limit_rad_s=speed_limit,
        acceleration_limit_rad_s2=acceleration_limit,
        flange_speed_limit_m_s=flange_speed_limit,
        torque_share=torque_share,
        noise_nm=optional_figures(noise, "--noise", arm.joints),
    )
    with _watched_search(objective, evaluations, time_limit) as go_on:
        excitation, found = design_trajectory(
            task,
            software=f"joint-monitor {__version__}",
            seed=seed if random is None else random,
            evaluations=evaluations,
            optimiser=optimiser,
            random=random is not None,
            on_progress=go_on,
        )
    document = excitation.as_document()
    output.write_text(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    if plot is not None:
        from monitor.views.plots.trajectory import design_plot

        design_plot(plot, arm, excitation)
    if as_json:
        about = {"file": str(output), "digest": excitation.digest, "stopped": found.stopped, "evaluations": found.evaluations}
        print_json(about | document, indent=None)
        return
    from monitor.views.terminal.identification import print_design

    if found.stopped:
        typer.echo(f"stopped after {found.evaluations} evaluations: the best so far is kept, and it is proved", err=True)
    print_design(str(output), document)


def _check(output: Path, time_limit: float | None) -> None:
    """Raises BadInput where the trajectory cannot be written to `output`, or a time limit is not positive."""
    if output.suffix.lower() != ".json" or not output.parent.is_dir():
        raise BadInput(f"-o {output}: expected a name that ends in .json, in a folder that exists")
    if time_limit is not None and not time_limit > 0.0:
        raise BadInput(f"--time {time_limit:g}: expected a positive number of seconds")


@contextmanager
def _watched_search(objective: str, evaluations: int, time_limit: float | None) -> "Iterator[Callable[[Progress], bool]]":
    """Show a search, and decide after each evaluation whether it goes on: until Ctrl-C, or until `time_limit` seconds have passed."""
    from monitor.views.terminal.progress import search_progress

    began = time.monotonic()
    with stop_on(signal.SIGINT) as interrupts, search_progress(objective, evaluations) as show:

        def go_on(at: "Progress") -> bool:
            if at.evaluations == 1:
                typer.echo(f"searching, {evaluations} evaluations; Ctrl-C keeps the best so far", err=True)
            show(at.evaluations, at.best)
            late = time_limit is not None and time.monotonic() - began > time_limit
            # a search that has found nothing allowed goes on, because there is nothing to keep; a second Ctrl-C ends it
            return not ((interrupts.count or late) and at.best < float("inf")) and interrupts.count < 2

        yield go_on


COMMANDS: Commands = {"design": design}
