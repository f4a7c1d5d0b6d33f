"""What the commands of the plant's host share: the option that names its file, a group's own options, and its database."""

import getpass
import logging
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli import enrol
from monitor.cli.options import EXIT_CONFIG, Commands, ForceOption, Group, JsonOption, print_json, refuse_overwriting
from monitor.errors import BadInput, StoreError

if TYPE_CHECKING:
    from monitor.plant.database import Database
    from monitor.plant.priors import ModelPrior
    from monitor.plant.settings import PlantConfiguration

PlantOption = Annotated[
    Path | None,
    typer.Option("--config", "-c", help="The plant's file; default plant.toml here, else the service's.", show_default=False),
]
OfPlantOption = Annotated[
    Path | None,
    typer.Option("--plant", help="A plant's file instead: its database holds the histories of all its arms.", show_default=False),
]
OnlyCheckOption = Annotated[bool, typer.Option("--only-check", help="Read the configuration and run nothing.")]
SHOWN = 40  # arms that `status` shows; --all shows the rest


def run_alone(context: typer.Context, run: Callable[[Path | None, bool], None], config: Path | None, only_check: bool) -> None:
    """What a group does without a further word: `run`. Raises BadInput where options stand before a word, which would not reach it."""
    if context.invoked_subcommand is None:
        run(config, only_check)
    elif config is not None or only_check:
        name = context.info_name
        raise BadInput(f"{name}: give the options after the word: joint-monitor {name} {context.invoked_subcommand} --config …")


def plant_path(config: Path | None) -> Path | None:
    """The plant's file: the one that is named, else the default; None where there is none."""
    from monitor.plant.settings import default_path

    return default_path() if config is None else config


def loaded_plant(config: Path | None, *, database_alone: bool = False) -> "PlantConfiguration":
    """The plant's configuration. database_alone : no credential of screen or metrics is needed. Raises BadConfiguration."""
    from monitor.plant.settings import load_plant

    return load_plant(plant_path(config), database_alone=database_alone)


@contextmanager
def plant_database(config: "Path | PlantConfiguration | None", *, migrates: bool = True, begins: bool = False) -> "Iterator[Database]":
    """The plant's database. migrates : bring its schema up to date first. begins : one that does not exist yet is made."""
    from monitor.plant.database import Database
    from monitor.plant.settings import PlantConfiguration
    from monitor.store.backup import hand_over

    configuration = config if isinstance(config, PlantConfiguration) else loaded_plant(config, database_alone=True)
    database = Database(configuration.database)
    try:
        if not begins and not database.exists:
            raise StoreError(f"{database.name}: no database yet; the first `joint-monitor plant` with this configuration makes it")
        if migrates:
            database.migrate()
        else:
            database.check()
        yield database
    finally:
        database.close()
        if configuration.directory.is_dir():
            hand_over(configuration.directory)  # root may call this, and the service must be able to write afterwards


def plant(context: typer.Context, config: PlantOption = None, only_check: OnlyCheckOption = False) -> None:
    """Many arms: their histories in one database, one screen, one list of users. Without a further word: `run`."""
    run_alone(context, run, config, only_check)


def run(config: PlantOption = None, only_check: OnlyCheckOption = False) -> None:
    """Copy the histories of all arms and follow how they are, until SIGTERM. Exit 78: the configuration is wrong."""
    try:
        configuration = loaded_plant(config)
        if only_check:
            from monitor.plant.run import check_files

            check_files(configuration)
            typer.echo(f"{configuration.path or 'the default configuration'} is right")
            return
        _serve(configuration)
    except BadInput as error:  # also of a file that the configuration names
        typer.echo(f"joint-monitor: {error}", err=True)
        raise typer.Exit(EXIT_CONFIG) from None


