"""What the commands of the plant's host share: the option that names its file, a group's own options, and its database."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from monitor.errors import BadInput, StoreError

if TYPE_CHECKING:
    from monitor.plant.database import Database
    from monitor.plant.settings import PlantConfiguration

PlantOption = Annotated[
    Path | None,
    typer.Option("--config", "-c", help="The plant's file; default plant.toml here, else the service's.", show_default=False),
]
OnlyCheckOption = Annotated[bool, typer.Option("--only-check", help="Read the configuration and run nothing.")]


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
def plant_database(config: Path | None, *, migrates: bool = True, begins: bool = False) -> "Iterator[Database]":
    """The plant's database. migrates : bring its schema up to date first. begins : one that does not exist yet is made."""
    from monitor.plant.database import Database
    from monitor.store.backup import hand_over

    configuration = loaded_plant(config, database_alone=True)
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
