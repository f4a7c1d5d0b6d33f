"""The commands `simulate`, a simulated UR controller, and `simulate-production`, recordings of production on it."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import Commands, JsonOption, MountingOrNoneOption, complete_cell, complete_model, complete_scenario, print_json
from monitor.errors import BadInput

LEAST_SPEED, MOST_SPEED = 1.0, 1_000_000.0


def simulate(
    robot: Annotated[
        str | None, typer.Option(help="Model, e.g. ur5 (the default) or ur3e.", autocompletion=complete_model, show_default=False)
    ] = None,
    bind: Annotated[str, typer.Option(help="Loopback address; one robot an address, its ports are fixed.")] = "127.0.0.1",
    scenario: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="What happens in its life.", autocompletion=complete_scenario, show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of noise; the same seed, the same arm.")] = 0,
    ambient: Annotated[float | None, typer.Option(help="Room temperature [°C]; default 22 or the scenario's.", show_default=False)] = None,
    payload: Annotated[float | None, typer.Option(help="Mass at the flange [kg].", show_default=False)] = None,
    mounting: MountingOrNoneOption = None,
    polyscope: Annotated[
        str | None,
        typer.Option(metavar="VERSION", help="Software to be, e.g. 5.22.0 or 10.12.0; default 3.15 or 5.11.", show_default=False),
    ] = None,
    protective_runtime: Annotated[
        str | None, typer.Option(help="The program in a protective stop: paused (the default), stopped or playing.", show_default=False)
    ] = None,
    personality: Annotated[
        str | None,
        typer.Option(help="Values other than the motion: ideal (the default), or recorded as from real arms.", show_default=False),
    ] = None,
    control_script: Annotated[
        str | None, typer.Option(help="ur-rtde's script: modelled (the default), or executed line by line.", show_default=False)
    ] = None,
    run_in: Annotated[
        float | None, typer.Option(help="What rest adds to friction, e.g. 0.04; gone after some 15 s of motion.", show_default=False)
    ] = None,
    program: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Production program that is loaded, as TOML.", show_default=False)
    ] = None,
    cell: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Production cell around the arm, whose program plays.", autocompletion=complete_cell, show_default=False
        ),
    ] = None,
    home: Annotated[
        str | None, typer.Option(metavar="Q1,…,Q6", help="Joint positions at the start [rad], as --home=….", show_default=False)
    ] = None,
    robot_api_port: Annotated[int, typer.Option(help="Robot API of a PolyScope X (software 10); a port below 1024 may need rights.")] = 80,
    command_port: Annotated[int, typer.Option(help="JSON lines: truth, time, wear, faults.")] = 30020,
    view: Annotated[bool, typer.Option("--view", help="Show the arm's state live in the terminal.")] = False,
    fault: Annotated[
        str | None,
        typer.Option(
            metavar="'NAME[:SEVERITY] key=value …'",
            help="Make a fault in the simulator that runs at --bind. Joints, each with joint=3 and a severity of 0 to 1: backlash, "
            "soft_gear, kinematic_error, bearing, aged_lubricant, dragging_brake, joint_encoder, motor_encoder, demagnetisation.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Be a UR controller made of software, for the unmodified ur-rtde, until Ctrl-C."""
    if fault is not None:
        from monitor.simulate.faults import parse
        from monitor.simulate.remote import Remote

        name, arguments = parse(fault)
        with Remote(bind, command_port) as remote:
            typer.echo(remote.fault(name, **arguments))
        return
    from monitor.simulate.launch import announcement, settings_of_options

    settings = settings_of_options(
        scenario=scenario,
        program=program,
        home=home,
        robot=robot,
        bind=bind,
        seed=seed,
        ambient_c=ambient,
        payload_kg=payload,
        mounting=mounting,
        version=polyscope,
        protective_runtime=protective_runtime,
        personality=personality,
        control_script=control_script,
        run_in=run_in,
        cell=cell,
        command_port=command_port,
        robot_api_port=robot_api_port,
    )
    if view:
        from monitor.simulate.view import simulate_and_watch

        simulate_and_watch(settings)
        return
    from monitor.simulate.server import serve

    serve(settings, lambda: typer.echo(announcement(settings)))


