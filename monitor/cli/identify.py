"""The command `models`, which lists the arms that the package knows."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.options import (
    LAWS,
    ColumnsOption,
    Commands,
    ForceOption,
    GainsOption,
    JsonOption,
    MountingOption,
    MountingOrNoneOption,
    RateOption,
    RobotOption,
    UrdfOption,
    figures,
    optional_figures,
    print_json,
    refuse_overwriting,
)
from monitor.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    from monitor.identify.identification import Identification
    from monitor.model.robot import Robot
    from monitor.recording import Array, Recording
    from monitor.store.identify_files import PayloadPair


def models(as_json: JsonOption = False) -> None:
    """List the models of arms, with what is known of each: generation, payload, torque per ampere."""
    import numpy as np

    from monitor.model.reported_gains import REPORTED_GAINS
    from monitor.model.robot import load_robot, robot_names

    rows = []
    for name in robot_names():
        robot = load_robot(name)
        published = bool(np.all(np.isfinite(robot.drive_gain_nm_per_a)))
        gains = "published" if published else "reported of one arm" if name in REPORTED_GAINS else "unknown"
        rows.append({"model": name, "generation": robot.generation, "payload_max_kg": robot.payload_max_kg, "gains": gains})
    if as_json:
        print_json({"models": rows})
        return
    for row in rows:
        typer.echo(f"{row['model']:<6} {row['generation']:<9} up to {row['payload_max_kg']:>4g} kg   gains {row['gains']}")


def identify(
    files: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Recordings, fitted together.", show_default=False)],
    robot: RobotOption = None,
    urdf: UrdfOption = None,
    mounting: MountingOption = "ground",
    columns: ColumnsOption = None,
    rate: RateOption = None,
    gains: GainsOption = None,
    method: Annotated[
        str, typer.Option(help="ls (as the paper), wls (standstill masked, rows weighted), robust, consistent (an arm that can exist).")
    ] = "wls",
    friction: Annotated[str, typer.Option(help=f"{LAWS}, or auto: the simplest that predicts data left out as well.")] = "paper",
    rigid_from: Annotated[
        Path | None, typer.Option(help="An earlier identify --json: its rigid parameters are taken as known.", show_default=False)
    ] = None,
    payload_pair: Annotated[
        Path | None, typer.Option(help="The same run with a known mass: joint gains are estimated from both.", show_default=False)
    ] = None,
    payload: Annotated[float | None, typer.Option(help="That mass [kg].", show_default=False)] = None,
    payload_com: Annotated[
        str | None, typer.Option(help="Its centre in the flange's frame [m]: X,Y,Z; else on the flange.", show_default=False)
    ] = None,
    payload_std: Annotated[float, typer.Option(help="Standard deviation of that mass [kg].")] = 0.0,
    loaded: Annotated[
        list[Path] | None, typer.Option(help="Run with a payload nobody has weighed: its ten parameters are estimated.", show_default=False)
    ] = None,
    validate: Annotated[list[Path] | None, typer.Option(help="Held-out recording; may be given again.", show_default=False)] = None,
    export: Annotated[
        Path | None, typer.Option(help="Write the arm of --method consistent, as .urdf or .toml.", show_default=False)
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Residual against speed, load, position: a .png or .html of the held-out, else the fitted.")
    ] = None,
    force: ForceOption = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Also the gears' ripple, and e_N of held-out recordings.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Recordings → base parameters, friction, fit; each with its uncertainty."""
    from monitor.model.robot import Mounting
    from monitor.store import identify_files
    from monitor.views.terminal.identification import print_identification
    from monitor.views.terminal.progress import status as status_line

    arm = identify_files.arm(robot, urdf)
    if plot is not None:
        from monitor.views.plots.picture import check_target

        check_target(plot)
    if export is not None:
        identify_files.check_export(export, method)
    refuse_overwriting(plot, force)
    refuse_overwriting(export, force)
    pair = _payload_pair(payload_pair, payload, payload_com, payload_std)
    request = identify_files.Request(
        files=files,
        robot=arm,
        mounting=Mounting.parse(mounting),
        columns=columns,
        rate_hz=rate,
        gains=optional_figures(gains, "--gains", arm.joints),
        pair=pair,
        method=method,
        friction=friction,
        rigid_from=rigid_from,
        held_out=validate or [],
        loaded=loaded or [],
    )
    with status_line(f"identifying {arm.name} from {', '.join(path.name for path in files)}"):
        outcome = identify_files.identify_files(request)
    if plot is not None:
        _plot_residuals(plot, outcome.identification, arm, outcome.held_out or outcome.recordings, outcome.gains)
    if export is not None:
        identify_files.export(export, outcome.identification)
    if as_json:
        print_json(outcome.document)
    else:
        print_identification(outcome.document, verbose=verbose)


