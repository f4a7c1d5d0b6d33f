"""The commands. Thin: each reads its arguments, calls one room, and prints; heavy imports stand where they are used."""

import json
import logging
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor import __version__
from monitor.cli import assess as commands_health
from monitor.cli import bus as commands_bus
from monitor.cli import history as commands_history
from monitor.cli import motion as commands_motion
from monitor.cli import reports as commands_reports
from monitor.cli.design import design
from monitor.errors import BadConfiguration, BadInput, MonitorError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from monitor.config.load import Configuration
    from monitor.identify.identification import Identification
    from monitor.model.robot import Robot
    from monitor.recording import Array, Recording

EXIT_CONFIG = 78  # sysexits.h: the service manager must not restart into the same mistake

app = typer.Typer(
    name="joint-monitor",
    help="Friction health of a robot arm: replay, re-identify, track, and tell over Zenoh.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # brackets in a help text are units, not markup
    context_settings={"help_option_names": ["-h", "--help"]},
)

ConfigOption = Annotated[Path, typer.Option("--config", "-c", help="The robot's TOML file.", show_default=False)]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object (watch: one a line) on standard output.")]
NumbersHelp = "one figure a joint, comma-separated"
RobotOption = Annotated[str | None, typer.Option(help="Model, e.g. ur5, or a .toml of an arm of yours.", show_default=False)]
UrdfOption = Annotated[Path | None, typer.Option(help="Instead of a model: any serial arm of 1 to 8 turning joints.", show_default=False)]
MountingOption = Annotated[str, typer.Option(help="ground, ceiling, wall or ROLL,PITCH,YAW in degrees.")]
ColumnsOption = Annotated[str | None, typer.Option(help="Names and widths for files without RTDE names.", show_default=False)]
GainsOption = Annotated[str | None, typer.Option(help=f"Joint torque per ampere [N·m/A]: {NumbersHelp}.", show_default=False)]


def main() -> None:
    """Entry point: a user's mistake becomes a sentence and an exit code, never a traceback."""
    # before numpy is imported: threads for matrices of 60 columns only wait for each other, several times longer than one works
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        app()
    except MonitorError as error:
        typer.echo(f"joint-monitor: {error}", err=True)
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.stderr.close()  # `joint-monitor watch | head`: the reader has left
        sys.exit(0)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"joint-monitor {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    _: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and leave.")] = False,
) -> None:
    pass


@app.command()
def run(
    config: ConfigOption,
    now: Annotated[bool, typer.Option("--now", help="Replay once at the start, then as scheduled.")] = False,
) -> None:
    """Run the monitor of one robot until SIGTERM. Exit 78: the configuration is wrong."""
    from monitor.service.daemon import serve
    from monitor.service.systemd import log_as_a_service

    try:
        configuration = _load(config)
    except BadConfiguration as error:
        typer.echo(f"joint-monitor: {error}", err=True)
        raise typer.Exit(EXIT_CONFIG) from None
    log_as_a_service(configuration.robot.site, configuration.robot.id)
    for name in configuration.overrides:
        logging.getLogger("monitor").warning("the environment stands in for the file: %s", name)
    serve(configuration, replay_now=now)


