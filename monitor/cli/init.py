"""The command `init`: asks the arm and a person, and writes the first configuration of an arm."""

import os
import shlex
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor import __version__
from monitor.cli.init_questions import CellAnswers, Questions, cell_of, listed, number_from, numbers, reached, text_of
from monitor.cli.options import FOR_ALL, Commands, complete_model, figures, load_configuration
from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.acquire.survey import Survey
    from monitor.config.first_file import Answers
    from monitor.service.first_gains import FirstGains

HISTORIES = Path("/var/lib/joint-monitor")  # where the service keeps the histories of its configurations
BUS_PORT, PAGE_PORT, PORTS = 7447, 8420, 100  # the first of each kind, and how many are tried
ALLOW_MOTION = (
    "\nMay the arm move by the clock? Only where the file says allow_motion = true, and every condition of `joint-monitor check` holds. "
    "Say yes only when a motion without a person is in the cell's risk assessment, somebody holds the emergency stop at the first one, and "
    "the trajectory's way is free. You can set it later."
)
SERVICE_USER = "joint-monitor"  # made by deploy/joint-monitor.sysusers


def init(
    file: Annotated[Path | None, typer.Argument(help="The file to write; else ID.toml here.", show_default=False)] = None,
    host: Annotated[str | None, typer.Option(help="Address of the controller, which is asked; - for none yet.", show_default=False)] = None,
    robot_api_port: Annotated[int, typer.Option(min=1, max=65535, help="Of a PolyScope X: where its Robot API answers.")] = 80,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="The arm at --host is `joint-monitor simulate`; gains are its own.")
    ] = False,
    model: Annotated[
        str | None,
        typer.Option(help="Model, e.g. ur5e; else what the arm says.", autocompletion=complete_model, show_default=False),
    ] = None,
    site: Annotated[str | None, typer.Option(help="Part of the bus's keys; default lab.", show_default=False)] = None,
    robot_id: Annotated[str | None, typer.Option("--id", help="The same; default: the file's name.", show_default=False)] = None,
    serial: Annotated[str | None, typer.Option(help="Serial number; else what the arm says.", show_default=False)] = None,
    mounting: Annotated[
        str | None, typer.Option(help="ground, ceiling, wall or ROLL,PITCH,YAW; else what gravity says.", show_default=False)
    ] = None,
    payload: Annotated[float | None, typer.Option(help="Payload [kg] as set in the controller.", show_default=False)] = None,
    payload_cog: Annotated[str | None, typer.Option(help="Its centre X,Y,Z in the flange's frame [m].", show_default=False)] = None,
    tcp_offset: Annotated[str | None, typer.Option(help="Tool centre point X,Y,Z,RX,RY,RZ [m, rad].", show_default=False)] = None,
    tcp_speed_limit: Annotated[
        float | None, typer.Option(help="Of the controller's safety settings [m/s]; 0: not checked.", show_default=False)
    ] = None,
    tool: Annotated[str | None, typer.Option(help="The mounted tool, in your words.", show_default=False)] = None,
    gains: Annotated[str | None, typer.Option(help="Joint torque per ampere [N·m/A], six figures.", show_default=False)] = None,
    gains_from: Annotated[
        Path | None, typer.Option(help="A recording with actual_current and actual_current_as_torque.", show_default=False)
    ] = None,
    payload_pair: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="EMPTY LOADED", help="Two recordings, without and with a known mass.", show_default=False),
    ] = None,
    pair_payload: Annotated[float | None, typer.Option(help="That mass [kg].", show_default=False)] = None,
    pair_cog: Annotated[str | None, typer.Option(help="Its centre X,Y,Z [m]; else on the flange.", show_default=False)] = None,
    cell: Annotated[str | None, typer.Option(help="plain, describe, or the path of a cell's TOML file.", show_default=False)] = None,
    table_top: Annotated[float | None, typer.Option(help="Height of the floor in the base's frame [m].", show_default=False)] = None,
    wall: Annotated[list[str] | None, typer.Option(help="NAME=X,Y,Z/NX,NY,NZ: a point and the normal to the arm's side.")] = None,
    box: Annotated[list[str] | None, typer.Option(help="NAME=X,Y,Z/DX,DY,DZ: centre and edge lengths [m].")] = None,
    tool_length: Annotated[float | None, typer.Option(help="Of the tool, from the flange [m].", show_default=False)] = None,
    tool_radius: Annotated[float | None, typer.Option(help="Of the tool [m].", show_default=False)] = None,
    excitation: Annotated[str | None, typer.Option(help="A trajectory of yours; else the shipped one.", show_default=False)] = None,
    timezone: Annotated[str | None, typer.Option(help="e.g. Europe/Berlin; default: this machine's.", show_default=False)] = None,
    cron: Annotated[str | None, typer.Option(help="When to replay: minute hour day month weekday.", show_default=False)] = None,
    window_utc: Annotated[list[str] | None, typer.Option(help='e.g. "00:00-04:00": when the arm may move; may be given again.')] = None,
    store: Annotated[str | None, typer.Option(help="Folder of the history.", show_default=False)] = None,
    page: Annotated[bool | None, typer.Option("--page/--no-page", help="A status page on this machine; default yes.")] = None,
    allow_motion: Annotated[bool | None, typer.Option("--allow-motion/--no-motion", help="May the arm move? Default no.")] = None,
    no_input: Annotated[bool, typer.Option("--no-input", help="Ask nobody: options, what the arm says, and defaults.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
) -> None:
    """Write the configuration of an arm: asks the arm and you, checks it, and says what is next. Moves nothing."""
    _write(Options(**locals()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """The options of `init`, by their names; None where one is not given."""

    file: Path | None
    host: str | None
    robot_api_port: int
    simulated: bool
    model: str | None
    site: str | None
    robot_id: str | None
    serial: str | None
    mounting: str | None
    payload: float | None
    payload_cog: str | None
    tcp_offset: str | None
    tcp_speed_limit: float | None
    tool: str | None
    gains: str | None
    gains_from: Path | None
    payload_pair: tuple[Path, Path] | None
    pair_payload: float | None
    pair_cog: str | None
    cell: str | None
    table_top: float | None
    wall: list[str] | None
    box: list[str] | None
    tool_length: float | None
    tool_radius: float | None
    excitation: str | None
    timezone: str | None
    cron: str | None
    window_utc: list[str] | None
    store: str | None
    page: bool | None
    allow_motion: bool | None
    no_input: bool
    force: bool


def _write(given: Options) -> None:
    """Ask, write cell and configuration, check them, and say what is next. Raises BadInput, and then has written nothing."""
    from monitor.config.first_file import cell_text, configuration_text, write_new

    ask = Questions(not given.no_input)
    if given.file is not None:
        _refuse_taken(given.file, given.force)
    ask.say("joint-monitor init writes the configuration of one arm. Enter takes what stands in brackets; Ctrl-C writes nothing.\n")
    address, found = reached(given.host, ask, simulated=given.simulated, robot_api_port=given.robot_api_port)
    about = _arm(given, ask, found, address)
    path = given.file or Path(f"{about['id']}.toml")
    _refuse_taken(path, given.force)
    cell_answers = CellAnswers(given.cell, given.table_top, given.wall or [], given.box or [], given.tool_length, given.tool_radius)
    around = cell_of(cell_answers, ask, path.parent)
    cell_file = path.with_name(f"{path.stem}-cell.toml")
    answers = _answers(given, ask, path, about, around if isinstance(around, str) else cell_file.name)
    new_cell = None if isinstance(around, str) else cell_text(around.as_document())
    text = configuration_text(answers)
    if new_cell is not None:
        write_new(cell_file, new_cell, force=given.force)
    try:
        _refuse_wrong(text, path)
    except BadInput:
        if new_cell is not None:  # its name is in the configuration, which is not written
            cell_file.unlink(missing_ok=True)
        raise
    write_new(path, text, force=given.force)
    typer.echo(f"{path} is written" + ("" if new_cell is None else f", and {cell_file}, what stands around the arm"))
    typer.echo(f"gains: {answers.gains_source}")
    check_and_next(path, answers, reached=found.identity is not None)


def _arm(given: Options, ask: Questions, found: "Survey", address: str) -> dict[str, Any]:
    """Which arm it is, where it stands, what it carries, and its gains: the fields of `Answers` by their names."""
    from monitor.model.robot import Mounting, load_robot

    model = ask.answer("--model", given.model, "Model, e.g. ur5e", found.model or None, text_of(load_robot))
    robot = load_robot(model)
    site = ask.answer("--site", given.site, "Site (a–z, 0–9, _ and -)", "lab", text_of(lambda text: _key_part(site=text)))
    named = given.file.stem if given.file else "cell-1"
    arm_id = ask.answer(
        "--id", given.robot_id, "Name of the arm, unique within the site", named, text_of(lambda text: _key_part(robot=text))
    )
    serial = ask.answer("--serial", given.serial, "Serial number (empty: the first one met)", found.serial or "", text_of())
    mounting = ask.answer("--mounting", given.mounting, "Mounting", found.mounting(robot) or "ground", text_of(Mounting.parse))
    mass = ask.answer("--payload", given.payload, "Payload as set in the controller [kg]", found.payload_kg or 0.0, number_from(0.0, 100.0))
    cog: tuple[float, ...] = ()
    if mass or given.payload_cog is not None:
        known = listed(found.payload_cog_m)
        cog = ask.answer("--payload-cog", given.payload_cog, "Its centre X,Y,Z [m] (- not compared)", known, numbers(3, "coordinates"))
    known = listed(found.tcp_offset(robot))
    tcp = ask.answer("--tcp-offset", given.tcp_offset, "Tool centre point X,Y,Z,RX,RY,RZ (- not compared)", known, numbers(6, "figures"))
    question = "Speed limit in the safety settings [m/s] (0: not checked)"
    limit = ask.answer("--tcp-speed-limit", given.tcp_speed_limit, question, 0.0, number_from(0.0, 10.0))
    tool = ask.answer("--tool", given.tool, "Tool, in your words", "none", text_of())
    gains = _accepted(_gains(given, model=model, mounting=mounting, host=address), given.gains is None, ask)
    return {
        "model": model,
        "site": site,
        "id": arm_id,
        "host": "127.0.0.1" if address == "-" else address,
        "robot_api_port": given.robot_api_port,
        "serial": serial,
        "mounting": mounting,
        "payload_kg": mass,
        "payload_cog_m": cog,
        "tcp_offset": tcp,
        "tcp_speed_limit_m_s": limit,
        "tool": tool,
        "gains_nm_per_a": gains.values,
        "gains_source": gains.source,
    }


def _answers(given: Options, ask: Questions, path: Path, about: dict[str, Any], cell: str) -> "Answers":
    """All answers: those about the arm, and when, where and whether it moves."""
    from monitor.config.first_file import Answers

    zone = ask.answer("--timezone", given.timezone, "Time zone", _own_zone(), text_of(_zone))
    when = ask.answer("--cron", given.cron, "When to replay: minute hour day month weekday", "0 3 * * *", text_of(_cron))
    if given.allow_motion is None:
        ask.say(ALLOW_MOTION)
    may_move = ask.confirm("--allow-motion", given.allow_motion, "allow_motion", default=False)
    excitation, designed = _trajectory(given.excitation, path, about["model"], about["mounting"], cell)
    bus_port, page_port = free_ports(path)
    with_page = ask.confirm("--page", given.page, f"A status page at http://127.0.0.1:{page_port}/", default=True)
    return Answers(
        **about,
        cell=cell,
        excitation=excitation,
        designed=designed,
        timezone=zone,
        cron=when,
        windows_utc=tuple(given.window_utc or ()),
        store=given.store or _store(path, about["id"]),
        bus_port=bus_port,
        page=f"127.0.0.1:{page_port}" if with_page else "",
        allow_motion=may_move,
        written=f"{__version__} on {time.strftime('%Y-%m-%d')}",
    )


def _trajectory(given: str | None, path: Path, model: str, mounting: str, cell: str) -> tuple[str, str]:
    """The trajectory's name, empty for the shipped one, and the command that designs it; empty where none is needed.

    Raises BadInput where a trajectory is named that is none, and where none is shipped for the mounting.
    """
    if given is not None:
        from monitor.config.files import find_excitation

        find_excitation(given, path.parent)
        return given, ""
    if cell != "plain":
        name = f"{path.stem}-motion.json"
        files = ["--cell", str(path.parent / cell), "-o", str(path.parent / name)]
        return name, shlex.join(["joint-monitor", "design", "--robot", model, "--mounting", mounting, *files])
    if mounting not in {"ground", "ceiling", "wall"}:
        raise BadInput(
            f"no trajectory is shipped for the mounting {mounting}: joint-monitor design --robot {model} --mounting {mounting} "
            "-o motion.json, then again with --excitation motion.json; nothing was written"
        )
    return "", ""


def _gains(given: Options, *, model: str, mounting: str, host: str) -> "FirstGains":
    """The gains by the best source that there is. Raises BadInput where options contradict each other or show nothing."""
    from monitor.service import first_gains

    if sum(each is not None for each in (given.gains, given.gains_from, given.payload_pair)) > 1:
        raise BadInput("--gains, --gains-from and --payload-pair each give the gains; expected one of them")
    if (given.payload_pair is None) != (given.pair_payload is None):
        raise BadInput("--payload-pair EMPTY LOADED and --pair-payload KG belong together; one of them is missing")
    if given.gains is not None:
        return first_gains.FirstGains(tuple(figures(given.gains, "--gains", 6).tolist()), "as given")
    if given.gains_from is not None:
        return first_gains.gains_of_recording(given.gains_from, model)
    if given.payload_pair is not None and given.pair_payload is not None:
        com_m = (0.0, 0.0, 0.0) if given.pair_cog is None else tuple(figures(given.pair_cog, "--pair-cog", 3, "coordinates").tolist())
        return first_gains.gains_of_pair(first_gains.PayloadPair(*given.payload_pair, given.pair_payload, com_m), model, mounting)
    if given.simulated:
        from monitor.simulate.remote import Remote

        with Remote(host) as remote:
            own = remote.truth()["drive_gain_nm_per_a"]
        return first_gains.FirstGains(
            tuple(round(value, 3) for value in own), "of this simulated arm, which knows its own; a real arm does not"
        )
    own_arm = None if host == "-" else first_gains.gains_of_arm(host, model)
    return own_arm or first_gains.gains_of_model(model)


def _accepted(found: "FirstGains", may_change: bool, ask: Questions) -> "FirstGains":
    """The gains that were found, or those that a person gives instead."""
    from monitor.service.first_gains import FirstGains

    if not (ask.asks and may_change):
        return found
    ask.say(f"\nGains, joint torque per ampere: {found.source}.")
    values = ask.answer(
        "--gains", None, "Gains of joints 1 to 6 [N·m/A] (- none)", listed(found.values), numbers(6, "figures, one a joint")
    )
    return (
        found if values == found.values else FirstGains(values, "as given" if values else "none were given, and without them nothing moves")
    )


def _refuse_taken(path: Path, force: bool) -> None:
    if path.exists() and not force:
        raise BadInput(f"{path} exists; nothing was written. Give another name, or --force to replace it")
    if not path.parent.is_dir():
        raise BadInput(f"{path}: the folder {path.parent} does not exist")
    if not os.access(path.parent, os.W_OK | os.X_OK):  # before a person answers every question
        raise BadInput(f"{path}: the folder {path.parent} may not be written by this user; nothing was written")


def _refuse_wrong(text: str, path: Path) -> None:
    """The file must be right before it is written. Raises BadConfiguration."""
    import tomllib

    from monitor.config.load import from_document
    from monitor.errors import BadConfiguration

    try:
        from_document(tomllib.loads(text), path)
    except BadConfiguration as error:
        raise BadConfiguration(f"{error}; nothing was written") from None


def _key_part(*, site: str = "lab", robot: str = "arm") -> None:
    from monitor.publish.session import prefix

    prefix(site, robot)


def _zone(text: str) -> None:
    from monitor.acquire.schedule.windows import ScheduleSettings

    ScheduleSettings(timezone=text)


def _cron(text: str) -> None:
    from monitor.acquire.schedule.windows import ScheduleSettings

    ScheduleSettings(cron=text)


def _own_zone() -> str:
    """The name of this machine's time zone; UTC where it tells none."""
    try:
        name = str(Path("/etc/localtime").resolve()).partition("/zoneinfo/")[2]
        _zone(name)
    except (BadInput, OSError, ValueError):
        return "UTC"
    return "UTC" if name in {"", "Etc/UTC"} else name


def _store(path: Path, arm_id: str) -> str:
    """Where the history goes: to the service's other histories, else to the folder of the file."""
    return str(HISTORIES / arm_id) if path.resolve().parent == FOR_ALL else f"var/{arm_id}"


def free_ports(path: Path) -> tuple[int, int]:
    """A port for the bus and one for the page that no other configuration of this folder names."""
    others = [each for each in path.resolve().parent.glob("*.toml") if each.is_file() and each.name != path.name]
    taken = ""
    for each in others:
        try:
            taken += each.read_text("utf-8", "replace")
        except OSError as error:  # one of another user: its ports are not known here
            typer.echo(f"{each}: cannot be read ({error.strerror}); look whether its ports are others than these", err=True)

    def free(first: int) -> int:
        return next(port for port in range(first, first + PORTS) if f"127.0.0.1:{port}" not in taken)

    return free(BUS_PORT), free(PAGE_PORT)


def check_and_next(path: Path, answers: "Answers", *, reached: bool) -> None:
    """Run the conditions of `check`, print those that do not hold, and the one command that is next."""
    from monitor.service.motion import check_conditions
    from monitor.views.terminal.progress import status

    configuration = load_configuration(path)
    failed = []
    if reached:
        with status("checking every condition of a motion"):
            conditions = check_conditions(configuration)
        failed = [each for each in conditions if not each.holds]
        for each in failed:
            if not (answers.designed and each.name == "trajectory_clear"):
                typer.echo(f"  {each.name}: {each.text}")
    names = {each.name for each in failed}
    typer.echo("")
    if answers.designed:
        typer.echo("next: design a trajectory for this cell, then uncomment `excitation` in the file")
        typer.echo(f"  {answers.designed}")
    elif "drive_gains" in names or not (answers.gains_nm_per_a or "published" in answers.gains_source):
        typer.echo("next: record a program of yours, once without and once with a weighed mass, then `init` again with --payload-pair")
        typer.echo(f"  joint-monitor record --config {shlex.quote(str(path))} --seconds 60 -o empty.parquet")
    elif not reached or names - {"motion_allowed"}:
        typer.echo("next: look at every condition, when the arm is reached and ready")
        typer.echo(f"  {_command('check', path)}")
    elif names:
        typer.echo(f"next: only allow_motion speaks against a motion. When the arm may move, set allow_motion = true in {path}, then")
        typer.echo(f"  {_command('run', path)} --now")
    else:
        typer.echo("next: the first replay, slowly first; a minute until the first verdict")
        typer.echo(f"  {_command('run', path)} --now")
    if path.resolve().parent == FOR_ALL:
        typer.echo(f"and at last, as a service: systemctl enable --now joint-monitor@{path.stem}")


def _command(name: str, path: Path) -> str:
    """A command on the new configuration. On one of the service it is for its user: what root makes there, the service cannot write."""
    if path.resolve().parent == FOR_ALL:
        return f"sudo -u {SERVICE_USER} joint-monitor {name} --config {path.stem}"
    return f"joint-monitor {name} --config {shlex.quote(str(path))}"


COMMANDS: Commands = {"init": init}
