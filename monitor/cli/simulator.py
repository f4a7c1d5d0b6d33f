"""The command `simulate`: a simulated UR controller."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import Commands, MountingOrNoneOption, complete_model, complete_scenario


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
        str | None, typer.Option(help="Values beside the motion: ideal (the default), or recorded as from real arms.", show_default=False)
    ] = None,
    control_script: Annotated[
        str | None, typer.Option(help="ur-rtde's script: modelled (the default), or executed line by line.", show_default=False)
    ] = None,
    program: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Production program that is loaded, as TOML.", show_default=False)
    ] = None,
    home: Annotated[
        str | None, typer.Option(metavar="Q1,…,Q6", help="Joint positions at the start [rad], as --home=….", show_default=False)
    ] = None,
    robot_api_port: Annotated[int, typer.Option(help="Robot API of a PolyScope X (software 10); a port below 1024 may need rights.")] = 80,
    command_port: Annotated[int, typer.Option(help="JSON lines: truth, time, wear, faults.")] = 30020,
    view: Annotated[bool, typer.Option("--view", help="Show the arm's state live in the terminal.")] = False,
    fault: Annotated[
        str | None,
        typer.Option(metavar="'NAME key=value …'", help="Make a fault in the simulator that runs at --bind.", show_default=False),
    ] = None,
) -> None:
    """Be a UR controller made of software, for the unmodified ur-rtde, until Ctrl-C."""
    from monitor.simulate.launch import announcement, numbers, settings_from
    from monitor.simulate.program_tree import load_tree
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
        personality=personality,
        control_script=control_script,
        home_rad=numbers("--home", home),
        program=None if program is None else load_tree(program),
        command_port=command_port,
        robot_api_port=robot_api_port,
    )
    if view:
        from monitor.simulate.view import simulate_and_watch

        options = {"--robot": robot, "--scenario": scenario, "--ambient": ambient, "--payload": payload, "--mounting": mounting}
        options |= {"--polyscope": polyscope, "--protective-runtime": protective_runtime, "--personality": personality, "--home": home}
        options |= {"--control-script": control_script, "--program": None if program is None else str(program)}
        given = [f"{option}={value}" for option, value in options.items() if value is not None]
        fixed = [f"--bind={bind}", f"--seed={seed}", f"--command-port={command_port}", f"--robot-api-port={robot_api_port}"]
        simulate_and_watch([*fixed, *given], bind, command_port)
        return
    from monitor.simulate.server import serve

    serve(settings, lambda: typer.echo(announcement(settings)))


COMMANDS: Commands = {"simulate": simulate}