@app.command()
def simulate(
    robot: Annotated[str | None, typer.Option(help="Model, e.g. ur5 (the default) or ur3e.", show_default=False)] = None,
    bind: Annotated[str, typer.Option(help="Loopback address; one robot an address, its ports are fixed.")] = "127.0.0.1",
    scenario: Annotated[str | None, typer.Option(metavar="NAME|FILE", help="What happens in its life.", show_default=False)] = None,
    seed: Annotated[int, typer.Option(help="Of noise; the same seed, the same arm.")] = 0,
    ambient: Annotated[float | None, typer.Option(help="Room temperature [°C]; default 22 or the scenario's.", show_default=False)] = None,
    payload: Annotated[float | None, typer.Option(help="Mass at the flange [kg].", show_default=False)] = None,
    mounting: Annotated[str | None, typer.Option(help="ground, ceiling, wall or ROLL,PITCH,YAW in degrees.", show_default=False)] = None,
    polyscope: Annotated[
        str | None, typer.Option(metavar="VERSION", help="Software to be, e.g. 5.22.0; default 3.15 or 5.11.", show_default=False)
    ] = None,
    protective_runtime: Annotated[
        str | None, typer.Option(help="The program in a protective stop: paused (the default), stopped or playing.", show_default=False)
    ] = None,
    command_port: Annotated[int, typer.Option(help="JSON lines: truth, time, wear, faults.")] = 30020,
    view: Annotated[bool, typer.Option("--view", help="Show the arm's state live in the terminal.")] = False,
    fault: Annotated[
        str | None,
        typer.Option(metavar="'NAME key=value …'", help="Make a fault in the simulator that runs at --bind.", show_default=False),
    ] = None,
) -> None:
    """Be a UR controller made of software, for the unmodified ur-rtde, until Ctrl-C."""
    from monitor.simulate.launch import announcement, settings_from
    from monitor.simulate.scenario import load_scenario

    if fault is not None:
        from monitor.simulate.faults import parse
        from monitor.simulate.remote import Remote

        name, arguments = parse(fault)
        with Remote(bind, command_port) as remote:
            typer.echo(remote.fault(name, **arguments))
        return
    settings = settings_from(
        None if scenario is None else load_scenario(scenario),
        robot=robot,
        bind=bind,
        seed=seed,
        ambient_c=ambient,
        payload_kg=payload,
        mounting=mounting,
        version=polyscope,
        protective_runtime=protective_runtime,
        command_port=command_port,
    )
    if view:
        from monitor.simulate.view import simulate_and_watch

        options = {"--robot": robot, "--scenario": scenario, "--ambient": ambient, "--payload": payload, "--mounting": mounting}
        options |= {"--polyscope": polyscope, "--protective-runtime": protective_runtime}
        given = [f"{option}={value}" for option, value in options.items() if value is not None]
        simulate_and_watch([f"--bind={bind}", f"--seed={seed}", f"--command-port={command_port}", *given], bind, command_port)
        return
    from monitor.simulate.server import serve

    serve(settings, lambda: typer.echo(announcement(settings)))


@app.command()
def identify(
    files: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Recordings, fitted together.", show_default=False)],
    robot: RobotOption = None,
    urdf: UrdfOption = None,
    mounting: MountingOption = "ground",
    columns: ColumnsOption = None,
    gains: GainsOption = None,
    method: Annotated[
        str, typer.Option(help="ls (as the paper), wls (standstill masked, rows weighted), robust, consistent (an arm that can exist).")
    ] = "wls",
    friction: Annotated[
        str, typer.Option(help="paper (fc, fv), load, concave, stribeck, or auto: the simplest that predicts data left out as well.")
    ] = "paper",
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
    as_json: JsonOption = False,
) -> None:
    """Recordings → base parameters, friction, fit; each with its uncertainty."""
    from monitor.model.robot import Mounting
    from monitor.store import identify_files as offline
    from monitor.views.terminal.tables import print_identification
    from monitor.views.terminal.tables import status as status_line

    arm = offline.arm(robot, urdf)
    if plot is not None:
        from monitor.views.plots.identification import check_target

        check_target(plot)
    if export is not None:
        offline.check_export(export, method)
    if (payload_pair is None) != (payload is None):
        raise BadInput("--payload-pair FILE and --payload KILOGRAMS belong together; one of them is missing")
    if payload_com is not None and payload_pair is None:
        raise BadInput("--payload-com: says where the mass of --payload-pair is; without the pair it means nothing")
    pair = None
    if payload_pair is not None and payload is not None:
        com = (0.0, 0.0, 0.0) if payload_com is None else tuple(_numbers(payload_com, "--payload-com", 3, "coordinates"))
        pair = offline.PayloadPair(file=payload_pair, payload_kg=payload, com_m=com, std_kg=payload_std)
    request = offline.Request(
        files=files,
        robot=arm,
        mounting=Mounting.parse(mounting),
        columns=columns,
        gains=_gains(gains, arm),
        pair=pair,
        method=method,
        friction=friction,
        rigid_from=rigid_from,
        held_out=validate or [],
        loaded=loaded or [],
    )
    with status_line(f"identifying {arm.name} from {', '.join(path.name for path in files)}"):
        outcome = offline.identify_files(request)
    if plot is not None:
        _plot_residuals(plot, outcome.identification, arm, outcome.held_out or outcome.recordings, outcome.gains)
    if export is not None:
        offline.export(export, outcome.identification)
    if as_json:
        _print_json(outcome.document)
    else:
        print_identification(outcome.document)


