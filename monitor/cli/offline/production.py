"""The command `listen`, which judges recordings of ordinary work."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import (
    ColumnsOption,
    Commands,
    GainsOption,
    JsonOption,
    MountingOrNoneOption,
    RobotOption,
    UrdfOption,
    figures,
    print_json,
)


def listen(
    files: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Recordings of work, of one arm.", show_default=False)],
    rigid: Annotated[
        Path | None, typer.Option(help="The replay before: its recording, or its identify --json.", show_default=False)
    ] = None,
    history: Annotated[
        Path | None, typer.Option(help="Instead of --rigid: a daemon's state folder; its last replay is taken.", show_default=False)
    ] = None,
    robot: RobotOption = None,
    urdf: UrdfOption = None,
    mounting: MountingOrNoneOption = None,
    columns: ColumnsOption = None,
    gains: GainsOption = None,
    deviation: Annotated[
        float, typer.Option(min=0.01, max=0.5, help="A joint is known where one σ of its friction is this fraction, or less.")
    ] = 0.05,
    as_json: JsonOption = False,
) -> None:
    """What recordings of ordinary work tell of friction, and what they cannot tell. Nothing moves."""
    from monitor.identify.production.settings import ProductionSettings
    from monitor.model.robot import Mounting, load_robot
    from monitor.store import identify_files
    from monitor.store.from_files.production_files import ListenRequest, listen_to_files
    from monitor.views.terminal.production import print_listened
    from monitor.views.terminal.progress import progress

    arm = None if robot is None and urdf is None else identify_files.arm(robot, urdf)
    joints = None if gains is None else len(gains.split(",")) if arm is None else arm.joints
    request = ListenRequest(
        files=files,
        rigid=rigid,
        history=history,
        robot=arm,
        mounting=None if mounting is None else Mounting.parse(mounting),
        columns=columns,
        gains=None if gains is None or joints is None else figures(gains, "--gains", joints),
        settings=ProductionSettings(deviation=deviation),
    )
    with progress("listen") as show:
        document = listen_to_files(request, load_robot, show)
    if as_json:
        print_json(document)
    else:
        print_listened(document)


COMMANDS: Commands = {"listen": listen}
