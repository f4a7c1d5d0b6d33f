"""The commands around a motion: `check` reads conditions, `replay` moves, `record` listens, `allow` releases the arm after a stop."""

import importlib
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from monitor.cli.maintenance import check_words
from monitor.cli.options import (
    Commands,
    ConfigOption,
    ForceOption,
    JsonOption,
    RecordingOutputOption,
    client_of,
    load_configuration,
    print_json,
    refuse_overwriting,
    stop_on,
)
from monitor.errors import BadInput, StoreError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from monitor.acquire.watch import ReplayProgress
    from monitor.config.schema import Configuration
    from monitor.recording import Recording
    from monitor.service.motion import AskAnswer

EXIT_NOT_NOW = 3  # of `check`: the arm may not move now; of `campaign`: it ended before the arm was warm
# each of them stops a moving arm before the command ends; SIGHUP comes when the terminal is closed
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
SUFFIX = ".script"  # PolyScope lists only such files for a Script node


def check(config: ConfigOption, as_json: JsonOption = False) -> None:
    """May the service run, and the arm move, now? Every condition by name; nothing is moved. Exit 3: something speaks against it."""
    from monitor.acquire.safety.inputs import ConditionResult
    from monitor.service.motion import check_conditions
    from monitor.service.preflight import service_conditions

    by_hand = "CREDENTIALS_DIRECTORY" not in os.environ  # the service manager's, which a person has not
    configuration = load_configuration(config, secrets_needed=not by_hand, reads_files=True)
    service = service_conditions(configuration)
    with _permit_query(configuration) as ask:
        try:
            found = check_conditions(configuration, ask=ask)
        except StoreError as error:  # the history says whether a stop waits for a person
            found = (ConditionResult(name="previous_stop", holds=False, reason=error.reason),)
    may = all(condition.holds for condition in found)
    bus, gateway = _bus_reach(configuration), _gateway_reach(configuration)
    if as_json:
        of_motion, of_service = ([each.document() for each in part] for part in (found, service))
        may_run = all(condition.holds for condition in service)
        about = {"robot": configuration.robot.id, "host": configuration.robot.host, "may_move": may, "may_run": may_run}
        print_json(about | {"service": of_service, "conditions": of_motion, "bus": bus, "gateway": gateway})
    else:
        from monitor.views.terminal.arm import print_bus, print_conditions, print_gateway

        rows = [(each.name, each.status, each.text) for each in (*service, *found)]
        print_conditions(f"{configuration.robot.id} at {configuration.robot.host}", rows)
        print_bus(bus)
        print_gateway(gateway)
    if not (may and all(condition.holds for condition in service)):
        raise typer.Exit(EXIT_NOT_NOW)


def replay(config: ConfigOption, output: RecordingOutputOption, force: ForceOption = False, as_json: JsonOption = False) -> None:
    """Move the arm once along the configured excitation, guarded, slowly first after a change, and save the recording."""
    from monitor.acquire.watch import Caller
    from monitor.service.motion import move, permit_by
    from monitor.store.formats.recordings import write_recording
    from monitor.store.store import Store
    from monitor.views.terminal.progress import progress

    configuration = load_configuration(config)
    _check_output(output, force)
    first = output.with_name(f"{output.stem}-first-pass.parquet")
    with (
        stop_on(*STOP_SIGNALS) as stopping,
        Store.shared(configuration.state_directory) as store,
        _permit_query(configuration) as ask,
        progress("replay") as show,
    ):

        def on_progress(at: "ReplayProgress") -> None:
            show(at.text, at.elapsed_s, at.duration_s)

        def announce(about: "Mapping[str, Any]") -> None:
            in_s = about["moves_at_unix_s"] - time.time()
            if in_s > 0.1:
                typer.echo(f"the arm moves in {in_s:.1f} s", err=True)

        before = store.first_passes.latest()
        recording = move(
            configuration,
            store,
            configuration.excitation,
            configuration.context,
            caller=Caller(
                announce=announce,
                ask=None if ask is None else permit_by(ask),
                should_stop=stopping.is_set,
                on_progress=on_progress,
            ),
            first_pass_path=first,
        )
        slowly = store.first_passes.latest() != before
    write_recording(output, recording)
    facts = _recording_document(output, recording)
    if as_json:
        print_json(facts | {"first_pass": str(first) if slowly else None})
        return
    if slowly:
        typer.echo(f"{first}: slow first pass, because arm, trajectory, cell, tool or payload are new")
    _print_recording(facts)