def _plot_residuals(path: Path, found: "Identification", arm: "Robot", recordings: "Sequence[Recording]", gains: "Array | None") -> None:
    from monitor.identify.signals.motion import motion
    from monitor.identify.signals.torque import joint_torque
    from monitor.identify.validate import predict_torque
    from monitor.views.plots.identification import Residuals, residual_plot

    shown = []
    for recording in recordings:
        moved = motion(recording)
        parts = predict_torque(found, arm, moved.q, moved.qd, moved.qdd)
        residual = joint_torque(moved, arm, gains) - parts.torque
        shown.append(Residuals(Path(moved.source).name, moved.qd, parts.rigid, moved.q, residual, moved.moving()))
    residual_plot(path, f"{arm.name}: measured − modelled torque ({found.method})", shown)


@app.command()
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
    from monitor.store import identify_files as offline
    from monitor.views.terminal.tables import print_base

    document = base_document(offline.arm(robot, urdf), Mounting.parse(mounting), frames)
    if as_json:
        _print_json(document)
    else:
        print_base(document)


@app.command()
def energy(
    files: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Recordings to identify the arm from.", show_default=False)],
    robot: RobotOption = None,
    urdf: UrdfOption = None,
    along: Annotated[
        str | None, typer.Option(help="Trajectory: an excitation (shipped name or .json) or a recording; else the first FILE.")
    ] = None,
    mounting: MountingOption = "ground",
    columns: ColumnsOption = None,
    gains: GainsOption = None,
    limit: Annotated[
        list[str] | None, typer.Option(help="REGION=JOULES[@KILOGRAMS of the region]; may be given again.", show_default=False)
    ] = None,
    payload: Annotated[float | None, typer.Option(help="Payload in the hand [kg]; else the trajectory's recording says.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Kinetic energy along a trajectory, with its uncertainty, beside limits. For a risk assessment: not a safety function."""
    from monitor.identify.identify import identify as identify_recordings
    from monitor.identify.signals.motion import motion
    from monitor.identify.validate import refuse_other_arm
    from monitor.model.energy import BodyRegion, energy_document, flange_speed, kinetic_energy
    from monitor.model.robot import Mounting
    from monitor.store import identify_files as offline
    from monitor.views.terminal.tables import print_energy
    from monitor.views.terminal.tables import status as status_line

    arm = offline.arm(robot, urdf)
    regions = [BodyRegion.parse(text) for text in limit or []]
    joint_gains = _gains(gains, arm)
    recordings = offline.named_recordings(files, columns)
    identified_with = max(recording.context.payload_kg or 0.0 for recording in recordings)
    carried = identified_with
    if along is None or Path(along).suffix in {".csv", ".parquet"}:
        path = recordings[0] if along is None else offline.named_recordings([Path(along)], columns)[0]
        refuse_other_arm(path, arm)
        moved = motion(path)
        name, t_s, q, qd = path.source, moved.t_s - moved.t_s[0], moved.q, moved.qd
        carried = path.context.payload_kg if path.context.payload_kg is not None else carried
    else:
        from monitor.config.load import find_excitation

        excitation = find_excitation(along, Path())
        if excitation.robot != arm.name:
            raise BadInput(f"--along {along}: is for a {excitation.robot}; the robot is {arm.name}")
        name, (t_s, (q, qd, _)) = along, excitation.sampled(arm.rate_hz)
    mass_kg = payload if payload is not None else carried
    with status_line(f"identifying {arm.name} from {sum(recording.samples for recording in recordings)} samples"):
        found = identify_recordings(recordings, arm, Mounting.parse(mounting), gains=joint_gains)
    speed = flange_speed(arm, q, qd)
    # what was in the hand while the arm was identified is part of its last link already; more than that is added
    covariance = found.covariance if found.total_covariance is None else found.total_covariance
    energies = kinetic_energy(arm, q, qd, found.columns, found.values, covariance)
    energies = energies.with_payload(max(mass_kg - identified_with, 0.0) if mass_kg >= 0.0 else mass_kg, speed)
    document = {
        "robot": arm.name,
        "along": name,
        "samples": len(t_s),
        "duration_s": float(t_s[-1] - t_s[0]),
        "payload_kg": mass_kg,
        **energy_document(arm, t_s, energies, speed, regions, mass_kg),
        "warnings": [{"code": warning.code, "text": warning.text} for warning in found.warnings],
    }
    if as_json:
        _print_json(document)
    else:
        print_energy(document)


@app.command()
def predict(
    q: Annotated[str, typer.Option(help=f"Positions [rad]: {NumbersHelp}.", show_default=False)],
    qd: Annotated[str, typer.Option(help=f"Speeds [rad/s]: {NumbersHelp}.", show_default=False)],
    config: ConfigOption,
    qdd: Annotated[str | None, typer.Option(help=f"Accelerations [rad/s²]: {NumbersHelp}; 0 where not given.", show_default=False)] = None,
    temperature: Annotated[
        str | None, typer.Option(help=f"Joint temperatures [°C]: {NumbersHelp}; else the latest.", show_default=False)
    ] = None,
    local: Annotated[bool, typer.Option("--local", help="Read the history instead of asking the daemon.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Torque from the temperature-compensated model of a running daemon, or of its history."""
    configuration = _load(config)
    joints = configuration.robot_description.joints
    request = {
        name: _numbers(text, f"--{name}", joints)
        for name, text in (("q", q), ("qd", qd), ("qdd", qdd), ("temperature_c", temperature))
        if text is not None
    }
    answer = _local_torque(configuration, request) if local else _asked_torque(configuration, request)
    if as_json:
        _print_json(answer)
        return
    typer.echo("joint  temperature     torque       rigid    friction    std")
    for j in range(joints):
        flag = "  extrapolated: outside the temperatures seen so far" if answer["extrapolated"][j] else ""
        typer.echo(
            f"{j + 1:>5}  {answer['temperature_c'][j]:8.1f} °C  {answer['torque_nm'][j]:8.2f} Nm {answer['rigid_nm'][j]:8.2f} Nm "
            f"{answer['friction_nm'][j]:8.2f} Nm {answer['std_nm'][j]:6.2f}{flag}"
        )


def _asked_torque(configuration: "Configuration", request: dict[str, Any]) -> dict[str, Any]:
    with _client(configuration) as client:
        answer: dict[str, Any] = client.torque(**request).model_dump(mode="json")
        return answer


def _local_torque(configuration: "Configuration", request: dict[str, Any]) -> dict[str, Any]:
    import numpy as np

    from monitor.judge.document import plain
    from monitor.judge.torque.compensated_model import model_from_document
    from monitor.publish.torque_query import torque_answer
    from monitor.store.database import Store

    with Store.reader(configuration.state_directory) as store:
        state = store.state()
        newest = store.friction(limit=configuration.robot_description.joints)
    if state is None:
        raise BadInput(f"{configuration.state_directory}: no replay has been assessed yet, so there is no model")
    temperatures = [row.get("temperature_c") for row in newest]
    present = None if None in temperatures or not newest else np.array(temperatures)
    answer: dict[str, Any] = plain(torque_answer(model_from_document(state.model), configuration.robot_description, present, request))
    return answer


@app.command()
def watch(
    config: ConfigOption,
    keys: Annotated[str, typer.Option(help="Key expression below the robot's prefix.")] = "**",
    as_json: JsonOption = False,
) -> None:
    """Follow what the daemon says: last values first, then live, until Ctrl-C."""
    from monitor.views.terminal.watch import Teller

    configuration, teller = _load(config), Teller()
    with _client(configuration) as client:
        try:
            for message in client.watch(keys):
                if as_json:
                    typer.echo(json.dumps({"key": message.key, "document": message.document}, ensure_ascii=False))
                else:
                    teller.tell(message.key, message.document)
        except KeyboardInterrupt:
            return


@app.command()
def status(
    config: ConfigOption,
    as_json: JsonOption = False,
    why: Annotated[int | None, typer.Option(min=1, help="Of this joint: why does it not alert?", show_default=False)] = None,
) -> None:
    """What is known of the arm now, from its history; works without the daemon."""
    import time

    from monitor.publish.health_document import with_stale
    from monitor.publish.timestamps import outside, rfc3339
    from monitor.service.maintenance import said, silent_s
    from monitor.store.database import Store
    from monitor.views.terminal.tables import print_not_alerting, print_status

    configuration = _load(config)
    with Store.reader(configuration.state_directory) as store:
        state = store.state()
        newest = store.friction(limit=configuration.robot_description.joints)
        ledger = store.ledger(limit=10)
    monitor = said(configuration.state_directory)
    document = {
        "robot": configuration.robot.id,
        "model_revision": state.revision if state else 0,
        "health": outside(with_stale(state.health, time.time(), configuration.assess.health)) if state else None,
        "friction": outside(newest),
        "monitor": monitor,
        "monitor_silent_s": None if monitor is None else silent_s(monitor, time.time()),
        "ledger": [
            {"replay": row.id, "window": rfc3339(row.window_unix_s), "kind": row.kind, "state": row.state, "reason": row.reason}
            for row in ledger
        ],
    }
    reasons = None if why is None else commands_health.not_alerting(state, why, configuration)
    if as_json:
        _print_json(document if reasons is None else {**document, "not_alerting": {"joint": why, "reasons": reasons}})
    else:
        print_status(document)
        if why is not None and reasons is not None:
            print_not_alerting(why, reasons)


app.command(name="design")(design)
for _command in (
    commands_bus.alerts,
    commands_bus.ack,
    commands_bus.shelve,
    commands_bus.schema,
    commands_health.assess,
    commands_health.rehearse,
    commands_motion.check,
    commands_motion.replay,
    commands_motion.record,
    commands_motion.allow,
    commands_history.schedule,
    commands_history.history,
    commands_history.export,
    commands_reports.report,
    commands_reports.reproduce,
):
    app.command()(_command)
app.command(name="import")(commands_history.import_)


@app.command()
def demo(
    seed: Annotated[int, typer.Option(help="Of the simulated arm.")] = 0,
    keep: Annotated[Path | None, typer.Option(help="Keep the history in this folder.", show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """The main job with nothing installed around it: a simulated UR5, weeks of replays, a joint that wears."""
    from monitor.studies.demo import play

    raise typer.Exit(play(seed=seed, keep=keep, as_json=as_json))


# --- what the commands share -----------------------------------------------------------------------


def _load(path: Path) -> "Configuration":
    from monitor.config.load import load

    return load(path)


def _client(configuration: "Configuration") -> Any:
    from monitor.publish.client import Client

    endpoint = (configuration.bus.connect or configuration.bus.listen)[0]
    return Client(endpoint, configuration.robot.site, configuration.robot.id, zenoh_file=configuration.bus.client_zenoh)


def _gains(text: str | None, arm: "Robot") -> "Array | None":
    import numpy as np

    return None if text is None else np.array(_numbers(text, "--gains", arm.joints))


def _numbers(text: str, option: str, count: int, what: str = "figures, one a joint") -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise BadInput(f"{option} {text!r}: not numbers; expected {count} figures, comma-separated") from None
    if len(numbers) != count:
        raise BadInput(f"{option}: {len(numbers)} given; expected {count} {what}")
    return numbers


def _print_json(document: Any) -> None:
    typer.echo(json.dumps(document, ensure_ascii=False, allow_nan=False, indent=1))
