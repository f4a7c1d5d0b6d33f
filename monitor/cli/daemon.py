"""The commands of one arm's monitor as it runs: `run`, which the service manager starts, `predict`, `watch` and `status`."""

import json
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor.cli.options import (
    CONFIG_HELP,
    CONFIG_VARIABLE,
    EXIT_CONFIG,
    FIGURES_HELP,
    FOR_ALL,
    Commands,
    ConfigOption,
    JsonOption,
    client_of,
    figures,
    joint_number,
    load_configuration,
    named_configuration,
    print_json,
)
from monitor.errors import BadConfiguration, BadInput, MonitorError, OlderHistory

if TYPE_CHECKING:
    from collections.abc import Callable

    from monitor.config.schema import Configuration


def run(
    config: ConfigOption,
    now: Annotated[bool, typer.Option("--now", help="Replay once at the start, then as scheduled.")] = False,
    only_check: Annotated[bool, typer.Option("--only-check", help="Read the configuration and run nothing; for ExecReload.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", envvar="JOINT_MONITOR_VERBOSE", help="Log each condition and phase of a replay.")
    ] = False,
) -> None:
    """Run the monitor of one robot until SIGTERM.

    Exit 78: the configuration, or a file that it names, is wrong; another program has one of its ports; its history is of another arm or
    of a version before 1.0.
    """
    try:
        # systemd 252 lets the main process alone read its credentials, and not ExecReload
        configuration = load_configuration(config, secrets_needed=not only_check, reads_files=True)
        if configuration.notify.to:
            from monitor.gateway.own import own_configuration

            own_configuration(configuration).check_files()
        if only_check:
            typer.echo(f"{configuration.path} is right")
            return
        _serve(configuration, now, verbose)
    except (BadConfiguration, OlderHistory) as error:
        typer.echo(f"joint-monitor: {error}", err=True)
        raise typer.Exit(EXIT_CONFIG) from None


def _serve(configuration: "Configuration", now: bool, verbose: bool) -> None:
    from monitor.service.run import serve
    from monitor.service.systemd import log_as_a_service

    log_as_a_service(configuration.robot.site, configuration.robot.id, verbose=verbose)
    for name in configuration.overrides:
        logging.getLogger("monitor").warning("the environment stands in for the file: %s", name)
    if configuration.notify.to:
        from monitor.gateway.own import OwnGateway  # and with it a database of its own and a client of the mail server

        serve(configuration, replay_now=now, running=OwnGateway)
    else:
        serve(configuration, replay_now=now)


