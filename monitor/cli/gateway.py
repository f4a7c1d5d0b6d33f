"""The command `gateway …`, which reports what the plant knows to people and to other systems."""

import logging
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.options import EXIT_CONFIG, Commands, Group, JsonOption, named_configuration, print_json
from monitor.cli.plant import OnlyCheckOption, PlantOption, plant_database, plant_path, run_alone
from monitor.errors import BadConfiguration, StoreError

if TYPE_CHECKING:
    from monitor.gateway.settings import GatewayConfiguration

EitherOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        help="The plant's file, or an arm's that has [notify]; default plant.toml here, else the service's.",
        show_default=False,
    ),
]


def gateway(context: typer.Context, config: PlantOption = None, only_check: OnlyCheckOption = False) -> None:
    """Tell people and other systems what the plant knows: mail, webhooks, work orders and more. Without a further word: `run`."""
    run_alone(context, run, config, only_check)


def run(config: PlantOption = None, only_check: OnlyCheckOption = False) -> None:
    """Tell what the plant copies, until SIGTERM. Exit 78: the configuration is wrong, or no channel is configured."""
    try:
        if (arm := _arm(config)) is not None:
            raise BadConfiguration(f"{arm}: is an arm's file; its daemon tells people by itself: joint-monitor run --config {arm}")
        configuration = _loaded(config)
        configuration.expect_channel()
        if only_check:
            configuration.check_files()
            typer.echo(f"{configuration.path or 'the default configuration'} is right; channels: {', '.join(configuration.enabled)}")
            return
        _serve(configuration)
    except BadConfiguration as error:
        typer.echo(f"joint-monitor: {error}", err=True)
        raise typer.Exit(EXIT_CONFIG) from None


def check(
    config: EitherOption = None,
    send: Annotated[bool, typer.Option("--send", help="Also send a test message to everybody whom [notify] names.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Tell how far each channel gets: name, TCP, TLS, authentication, authorisation. Exit 3: one gets nowhere, or none is configured."""
    from monitor.gateway.settings import check_all

    configuration = _loaded(config)
    found = check_all(configuration, send=send)
    if as_json:
        print_json([finding._asdict() for finding in found])
    else:
        for finding in found:
            typer.echo(f"{finding.channel}: {finding.step}: {'' if finding.ok else 'FAILED: '}{finding.text}")
        if not configuration.enabled:
            typer.echo(f"no channel is configured in {configuration.path or 'any file'}: nobody is notified")
    raise typer.Exit(0 if configuration.enabled and all(finding.ok for finding in found) else 3)


def status(config: EitherOption = None, as_json: JsonOption = False) -> None:
    """Tell what is owed to whom, what was given up, and each channel's trouble; whether the gateway runs or not."""
    from monitor.gateway.status import as_document, as_lines, gateway_status

    arm = _arm(config)
    if arm is not None:
        from monitor.cli.options import load_configuration
        from monitor.gateway.own import own_configuration

        of = own_configuration(load_configuration(arm)).plant
        if not of.directory.is_dir():
            raise StoreError(f"{of.directory}: nothing was told yet; it is made by `joint-monitor run` with a [notify] that names somebody")
    with plant_database(config if arm is None else of) as database:  # it needs no secret of a channel
        found = gateway_status(database)
    if as_json:
        print_json(as_document(found))
        return
    for line in as_lines(found):
        typer.echo(line)


def _loaded(config: Path | None) -> "GatewayConfiguration":
    arm = _arm(config)
    if arm is not None:
        from monitor.gateway.own import load_own

        return load_own(arm)
    from monitor.gateway.settings import load_gateway

    return load_gateway(plant_path(config))


def _arm(config: Path | None) -> Path | None:
    """The file of an arm, whose daemon tells people by itself; None where the plant's is meant."""
    if config is None:
        return None
    path = named_configuration(config)
    try:
        return path if "robot" in tomllib.loads(path.read_text("utf-8")) else None
    except (OSError, ValueError):
        return None  # whoever reads it says what is wrong


def _serve(configuration: "GatewayConfiguration") -> None:
    from monitor.gateway.run import serve
    from monitor.service.systemd import log_as_a_service

    log_as_a_service("plant", "gateway")
    for name in configuration.overrides:
        logging.getLogger("monitor").warning("the environment stands in for the file: %s", name)
    serve(configuration)


WORDS: dict[str, Callable[..., None]] = {"run": run, "check": check, "status": status}

COMMANDS: Commands = {}
GROUPS = {"gateway": Group(gateway, WORDS)}
