"""The commands `assess`, which judges a series of recordings, and `rehearse`, which tries thresholds on a simulated fleet."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor.cli.options import (
    ColumnsOption,
    Commands,
    FilesArgument,
    ForceOption,
    GainsOption,
    IntervalOption,
    JsonOption,
    ManifestOption,
    MountingOrNoneOption,
    RateOption,
    TrajectoryNameOption,
    complete_model,
    load_configuration,
    optional_figures,
    print_json,
    refuse_overwriting,
)
from monitor.cli.plant import OfPlantOption, plant_database
from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.store.from_files.series import Entry, Series

EXIT_DIFFERENT = 3  # of `assess --from-store`: a verdict came out otherwise, or a recording is not the one that was made
FLEET_JOINTS = 6  # of an arm of the simulated fleet
NOISE = 0.02  # σ of its friction from replay to replay
WORLD_DAYS = 1095  # of an arm of a world
INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it


def assess(
    files: FilesArgument = None,
    config: Annotated[Path | None, typer.Option("--config", "-c", help="The robot's TOML file: arm, gains, thresholds.")] = None,
    robot: Annotated[
        str | None, typer.Option(help="Instead of --config: the model, e.g. ur5.", autocompletion=complete_model, show_default=False)
    ] = None,
    mounting: MountingOrNoneOption = None,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    gains: GainsOption = None,
    manifest: ManifestOption = None,
    interval: IntervalOption = None,
    trajectory: TrajectoryNameOption = None,
    from_store: Annotated[bool, typer.Option("--from-store", help="Every past verdict of --config's history once more.")] = False,
    why: Annotated[int | None, typer.Option(min=1, max=6, help="Of this joint: why does it not alert?", show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge a series of recordings in the order of their times, as the daemon would.

    Exit 3: --from-store found a verdict that differs, or a recording that is not the one that was made.
    """
    if from_store:
        given = (files, robot, mounting, columns, rate, gains, manifest, interval, trajectory)
        _assess_from_store(config, others=any(value is not None for value in given), as_json=as_json)
        return
    from monitor.publish.timestamps import outside
    from monitor.store.from_files.series import assess_series, given_entries
    from monitor.views.terminal.progress import status as status_line
    from monitor.views.terminal.studies import print_assessment

    entries = given_entries(files or [], manifest, interval)
    series = replace(_series(entries, config, robot, mounting, gains), columns=columns, rate_hz=rate, trajectory=trajectory)
    with status_line(f"judging {len(entries)} recordings of a {series.robot.name}"):
        document: Any = outside(assess_series(series))
    if as_json:
        print_json(document, indent=None)
    else:
        print_assessment(document, why=why)


def _series(entries: "list[Entry]", config: Path | None, robot: str | None, mounting: str | None, gains: str | None) -> "Series":
    """The recordings with the arm, its mounting and the settings: from the configuration, or from the options. Raises BadInput."""
    from monitor.judge.settings import AssessSettings
    from monitor.model.robot import Mounting
    from monitor.store import identify_files
    from monitor.store.from_files.series import Series

    configuration = None
    if config is not None:
        if robot is not None:
            raise BadInput("--config and --robot are both given; expected one of them")
        configuration = load_configuration(config)
        arm, settings, attitude = configuration.robot_description, configuration.assess, configuration.mounting
    else:
        arm, settings, attitude = identify_files.arm(robot, None), AssessSettings(), Mounting()
    joint_gains = optional_figures(gains, "--gains", arm.joints)
    if joint_gains is None and configuration is not None:
        joint_gains = configuration.gains_nm_per_a
    if mounting is not None:
        attitude = Mounting.parse(mounting)
        entries = [entry._replace(mounting=entry.mounting or attitude) for entry in entries]  # the option holds for every file
    return Series(entries=entries, robot=arm, mounting=attitude, gains=joint_gains, settings=settings)