def record(
    config: ConfigOption,
    output: RecordingOutputOption,
    seconds: Annotated[float | None, typer.Option(help="For so long; else until Ctrl-C.", show_default=False)] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Only listen, while a program of yours moves the arm, and save the recording."""
    from monitor.acquire.listen import record as listen
    from monitor.store.formats.recordings import write_recording
    from monitor.views.terminal.progress import progress

    configuration = load_configuration(config)
    _check_output(output, force)
    if seconds is not None and not 0.1 <= seconds <= 86_400.0:
        raise BadInput(f"--seconds {seconds:g}; expected 0.1 to 86400")
    with stop_on(*STOP_SIGNALS) as stopping, progress("record") as show:
        recording = listen(
            configuration.robot.host,
            rate_hz=configuration.replay.rate_hz,
            context=configuration.context,
            seconds=seconds,
            should_stop=stopping.is_set,
            startup_timeout_s=configuration.replay.startup_timeout_s,
            driver=configuration.driver,
            on_progress=lambda lasted_s, rows: show(f"{rows} rows", lasted_s, seconds or 0.0),
        )
    write_recording(output, recording)
    facts = _recording_document(output, recording)
    if as_json:
        print_json(facts)
    else:
        _print_recording(facts)


def campaign(
    config: ConfigOption,
    by: Annotated[str, typer.Option(help="Who asks for it, and has made sure that the arm may move for so long.", show_default=False)],
    why: Annotated[str, typer.Option(help="Why; it is kept in the log.")] = "warm-up campaign",
    most: Annotated[int, typer.Option(help="Replays, at most.")] = 60,
    hours: Annotated[float, typer.Option(help="Hours, at most: then no further replay is asked for.")] = 2.0,
    plot: Annotated[
        Path | None, typer.Option(help="fv over 0 to 50 °C with its ±, and the replays: a .png or .html.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Ask the running daemon for one replay after another, from a cold arm until its temperatures are steady. Exit 3: it ended before.

    Every condition and guard of a replay holds for each. Ctrl-C: no further one is asked for.
    """
    from monitor.publish.compensation import model_of
    from monitor.publish.timestamps import rfc3339
    from monitor.service.campaign import Bounds, Made
    from monitor.service.campaign import campaign as run_campaign

    if not by.strip():
        raise BadInput("--by is empty: it is kept in the log, and somebody will ask")
    configuration = load_configuration(config)
    schedule = configuration.schedule
    bounds = Bounds(most=most, hours=hours, steady_k=schedule.warm_k_per_10_min, longest_s=schedule.grace_s + 900.0)
    if plot is not None:
        from monitor.views.plots.picture import check_target

        check_target(plot)
        importlib.import_module("matplotlib.figure")  # where it is not installed, before the arm moves

    def tell(made: Made) -> None:
        if not as_json:
            shown = " ".join("–" if T is None else f"{T:.1f}" for T in made.temperature_c)
            typer.echo(f"{rfc3339(made.at_unix_s)}  replay {made.replay} assessed at {shown} °C")

    with stop_on(*STOP_SIGNALS) as stopping, client_of(configuration) as client:
        began = rfc3339(time.time())
        ended = run_campaign(client, bounds, by=by, why=why, should_stop=stopping.is_set, tell=tell)
        if plot is not None and ended.made:
            from monitor.views.plots.friction_law import law_figure
            from monitor.views.plots.picture import write_picture

            past = list(client.history(since=began))
            rows = [[row for row in past if row.joint == j + 1] for j in range(configuration.robot_description.joints)]
            title = f"{configuration.robot.id}: fv over temperature, {len(ended.made)} replays"
            write_picture(plot, law_figure(title, model_of(client.model()).viscous, rows, (0.0, 50.0)), title)
    if as_json:
        made = [{"replay": each.replay, "at": rfc3339(each.at_unix_s), "temperature_c": list(each.temperature_c)} for each in ended.made]
        print_json({"robot": configuration.robot.id, "replays": made, "steady": ended.steady, **ended.why.document()})
    else:
        typer.echo(f"{configuration.robot.id}: {len(ended.made)} replays; {ended.why}")
    if not ended.steady:
        raise typer.Exit(EXIT_NOT_NOW)


def allow(
    config: ConfigOption,
    by: Annotated[str, typer.Option(help="Who has looked at the arm.", show_default=False)],
    why: Annotated[str, typer.Option(help="What was found, and why it may move again.", show_default=False)],
    way_back: Annotated[
        bool,
        typer.Option("--way-back", help="The arm stands on its trajectory, and the way back along it is free: the next motion takes it."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Let the arm move again after a stop that a person had to look at, or accept another arm; who and why are kept with it."""
    from monitor.publish.timestamps import rfc3339
    from monitor.service.left_arm import let_back
    from monitor.service.monitor_document import present_unix_s, read_monitor_document
    from monitor.store.history.motions import LET_BACK, WAY_BACK
    from monitor.store.store import Store, expect_history

    configuration = load_configuration(config)
    check_words(by, why, None, undo=False)
    expect_history(configuration.state_directory)
    now_unix_s = present_unix_s(read_monitor_document(configuration.state_directory), time.time())  # a trial has its own time
    with Store.shared(configuration.state_directory) as store:
        store.motions.give_up_left_over(now_unix_s)  # a motion without a known end waits for a person too
        back = let_back(configuration, store) if way_back else None
        if back is not None:
            store.stops.add(WAY_BACK, LET_BACK(back=back), now_unix_s)
        waiting = store.stops.allow(by.strip(), why.strip(), now_unix_s)
    stops = [{"at": rfc3339(stop.at_unix_s), "cause": stop.cause, **stop.said.document(), "serial": stop.serial} for stop in waiting]
    others = [stop.serial for stop in waiting if stop.serial is not None]
    if as_json:
        expected = others[-1] if others else None
        print_json(
            {"robot": configuration.robot.id, "allowed": stops, "by": by.strip(), "why": why.strip(), "serial": expected, "way_back": back}
        )
        return
    if not waiting:
        typer.echo(f"{configuration.robot.id}: no stop is waiting for a person")
    for stop in stops:
        typer.echo(f"{configuration.robot.id}: {stop['at']}  {stop['text']}")
    if others:
        typer.echo(f"{configuration.robot.id}: from now on the arm with the serial number {others[-1]} is expected; its first pass is slow")
    if waiting:
        typer.echo(f"allowed by {by.strip()}: {why.strip()}")


def _bus_reach(configuration: "Configuration") -> list[dict[str, Any]]:
    """How far the commands get on the bus; and the daemon, where it connects to a router."""
    from monitor.publish.diagnosis import reach

    bus, prefix = configuration.bus, configuration.key_prefix
    found = [reach(endpoint, prefix, who="daemon", zenoh_file=bus.zenoh, answers=False) for endpoint in bus.connect]
    found.append(reach((bus.connect or bus.listen)[0], prefix, who="commands", zenoh_file=bus.client_zenoh))
    return [{"who": each.who, "endpoint": each.endpoint, "cause": each.cause, "text": each.text} for each in found]


def _gateway_reach(configuration: "Configuration") -> dict[str, Any] | None:
    """How far the channels get that tell of this arm's alerts; None where neither its file nor a gateway's here has any."""
    if configuration.notify.to:
        from monitor.gateway.own import check_own

        return {"file": str(configuration.path), "findings": [finding._asdict() for finding in check_own(configuration.path)]}
    from monitor.plant.settings import default_path

    path = default_path(configuration.path.parent)
    if path is None:
        return None
    from monitor.gateway.settings import check_file  # with the plant's database: 0.3 s

    found = check_file(path)
    return None if found is None else {"file": str(found[0]), "findings": [finding._asdict() for finding in found[1]]}


@contextmanager
def _permit_query(configuration: "Configuration") -> "Iterator[AskAnswer | None]":
    """How a permit is asked for; None where the configuration wants none. Raises BusError."""
    if configuration.replay.permit != "zenoh":
        yield None
        return
    from monitor.publish.permit import Asker

    with Asker(configuration.bus, configuration.key_prefix) as asker:
        yield asker.ask


def _check_output(output: Path, force: bool) -> None:
    """Raises BadInput unless a recording can be written to `output`, and replaces nothing unless `force` says so."""
    if output.suffix != ".parquet":
        raise BadInput(f"{output}: a recording is written as Parquet; give a name that ends in .parquet")
    if not output.parent.is_dir():
        raise BadInput(f"{output}: the folder {output.parent} does not exist")
    refuse_overwriting(output, force)


def _recording_document(output: Path, recording: "Recording") -> dict[str, Any]:
    """The JSON document of a recording that was written."""
    return {"file": str(output), "samples": recording.samples, "duration_s": recording.duration_s, "quality": dict(recording.quality)}


def _print_recording(facts: dict[str, Any]) -> None:
    """Print what `_recording_document` gives: a line for the file, a line for each figure of quality."""
    typer.echo(f"{facts['file']}: {facts['samples']} samples in {facts['duration_s']:.1f} s")
    for name, value in facts["quality"].items():
        typer.echo(f"  {name}: {value:.4g}" if isinstance(value, float) and abs(value) < 1e6 else f"  {name}: {value}")


def script_node(
    config: ConfigOption,
    output: Annotated[Path, typer.Option("--output", "-o", help=f"Where the text goes ({SUFFIX}).", show_default=False)],
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write the text with which a Script node of your program lends the arm; it is made for the controller that answers now."""
    from monitor.service.node import keep, node_text

    configuration = load_configuration(config)
    if output.suffix != SUFFIX:
        raise BadInput(f"{output}: PolyScope reads a Script node's text from a file that ends in {SUFFIX}; give such a name")
    if not output.parent.is_dir():
        raise BadInput(f"{output}: the folder {output.parent} does not exist")
    node = node_text(configuration.robot.host, driver=configuration.driver)
    there = _text_of(output)
    same = there == node.text
    if there is not None and not same:
        refuse_overwriting(output, force)
    if not same:
        try:
            output.write_text(node.text, "utf-8")
        except OSError as error:
            raise BadInput(f"{output}: {error.strerror}") from None
    keep(configuration.state_directory, node)
    lines = node.text.count("\n")
    if as_json:
        print_json(
            {
                "file": str(output),
                "number": node.number,
                "software": node.software,
                "host": configuration.robot.host,
                "lines": lines,
                "written": not same,
                "hand_over": configuration.replay.hand_over,
            }
        )
        return
    typer.echo(f"{output}: {'is right already' if same else 'written'}: node {node.number}, {lines} lines, software {node.software or '?'}")
    if configuration.replay.hand_over != "script_node":
        typer.echo(f'  it takes effect with [replay] hand_over = "script_node"; now it is "{configuration.replay.hand_over}"')


def _text_of(path: Path) -> str | None:
    """What a file holds already; None where there is none. Raises BadInput where it cannot be read."""
    try:
        return path.read_text("utf-8", errors="replace") if path.exists() else None
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from None


COMMANDS: Commands = {"check": check, "replay": replay, "campaign": campaign, "record": record, "allow": allow, "script-node": script_node}
