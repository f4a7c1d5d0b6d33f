"""The command `prior`, which learns from a fleet's histories what a new arm of the same model may expect."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import Commands, ForceOption, JsonOption, print_json, refuse_overwriting


def prior(
    folders: Annotated[
        list[Path], typer.Argument(metavar="FOLDER…", help="State folders of daemons, or a folder of such folders.", show_default=False)
    ],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="The prior (.json) for [drift] prior.", show_default=False)] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """What a fleet's histories say of a new arm of the same model: temperature law and noise of each joint. Nothing is changed in them."""
    import json
    import time

    from monitor import __version__
    from monitor.config.files import write_whole
    from monitor.judge.drift.settings import DriftSettings
    from monitor.judge.temperature.laws import TemperatureSettings
    from monitor.publish.timestamps import rfc3339
    from monitor.studies.fleet_prior.histories import arms_of
    from monitor.studies.fleet_prior.learn import learn_prior
    from monitor.views.terminal.progress import status
    from monitor.views.terminal.studies import print_prior

    refuse_overwriting(output, force)
    with status("reading histories"):
        arms, silent = arms_of(folders)
    document = learn_prior(arms, DriftSettings(), TemperatureSettings())
    document = {"made_at": rfc3339(time.time()), "software": f"joint-monitor {__version__}", **document}
    document["learnt_from"]["left_out"] += silent
    if output is not None:
        write_whole(output, json.dumps(document, indent=1).encode() + b"\n", mode=0o644)
    if as_json:
        print_json(document)
    else:
        print_prior(document, output)


COMMANDS: Commands = {"prior": prior}
