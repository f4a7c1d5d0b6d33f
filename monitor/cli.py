"""The commands. Thin: each reads its arguments, calls one room, and prints; heavy imports stand where they are used."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from monitor import __version__
from monitor.errors import BadConfiguration, BadInput, MonitorError

app = typer.Typer(
    name="joint-monitor",
    help="Friction health of a robot arm: replay, re-identify, track, and tell over Zenoh.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

EXIT_CONFIG = 78  # sysexits.h; the service manager must not restart into the same mistake

ConfigOption = Annotated[Path, typer.Option("--config", "-c", help="The robot's TOML file.", show_default=False)]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]


def main() -> None:
    """Entry point: a user's mistake becomes a sentence and an exit code, never a traceback."""
    try:
        app(standalone_mode=True)
    except MonitorError as error:
        print(f"joint-monitor: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.stderr.close()  # `joint-monitor watch | head`: the reader has left
        sys.exit(0)
