"""The command `run`, which the service manager starts: the monitor of one robot."""

import logging
from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.options import Commands, ConfigOption, load_configuration
from monitor.errors import BadConfiguration, OlderHistory

if TYPE_CHECKING:
    from monitor.config.schema import Configuration

EXIT_CONFIG = 78  # EX_CONFIG of sysexits.h; the unit file tells systemd not to restart after it


def run(
    config: ConfigOption,
    now: Annotated[bool, typer.Option("--now", help="Replay once at the start, then as scheduled.")] = False,
    only_check: Annotated[bool, typer.Option("--only-check", help="Read the configuration and run nothing; for ExecReload.")] = False,
) -> None:
    """Run the monitor of one robot until SIGTERM.

    Exit 78: the configuration is wrong, or its history is of another arm or of a version before 1.0.
    """
    try:
        # systemd 252 lets the main process alone read its credentials, and not ExecReload
        configuration = load_configuration(config, secrets_needed=not only_check)
        if only_check:
            typer.echo(f"{configuration.path} is right")
            return
        _serve(configuration, now)
    except (BadConfiguration, OlderHistory) as error:
        typer.echo(f"joint-monitor: {error}", err=True)
        raise typer.Exit(EXIT_CONFIG) from None


def _serve(configuration: "Configuration", now: bool) -> None:
    from monitor.service.run import serve
    from monitor.service.systemd import log_as_a_service

    log_as_a_service(configuration.robot.site, configuration.robot.id)
    for name in configuration.overrides:
        logging.getLogger("monitor").warning("the environment stands in for the file: %s", name)
    serve(configuration, replay_now=now)


COMMANDS: Commands = {"run": run}
