"""The command `models`, which lists the arms that the package knows."""

import typer

from monitor.cli.options import Commands, JsonOption, print_json


def models(as_json: JsonOption = False) -> None:
    """List the models of arms, with what is known of each: generation, payload, torque per ampere."""
    import numpy as np

    from monitor.model.reported_gains import REPORTED_GAINS
    from monitor.model.robot import load_robot, robot_names

    rows = []
    for name in robot_names():
        robot = load_robot(name)
        published = bool(np.all(np.isfinite(robot.drive_gain_nm_per_a)))
        gains = "published" if published else "reported of one arm" if name in REPORTED_GAINS else "unknown"
        rows.append({"model": name, "generation": robot.generation, "payload_max_kg": robot.payload_max_kg, "gains": gains})
    if as_json:
        print_json({"models": rows})
        return
    for row in rows:
        typer.echo(f"{row['model']:<6} {row['generation']:<9} up to {row['payload_max_kg']:>4g} kg   gains {row['gains']}")


COMMANDS: Commands = {"models": models}