def predict(
    config: ConfigOption,
    q: Annotated[str | None, typer.Option(help=f"Positions [rad]: {FIGURES_HELP}.", show_default=False)] = None,
    qd: Annotated[str | None, typer.Option(help=f"Speeds [rad/s]: {FIGURES_HELP}.", show_default=False)] = None,
    qdd: Annotated[str | None, typer.Option(help=f"Accelerations [rad/s²]: {FIGURES_HELP}; 0 where not given.", show_default=False)] = None,
    temperature: Annotated[
        str | None, typer.Option(help=f"Joint temperatures [°C]: {FIGURES_HELP}; else the latest.", show_default=False)
    ] = None,
    compensation: Annotated[
        bool, typer.Option("--compensation", help="The friction terms of a torque controller instead: fc, fv and wear of each joint.")
    ] = False,
    local: Annotated[bool, typer.Option("--local", help="Read the history instead of asking the daemon.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Torque from the temperature-compensated model of a running daemon, or of its history."""
    from monitor.service.history.status import torque_from_history

    configuration = load_configuration(config)
    joints = configuration.robot_description.joints
    request = {
        name: figures(text, f"--{option}", joints).tolist()
        for name, option, text in (("q", "q", q), ("qd", "qd", qd), ("qdd", "qdd", qdd), ("temperature_c", "temperature", temperature))
        if text is not None
    }
    if compensation:
        _print_compensation(configuration, request, local=local, as_json=as_json)
        return
    if q is None or qd is None:
        raise BadInput("predict: expected --q and --qd, one figure a joint each; or --compensation")
    answer = torque_from_history(configuration, request) if local else _queried_torque(configuration, request)
    if as_json:
        print_json(answer)
        return
    typer.echo("joint  temperature     torque       rigid    friction    std")
    for j in range(joints):
        typer.echo(
            f"{j + 1:>5}  {answer['temperature_c'][j]:8.1f} °C  {answer['torque_nm'][j]:8.2f} Nm {answer['rigid_nm'][j]:8.2f} Nm "
            f"{answer['friction_nm'][j]:8.2f} Nm {answer['std_nm'][j]:6.2f}{EXTRAPOLATED if answer['extrapolated'][j] else ''}"
        )


EXTRAPOLATED = "  extrapolated: outside the temperatures seen so far"


def _print_compensation(configuration: "Configuration", request: dict[str, Any], *, local: bool, as_json: bool) -> None:
    """The friction terms of each joint. Raises BadInput where a motion is asked for as well, or a temperature is not known."""
    from monitor.publish.compensation import compensation_at, model_of
    from monitor.publish.documents import as_json as json_of
    from monitor.service.history.status import compensation_from_history
    from monitor.views.terminal.arm import print_compensation

    if more := sorted(set(request) - {"temperature_c"}):
        raise BadInput(f"predict: --compensation is of no motion; expected no --{more[0]} beside it")
    given = request.get("temperature_c")
    if local:
        rows = compensation_from_history(configuration, given)
    else:
        with client_of(configuration) as client:
            present = [row.temperature_c for row in client.friction()] if given is None else given
            rows = compensation_at(model_of(client.model()), present)
    if as_json:
        print_json({"joints": [json_of(row) for row in rows]})
    else:
        print_compensation(rows)


def _queried_torque(configuration: "Configuration", request: dict[str, Any]) -> dict[str, Any]:
    """The running daemon's answer to a torque query. Raises BusError where nobody answers."""
    with client_of(configuration) as client:
        answer: dict[str, Any] = client.torque(**request).model_dump(mode="json")
        return answer


def watch(
    config: ConfigOption,
    keys: Annotated[str, typer.Option(help="Key expression below the robot's prefix.")] = "**",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line on standard output.")] = False,
) -> None:
    """Follow what the daemon says: last values first, then live, until Ctrl-C."""
    from monitor.views.terminal.watch import DocumentPrinter

    configuration, printer = load_configuration(config), DocumentPrinter()
    with client_of(configuration) as client:
        try:
            for message in client.watch(keys, alive=_tell_alive()):
                if as_json:
                    typer.echo(json.dumps({"key": message.key, "document": message.document}, ensure_ascii=False))
                else:
                    printer.print(message.key, message.document)
        except KeyboardInterrupt:
            return


def _tell_alive() -> "Callable[[bool], None]":
    """Says when nothing more may come for a long time, and why: on standard error, where no program reads it."""
    gone = False

    def tell(alive: bool) -> None:
        nonlocal gone
        if not alive:
            typer.echo("the monitor, or the way to it, is gone: what stands above is of before", err=True)
        elif gone:
            typer.echo("the monitor is back", err=True)
        gone = not alive

    return tell


def status(
    names: Annotated[
        list[Path] | None, typer.Argument(metavar="[NAME…]", help=f"Of {FOR_ALL}/NAME.toml, or files; else --config, else all of them.")
    ] = None,
    config: Annotated[
        list[Path] | None,
        typer.Option("--config", "-c", help=f"{CONFIG_HELP} May be given again.", envvar=CONFIG_VARIABLE, show_default=False),
    ] = None,
    as_json: JsonOption = False,
    why: Annotated[
        str | None, typer.Option(metavar="JOINT", help="Of this joint, 3 or elbow: why does it not alert?", show_default=False)
    ] = None,
) -> None:
    """What is known of the arm now, from its history; works without the daemon. Of several arms, one after the other."""
    import time

    from monitor.service.history.status import status_document
    from monitor.views.terminal.arm import print_not_alerting, print_status

    paths = [*(names or config or sorted(FOR_ALL.glob("*.toml")))]
    if not paths:
        raise BadInput(f"whose status? expected a NAME of {FOR_ALL}/NAME.toml, --config FILE, or the variable {CONFIG_VARIABLE}")
    documents, failed = [], []
    for number, path in enumerate(paths):
        try:
            configuration = load_configuration(path)
            joint = None if why is None else joint_number(why, configuration.robot_description.joints, "--why")
            document = status_document(configuration, time.time(), joint)
        except MonitorError as error:
            if len(paths) == 1:
                raise
            failed.append(f"{named_configuration(path)}: {error}")
            continue
        documents.append(document)
        if not as_json:
            if number:
                typer.echo("")
            print_status(document, configuration.schedule.zone())
            if joint is not None:
                print_not_alerting(joint, document["not_alerting"]["reasons"])
    if as_json:
        print_json(documents[0] if len(paths) == 1 else {"robots": documents, "failed": failed})
    for text in failed:
        typer.echo(f"joint-monitor: {text}", err=True)
    if failed:
        raise typer.Exit(BadInput.exit_code)


COMMANDS: Commands = {"run": run, "predict": predict, "watch": watch, "status": status}
