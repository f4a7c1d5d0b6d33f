"""The conditions of a new configuration that do not hold, and the one command that is next."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from monitor.cli.options import FOR_ALL, load_configuration

if TYPE_CHECKING:
    from monitor.config.first_file import Answers

SERVICE_USER = "joint-monitor"  # made by deploy/joint-monitor.sysusers


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
        typer.echo(f"  joint-monitor record --config {path} --seconds 60 -o empty.parquet")
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
    return f"joint-monitor {name} --config {path}"