def simulate_production(
    cell: Annotated[str, typer.Argument(metavar="CELL", help="Name of the cell, or `list`.", autocompletion=complete_cell)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Where to write: .parquet, or .csv.", show_default=False)
    ] = None,
    robot: Annotated[str, typer.Option(help="Model of the arm.", autocompletion=complete_model)] = "ur5",
    hours: Annotated[float, typer.Option(help="Work of each day [h].")] = 1.0,
    days: Annotated[int, typer.Option(help="Days, with nights between them that are not recorded.")] = 1,
    speed: Annotated[float, typer.Option(metavar="PERCENT", help="Of the speed slider.")] = 100.0,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Rows a second.")] = 25.0,
    seed: Annotated[int, typer.Option(help="Of places, declared masses and noise.")] = 0,
    ambient: Annotated[float, typer.Option(help="Room temperature [°C], with a swing of 2 K over the day.")] = 22.0,
    wear: Annotated[
        str | None, typer.Option(metavar="F1,…,F6", help="Friction of the joints as multiples of the usual.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Record the production of a simulated cell, faster than real time, as RTDE would tell it."""
    from monitor.simulate.cells.catalogue import CELLS

    if cell == "list":
        if as_json:
            print_json({"cells": [{"name": name, "about": kind.about} for name, kind in CELLS.items()]})
        else:
            typer.echo("\n".join(f"{name:<17} {kind.about}" for name, kind in CELLS.items()))
        return
    from monitor.simulate.launch import numbers
    from monitor.simulate.production import ProductionSettings, arm_in_cell, record
    from monitor.simulate.scenario import Room
    from monitor.store.formats.recordings import check_table, write_table

    if output is None:
        raise BadInput("simulate-production: -o FILE is missing; expected a file that ends in .parquet or .csv")
    check_table(output)
    production = ProductionSettings(
        cell=cell,
        robot=robot,
        seed=seed,
        hours=hours,
        days=days,
        speed=speed / 100.0,
        rate_hz=rate,
        room=Room(mean_c=ambient, daily_swing_k=2.0),
    )
    recording = record(production, arm_in_cell(production, wear=numbers("--wear", wear)))
    write_table(output, recording.columns, recording.context)
    if as_json:
        print_json({"file": str(output), "rows": recording.rows, "cycles": recording.cycles, "protective_stops": len(recording.stops)})
        return
    stops = f", {len(recording.stops)} protective stops" if recording.stops else ""
    typer.echo(
        f"{output}: {cell} at {speed:g} %, {days * hours:g} h of production, {recording.cycles} cycles{stops}, {recording.rows} rows"
    )


def demo(
    seed: Annotated[int, typer.Option(help="Of the simulated arm.")] = 0,
    keep: Annotated[Path | None, typer.Option(help="Keep the history in this folder.", show_default=False)] = None,
    as_json: JsonOption = False,
) -> None:
    """The main job with nothing installed around it: a simulated UR5, weeks of replays, a joint that wears."""
    from monitor.studies.demo.display import Ticker

    with Ticker(lambda line: typer.echo(line, err=as_json), "loading the program") as ticker:
        from monitor.studies.demo.play import play

        code = play(seed=seed, keep=keep, as_json=as_json, ticker=ticker)
    raise typer.Exit(code)


def try_it(
    robot: Annotated[str, typer.Option(help="Model of the simulated arm.", autocompletion=complete_model)] = "ur5",
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Try this configuration, on a simulated arm instead of its own.")
    ] = None,
    speed: Annotated[float, typer.Option(help="So many times as fast as life; 20000: a day in four seconds.")] = 20_000.0,
    scenario: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="What happens in the arm's life.", autocompletion=complete_scenario)
    ] = "try",
    days: Annotated[float | None, typer.Option(help="End after so many days; else with Ctrl-C.", show_default=False)] = None,
    seed: Annotated[int, typer.Option(help="Of the simulated arm.")] = 0,
    keep: Annotated[Path | None, typer.Option(help="Keep history and configuration in this folder.", show_default=False)] = None,
) -> None:
    """Months in minutes: the real daemon with page and alerts, with a simulated arm that wears. Nothing real moves."""
    from monitor.simulate.scenario import load_scenario
    from monitor.studies.trial import Trial, play

    if not LEAST_SPEED <= speed <= MOST_SPEED:
        raise BadInput(f"--speed {speed:g}: expected {LEAST_SPEED:g} to {MOST_SPEED:g}")
    if days is not None and not days > 0.0:
        raise BadInput(f"--days {days:g}: expected more than 0")
    if keep is not None and (keep / "try.toml").exists():
        raise BadInput(f"{keep}: holds a trial already; give another folder, because time cannot begin again in its history")
    load_scenario(scenario)  # a wrong name is said before anything starts
    play(Trial(robot=robot, scenario=scenario, speed=speed, days=days, seed=seed, keep=keep, config=config))


COMMANDS: Commands = {"simulate": simulate, "simulate-production": simulate_production, "demo": demo, "try": try_it}