def _payload_pair(file: Path | None, payload_kg: float | None, com: str | None, std_kg: float) -> "PayloadPair | None":
    """The recording with a known mass, and that mass; None where no such recording is given. Raises BadInput."""
    from monitor.store import identify_files

    if (file is None) != (payload_kg is None):
        raise BadInput("--payload-pair FILE and --payload KILOGRAMS belong together; one of them is missing")
    if com is not None and file is None:
        raise BadInput("--payload-com: says where the mass of --payload-pair is; without the pair it means nothing")
    if file is None or payload_kg is None:
        return None
    com_m = (0.0, 0.0, 0.0) if com is None else tuple(figures(com, "--payload-com", 3, "coordinates").tolist())
    return identify_files.PayloadPair(file=file, payload_kg=payload_kg, com_m=com_m, std_kg=std_kg)


def _plot_residuals(path: Path, found: "Identification", arm: "Robot", recordings: "Sequence[Recording]", gains: "Array | None") -> None:
    """Draw what the identified model does not explain of these recordings. Raises BadInput like `residual_plot`."""
    from monitor.views.plots.residuals import residual_plot, residuals_of

    residual_plot(path, f"{arm.name}: measured − modelled torque ({found.method})", residuals_of(found, arm, recordings, gains))


def base(
    robot: RobotOption = None,
    urdf: UrdfOption = None,
    mounting: MountingOption = "ground",
    frames: Annotated[str, typer.Option(help="For what may be quoted: standard-dh (the paper's), modified-dh or joint.")] = "standard-dh",
    as_json: JsonOption = False,
) -> None:
    """What is identifiable: rank, base parameters, their symbolic combinations, and which parameters one may quote."""
    from monitor.model.identifiable import base_document
    from monitor.model.robot import Mounting
    from monitor.store import identify_files
    from monitor.views.terminal.identification import print_base

    document = base_document(identify_files.arm(robot, urdf), Mounting.parse(mounting), frames)
    if as_json:
        print_json(document)
    else:
        print_base(document)


def energy(
    files: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Recordings to identify the arm from.", show_default=False)],
    robot: RobotOption = None,
    urdf: UrdfOption = None,
    along: Annotated[
        str | None, typer.Option(help="Trajectory: an excitation (shipped name or .json) or a recording; else the first FILE.")
    ] = None,
    mounting: MountingOption = "ground",
    columns: ColumnsOption = None,
    rate: RateOption = None,
    gains: GainsOption = None,
    limit: Annotated[
        list[str] | None, typer.Option(help="REGION=JOULES[@KILOGRAMS of the region]; may be given again.", show_default=False)
    ] = None,
    payload: Annotated[float | None, typer.Option(help="Payload in the hand [kg]; else the trajectory's recording says.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Kinetic energy along a trajectory, with its uncertainty, compared with limits. For a risk assessment: not a safety function."""
    from monitor.identify.energy import EnergyPath, energy_along, path_of_excitation, path_of_recording
    from monitor.model.energy import BodyRegion
    from monitor.model.robot import Mounting
    from monitor.store import identify_files
    from monitor.views.terminal.identification import print_energy
    from monitor.views.terminal.progress import status as status_line

    arm = identify_files.arm(robot, urdf)
    regions = [BodyRegion.parse(text) for text in limit or []]
    joint_gains = optional_figures(gains, "--gains", arm.joints)
    recordings = identify_files.named_recordings(files, columns, rate)
    path: EnergyPath
    if along is None or Path(along).suffix in {".csv", ".parquet"}:
        path = path_of_recording(recordings[0] if along is None else identify_files.named_recordings([Path(along)], columns, rate)[0], arm)
    else:
        from monitor.config.files import find_excitation

        path = path_of_excitation(along, find_excitation(along, Path()), arm)
    with status_line(f"identifying {arm.name} from {sum(recording.samples for recording in recordings)} samples"):
        document = energy_along(
            path, recordings, robot=arm, mounting=Mounting.parse(mounting), gains=joint_gains, regions=regions, payload_kg=payload
        )
    if as_json:
        print_json(document)
    else:
        print_energy(document)


def listen(
    files: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Recordings of production, of one arm.", show_default=False)],
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
    rate: RateOption = None,
    gains: GainsOption = None,
    deviation: Annotated[
        float, typer.Option(min=0.01, max=0.5, help="A joint is known where one σ of its friction is this fraction, or less.")
    ] = 0.05,
    as_json: JsonOption = False,
) -> None:
    """Friction from recordings of production, and which joints they do not show. Nothing moves."""
    from monitor.identify.settings import ProductionSettings
    from monitor.model.robot import Mounting, load_robot
    from monitor.store import identify_files
    from monitor.store.from_files.production_files import ListenRequest, listen_to_files
    from monitor.views.terminal.arm import print_listened
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
        rate_hz=rate,
        gains=None if gains is None or joints is None else figures(gains, "--gains", joints),
        settings=ProductionSettings(deviation=deviation),
    )
    with progress("listen") as show:
        document = listen_to_files(request, load_robot, show)
    if as_json:
        print_json(document)
    else:
        print_listened(document)


COMMANDS: Commands = {"models": models, "identify": identify, "base": base, "energy": energy, "listen": listen}
