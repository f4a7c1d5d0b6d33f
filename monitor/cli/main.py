"""The program `joint-monitor`, made of the commands of its topics.

A topic is a module with a table COMMANDS, and perhaps one of GROUPS. A further topic is one entry of TOPICS. Modules import what is heavy
inside of their functions, so that `--help` is quick.
"""

import os
import sys
from collections.abc import Iterator
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from monitor import __version__
from monitor.cli.arm import bus, hand_over, history, inspected, live, motion, service, serviced
from monitor.cli.hints import CommandWithHints
from monitor.cli.offline import assess, design, identification, models, prior, production, query, reassess, reports
from monitor.cli.plant import gateway, plant
from monitor.cli.setup import init
from monitor.cli.simulated import demo, simulator, trial
from monitor.errors import MonitorError


class WholeHelp(TyperGroup):
    """A program whose list of commands shows the whole first sentence of each, in as many lines as it needs."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # the types are private to typer
        """Write the list. Click calls this for --help."""
        commands = [(name, command) for name in self.list_commands(ctx) if (command := self.get_command(ctx, name)) is not None]
        rows = [(name, " ".join((command.help or "").split("\n\n")[0].split())) for name, command in commands if not command.hidden]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


# in the order of --help
TOPICS = (
    init,
    service,
    simulator,
    models,
    identification,
    production,
    live,
    design,
    bus,
    serviced,
    inspected,
    assess,
    reassess,
    motion,
    hand_over,
    history,
    query,
    reports,
    prior,
    plant,
    gateway,
    demo,
    trial,
)

app = typer.Typer(
    name="joint-monitor",
    help="Friction health of a robot arm: replay, re-identify, track, and tell over Zenoh.",
    no_args_is_help=True,
    cls=WholeHelp,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # brackets in a help text are units, not markup
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _topic in TOPICS:
    for _name, _function in _topic.COMMANDS.items():
        app.command(name=_name, cls=CommandWithHints)(_function)
    for _name, _group in getattr(_topic, "GROUPS", {}).items():
        _words = typer.Typer(cls=WholeHelp, rich_markup_mode=None)
        _words.callback(invoke_without_command=True)(_group.alone)
        for _word, _function in _group.words.items():
            _words.command(name=_word, cls=CommandWithHints)(_function)
        app.add_typer(_words, name=_name)


def every_command(group: Any = None, before: str = "") -> Iterator[tuple[str, Any]]:
    """Every command with its name, as click knows it; the words of a command follow it: `plant`, `plant backup`, …"""
    words: dict[str, Any] = getattr(group or typer.main.get_command(app), "commands", {})
    for name, command in words.items():
        yield f"{before}{name}", command
        yield from every_command(command, f"{before}{name} ")


def main() -> None:
    """Run the program. A user's mistake becomes a sentence on standard error and an exit code, never a traceback."""
    # set before numpy is imported: with matrices of 60 columns, several threads take several times as long as one
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        app()
    except MonitorError as error:
        typer.echo(f"joint-monitor: {error}", err=True)
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of standard output has ended, as in `joint-monitor watch | head`
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