def rehearse(
    config: Annotated[Path, typer.Option("--config", "-c", help="The robot's TOML file: its thresholds are tried.", show_default=False)],
    arms: Annotated[int, typer.Option(min=16, max=4000, help="Of the fleet on which nothing wears; a year each.")] = 96,
    noise: Annotated[
        float | None, typer.Option(min=0.001, max=0.2, help="Friction from replay to replay, one σ, fraction; 0.02.", show_default=False)
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed, the same fleet.")] = 0,
    plot: Annotated[Path | None, typer.Option(help="Days to detect against pace of wear: a .png or .html.", show_default=False)] = None,
    world: Annotated[
        str | None, typer.Option(help="A world that the judge does not assume, three years an arm: plain, noise-4, …", show_default=False)
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Would these thresholds catch wear? A simulated fleet: false alarms a year, days to detect, coverage, remaining life."""
    if world is not None:
        if noise is not None or plot is not None:
            raise BadInput("--world has its own noise and no plot: expected neither --noise nor --plot beside it")
        _rehearse_world(config, world, arms=arms, seed=seed, as_json=as_json)
        return
    from monitor.studies.rehearsal.rehearse import rehearse as play
    from monitor.views.terminal.progress import status as status_line
    from monitor.views.terminal.studies import print_rehearsal

    configuration = load_configuration(config)
    if configuration.robot_description.joints != FLEET_JOINTS:
        raise BadInput(
            f"rehearse: the fleet has six joints an arm; {configuration.robot.model} has {configuration.robot_description.joints}"
        )
    if plot is not None:
        from monitor.views.plots.picture import check_target

        check_target(plot)
    refuse_overwriting(plot, force)
    with status_line(f"{arms} arms live a year each, some of them wear"):
        document = play(
            configuration.assess, arms=arms, seed=seed, between_std=NOISE if noise is None else noise, robot=configuration.robot.model
        )
    if plot is not None:
        from monitor.views.plots.rehearsal import rehearsal_plot

        rehearsal_plot(plot, document)
    if as_json:
        print_json(document, indent=None)
    else:
        print_rehearsal(document)


def _rehearse_world(config: Path, name: str, *, arms: int, seed: int, as_json: bool) -> None:
    """Play one world with the thresholds of a configuration. Raises BadInput with the list of worlds for an unknown name."""
    from monitor.studies.worlds.table import WORLDS
    from monitor.studies.worlds.verdicts import play_world
    from monitor.views.terminal.progress import status as status_line
    from monitor.views.terminal.studies import print_world

    if name not in WORLDS:
        raise BadInput(f"--world {name}: no such world; expected one of: {', '.join(WORLDS)}")
    configuration = load_configuration(config)
    with status_line(f"{arms} arms live three years in the world {name}, others wear there"):
        document = play_world(WORLDS[name], configuration.assess, arms=arms, days=WORLD_DAYS, seed=seed)
    if as_json:
        print_json(document, indent=None)
    else:
        print_world(document)


def _assess_from_store(config: Path | None, *, others: bool, as_json: bool) -> None:
    """Recompute every past verdict of a history. `others`: options beside --config were given, which is a mistake."""
    from monitor.service.history.recompute import recompute
    from monitor.store.store import Store
    from monitor.views.terminal.progress import status as status_line

    if config is None or others:
        raise BadInput("--from-store takes recordings and settings from a history: expected --config, and nothing else beside it")
    configuration = load_configuration(config)
    reader = Store.reader(configuration.state_directory, configuration.archive)
    with reader as store, status_line("every past verdict once more"):
        document = recompute(store)
    if as_json:
        print_json(document, indent=None)
    else:
        typer.echo(
            f"{document['assessments']} verdicts: {document['identical']} come out the same to the last bit, "
            f"{document['different']} differ, {document['not_recomputable']} cannot be recomputed"
        )
        for line in document["changed_since"]:
            typer.echo(f"  changed since: {line}")
        for each in document["differing"]:
            typer.echo(f"  replay {each['replay']}: {each['figures']} figures, e.g. {'; '.join(each['differs'][:2])}")
        for each in document["other_recordings"]:
            typer.echo(f"  replay {each['replay']}: {each['why']}")
    if document["different"] or document["other_recordings"]:
        raise typer.Exit(EXIT_DIFFERENT)


def reassess(
    histories: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[HISTORY…]", help="A history's folder, a folder of such, or an arm's TOML file.", show_default=False),
    ] = None,
    plant: OfPlantOption = None,
    settings: Annotated[
        Path | None, typer.Option(help="TOML: its keys of assessment replace those of then; else as then.", show_default=False)
    ] = None,
    results: Annotated[str, typer.Option(help="Folder or address (s3://…) where finished arm-months are kept and found.")] = "var/reassess",
    scheduler: Annotated[
        str | None, typer.Option(help="Of a Dask cluster, e.g. tcp://host:8786; else processes of this machine.", show_default=False)
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes of this machine; one a core.", show_default=False)] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for a picture of each arm of which something else would be said.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """The past by today's program or other settings: which alerts come earlier, later, no more, or anew. Exit 1: one arm failed."""
    from monitor.studies.reassess.plan import read_changes
    from monitor.studies.reassess.reassess import reassess as again
    from monitor.views.terminal.progress import count_progress
    from monitor.views.terminal.reassess import print_reassessment

    if scheduler is not None and workers is not None:
        raise BadInput("--workers is of this machine's processes, --scheduler is of another cluster; expected one of them")
    if pictures is not None and pictures.exists() and not pictures.is_dir():
        raise BadInput(f"--pictures {pictures}: is a file; expected a folder")
    one_of("reassess", histories, plant)
    changes = {} if settings is None else read_changes(settings)
    try:
        with ExitStack() as opened, count_progress("reassess", "recordings") as show:
            database = None if plant is None else opened.enter_context(plant_database(plant, migrates=False))
            document = again(
                histories or [], plant=database, results=results, changes=changes, scheduler=scheduler, workers=workers, show=show
            )
    except KeyboardInterrupt:
        typer.echo(f"joint-monitor: stopped; what is finished is kept in {results}: the same command goes on from there", err=True)
        raise typer.Exit(INTERRUPTED) from None
    drawn = []
    if pictures is not None:
        from monitor.views.plots.reassess import draw_arms

        drawn = [str(path) for path in draw_arms(pictures, document)]
    if as_json:
        print_json(document | {"pictures": drawn}, indent=None)
    else:
        print_reassessment(document, drawn)
    if document["failed"]:
        raise typer.Exit(1)


def one_of(command: str, places: list[Path] | None, plant: Path | None) -> None:
    """Raises BadInput unless either folders or a plant are given."""
    if bool(places) == (plant is not None):
        raise BadInput(f"{command}: expected either folders of histories, or --plant FILE")


def prior(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FOLDER…]", help="State folders of daemons, or a folder of such folders.", show_default=False),
    ] = None,
    plant: OfPlantOption = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="The prior (.json) for [drift] prior.", show_default=False)] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """What a fleet's histories say of a new arm of the same model: temperature law and noise of each joint. Nothing is changed in them."""
    import json

    from monitor.config.files import write_whole
    from monitor.studies.fleet_prior import arms_of, arms_of_plant, prior_document
    from monitor.views.terminal.progress import status
    from monitor.views.terminal.studies import print_prior

    refuse_overwriting(output, force)
    one_of("prior", folders, plant)
    with status("reading histories"):
        if plant is None:
            arms, silent = arms_of(folders or [])
        else:
            with plant_database(plant, migrates=False) as database:
                arms, silent = arms_of_plant(database)
    document = prior_document(arms, silent)
    if output is not None:
        write_whole(output, json.dumps(document, indent=1).encode() + b"\n", mode=0o644)
    if as_json:
        print_json(document)
    else:
        print_prior(document, output)


COMMANDS: Commands = {"assess": assess, "rehearse": rehearse, "reassess": reassess, "prior": prior}
