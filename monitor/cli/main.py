"""The program `joint-monitor`, made of the commands of its topics.

A topic is a module with a table COMMANDS, and perhaps one of GROUPS. A further topic is one entry of TOPICS. Modules import what is heavy
inside of their functions, so that `--help` is quick.
"""

import errno
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from types import ModuleType
from typing import Annotated, Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

from monitor import __version__
from monitor.cli import (
    alerts,
    daemon,
    design,
    gateway,
    history,
    identify,
    init,
    judge,
    maintenance,
    motion,
    plant,
    reports,
    simulate,
)
from monitor.cli.options import LAWS
from monitor.config.extras import absent
from monitor.errors import BadInput, MonitorError, StoreError

# typer brings its own click, or uses the one that is installed: of either, what both kinds of mistakes are
UsageError = cast("type[Exception]", typer.BadParameter.__base__)


class Command(TyperCommand):
    """A command whose help names the friction laws, and that corrects a line which names a configuration in the wrong way."""

    def get_params(self, ctx: Any) -> list[Any]:  # the types are private to typer
        """The parameters. Click calls this before it parses arguments or prints help."""
        parameters: list[Any] = super().get_params(ctx)
        for parameter in parameters:
            text = getattr(parameter, "help", None)
            if text and LAWS in text:
                from monitor.model.friction import law_choices

                parameter.help = text.replace(LAWS, law_choices())
        return parameters

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # the types are private to typer
        """Read the arguments. Click calls this. Raises BadInput with the line that would be right, else as click does."""
        line = list(args)
        try:
            return super().parse_args(ctx, args)
        except UsageError as error:
            parameters = self.get_params(ctx)
            names = {name for parameter in parameters for name in parameter.opts}
            said = error.format_message().rstrip(".")  # type: ignore[attr-defined]
            with_value = {name for parameter in parameters if not getattr(parameter, "is_flag", False) for name in parameter.opts}
            meant = _with_option(line, said, with_value) if "--config" in names else _without_option(line, names)
            if meant is None:
                raise
            command = shlex.join(["joint-monitor", str(ctx.info_name), *meant])
            raise BadInput(f"{ctx.info_name}: {said}; meant is perhaps: {command}") from None


class WholeHelp(TyperGroup):
    """A program whose list of commands shows the whole first sentence of each, in as many lines as it needs."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # the types are private to typer
        """Write the list. Click calls this for --help."""
        commands = [(name, command) for name in self.list_commands(ctx) if (command := self.get_command(ctx, name)) is not None]
        rows = [(name, " ".join((command.help or "").split("\n\n")[0].split())) for name, command in commands if not command.hidden]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


# in the order of --help
TOPICS = (init, daemon, simulate, identify, design, alerts, maintenance, judge, motion, history, reports, plant, gateway)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"joint-monitor {__version__}")
        raise typer.Exit


def _common(
    _: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and leave.")] = False,
) -> None:
    pass


def program(topics: Sequence[ModuleType]) -> typer.Typer:
    """The program with the commands of these topics."""
    made = typer.Typer(
        name="joint-monitor",
        help="Friction health of a robot arm: replay, re-identify, track, and tell over Zenoh.",
        no_args_is_help=True,
        cls=WholeHelp,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # brackets in a help text are units, not markup
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    made.callback()(_common)
    for topic in topics:
        for name, function in topic.COMMANDS.items():
            made.command(name=name, cls=Command)(function)
        for name, group in getattr(topic, "GROUPS", {}).items():
            words = typer.Typer(cls=WholeHelp, rich_markup_mode=None)
            words.callback(invoke_without_command=True)(group.default)
            for word, function in group.words.items():
                words.command(name=word, cls=Command)(function)
            made.add_typer(words, name=name)
    return made


app = program(TOPICS)


def _with_option(line: list[str], said: str, with_value: set[str]) -> list[str] | None:
    """The line with --config before the file that it names; None where it names none, or has that option.

    with_value : the options after which a value stands, which may be another file.
    """
    named = [
        part for before, part in pairwise(["", *line]) if part.endswith(".toml") and not part.startswith("-") and before not in with_value
    ]
    is_this = "unexpected extra argument" in said or (said.startswith("Missing option") and "--config" in said)
    if not named or not is_this or any(part.startswith(("-c", "--config")) for part in line):
        return None
    rest = [part for part in line if part != named[0]]
    return [*rest, "--config", named[0]]


def _without_option(line: list[str], names: set[str]) -> list[str] | None:
    """The line of a command that takes the file as it is, without --config; None where it has none, or takes no file."""
    given = next((part for part in line if part in {"-c", "--config"}), None)
    if given is None or "file" not in names:
        return None
    return [part for part in line if part != given]


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
    # a daemon lives for months, and need not hold the parameters of every other command
    named = [topic for topic in TOPICS if sys.argv[1:] and sys.argv[1] in topic.COMMANDS]
    try:
        (program(named) if named else app)()
    except MonitorError as error:
        typer.echo(f"joint-monitor: {error}", err=True)
        sys.exit(error.exit_code)
    except ModuleNotFoundError as error:  # of an extra: packages are imported where they are used
        if error.name is None or error.name.partition(".")[0] == "monitor":
            raise
        typer.echo(f"joint-monitor: {absent(error.name.partition('.')[0], sys.argv[1])}", err=True)
        sys.exit(BadInput.exit_code)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of standard output has ended, as in `joint-monitor watch | head`
        sys.exit(0)
    except OSError as error:
        if error.filename is not None or error.errno not in {errno.ENOSPC, errno.EDQUOT, errno.EIO}:
            raise
        try:
            os.write(sys.stdout.fileno(), b"\n")
        except OSError:  # it is standard output whose disk is full; what is left for it would be refused at the end once more
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            typer.echo(f"joint-monitor: standard output cannot be written: {error.strerror}", err=True)
            sys.exit(StoreError.exit_code)
        raise