def status(
    config: PlantOption = None,
    every: Annotated[bool, typer.Option("--all", help=f"Every arm, not the worst {SHOWN}.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Tell how every arm is, the worst first; whether the plant runs or not."""
    from monitor.plant.status import as_document, as_lines, plant_status

    with plant_database(config, migrates=False) as database:
        found = plant_status(database)
    if as_json:
        print_json(as_document(found))
        return
    for line in as_lines(found, None if every else SHOWN):
        typer.echo(line)


def backup(
    file: Annotated[Path, typer.Argument(help="The backup.")],
    config: PlantOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write the whole database into one file, while the plant runs."""
    from monitor.plant.backup import back_up

    with plant_database(config) as database:
        refuse_overwriting(file, force)
        rows = back_up(database, file)
    _say({"rows": rows}, f"{file}: {rows} rows", as_json)


def restore(
    file: Annotated[Path, typer.Argument(help="The backup.")],
    config: PlantOption = None,
    force: Annotated[bool, typer.Option("--force", help="Take away what the database holds; its audit stays.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Put a backup into the database; what the arms said since then is copied by the plant that runs."""
    from monitor.plant.backup import restore as put_back

    with plant_database(config, begins=True) as database:
        rows = put_back(database, file, force=force, who=getpass.getuser())
    text = f"{rows} rows are restored from {file}; what the arms have said since then is copied by the plant that runs"
    _say({"rows": rows}, text, as_json)


def rebuild(
    config: PlantOption = None,
    force: Annotated[bool, typer.Option("--force", help="Do it.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Forget every copied history: the plant that runs copies them anew from the arms. The audit stays."""
    from monitor.plant.backup import rebuild as forget_all

    with plant_database(config) as database:
        if not force:
            raise BadInput("plant rebuild: forgets every copied history, to copy it anew from the arms; nothing was done. --force does it")
        arms = forget_all(database, who=getpass.getuser())
    _say({"arms": arms}, f"forgotten: {arms} arms; a plant that runs copies their histories anew, and the audit is kept", as_json)


def forget(
    arm: Annotated[str, typer.Argument(metavar="SITE/ROBOT", help="An arm that is gone for good.")],
    config: PlantOption = None,
    force: Annotated[bool, typer.Option("--force", help="Do it.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Forget everything that was copied of one arm. The audit stays."""
    from monitor.plant.backup import forget as forget_arm

    with plant_database(config) as database:
        if not force:
            raise BadInput(f"plant forget: forgets everything that was copied of {arm}; nothing was done. --force does it")
        forget_arm(database, arm, who=getpass.getuser())
    _say({"forgotten": arm}, f"forgotten: {arm}; the audit is kept", as_json)


def user(
    name: Annotated[str, typer.Argument(help="As the audit shows it, e.g. ada@plant.example.")],
    role: Annotated[str | None, typer.Argument(help="look, acknowledge, move or configure.", show_default=False)] = None,
    site: Annotated[
        list[str] | None, typer.Option(help="The role holds at this site alone; may be given again.", show_default=False)
    ] = None,
    config: PlantOption = None,
    remove: Annotated[bool, typer.Option("--remove", help="Take the user out; what he has open ends at once.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Let a person use the screen, or a program the interface: writes a line of the users' file, and shows the token, once.

    Again: a new role and token.
    """
    from monitor.plant.screen.people import new_user, role_named
    from monitor.plant.screen.settings import put_user, take_user_out

    configuration = loaded_plant(config)
    path = configuration.screen.users_path(configuration.folder)
    if path is None:
        raise BadInput('plant user: the configuration names no file of users; expected users_file = "plant-users" below [screen]')
    if remove:
        take_user_out(path, name)
        _say({"user": name, "role": None}, f"{name} is out of {path}", as_json)
        return
    if role is None:
        raise BadInput("plant user: expected NAME and ROLE: look, acknowledge, move or configure")
    made, token = new_user(name, role_named(role), site or ())
    put_user(path, made)
    where = f" at {', '.join(made.sites)}" if made.sites else ""
    said = f"{name} may {role}{where}. The token, which is shown only now: {token}"
    _say({"user": name, "role": role, "sites": list(made.sites), "token": token}, said, as_json)


def _say(document: dict[str, object], text: str, as_json: bool) -> None:
    if as_json:
        print_json(document)
    else:
        typer.echo(text)


def _priors(address: "str | Path") -> "list[ModelPrior]":
    """Of the plant; its own process alone loads what learns."""
    logging.getLogger("alembic").setLevel(logging.WARNING)  # it tells of each part that it loads
    from monitor.studies.fleet_prior import priors_of_plant

    return priors_of_plant(address)


def _serve(configuration: "PlantConfiguration") -> None:
    from monitor.plant.run import serve
    from monitor.service.systemd import log_as_a_service

    log_as_a_service("plant", "plant")
    for name in configuration.overrides:
        logging.getLogger("monitor").warning("the environment stands in for the file: %s", name)
    serve(configuration, _priors)


def simulate_plant(
    arms: Annotated[int, typer.Option(help="How many.")] = 100,
    sites: Annotated[int, typer.Option(help="Over which they are spread; each site joins one of the routers.")] = 3,
    days: Annotated[int, typer.Option(help="Days of life before the beginning, a replay each.")] = 60,
    speed: Annotated[float, typer.Option(help="Simulated seconds a second; 86400: a day a second.")] = 1.0,
    seed: Annotated[int, typer.Option(help="The same seed, the same lives.")] = 0,
    connect: Annotated[
        list[str] | None, typer.Option(metavar="ENDPOINT", help="A router to join; may be given again.", show_default=False)
    ] = None,
    router: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="Be a router there; default, without --connect: tcp/127.0.0.1:7447.", show_default=False),
    ] = None,
) -> None:
    """Be the monitors of many simulated arms on a real bus, for trying the plant, until Ctrl-C."""
    import threading
    import time

    from monitor.recording import DAY_S
    from monitor.studies.plant import Lives, PlantOnBus, SimulatedPlant

    routers = tuple(router or ()) or (() if connect else ("tcp/127.0.0.1:7447",))
    settings = SimulatedPlant(arms=arms, sites=sites, days=days, speed=speed, seed=seed, connect=tuple(connect or ()), routers=routers)
    typer.echo(f"{arms} arms live {days} days …")
    lives = Lives(arms, seed, time.time() // DAY_S * DAY_S - days * DAY_S)
    lives.live(days)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    with PlantOnBus(settings, lives) as simulated:
        replays, transitions = sum(map(len, lives.replays)), sum(map(len, lives.transitions))
        where = ", ".join((*settings.routers, *settings.connect))
        typer.echo(f"up at {where}: {replays} replays and {transitions} transitions to copy; Ctrl-C ends it")
        simulated.run(stopping)


WORDS: dict[str, Callable[..., None]] = {
    "run": run,
    "status": status,
    "backup": backup,
    "restore": restore,
    "rebuild": rebuild,
    "forget": forget,
    "user": user,
    **enrol.WORDS,
}
COMMANDS: Commands = {"simulate-plant": simulate_plant}
GROUPS = {"plant": Group(plant, WORDS)}
