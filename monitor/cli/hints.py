"""Answers to a command line that is nearly right: a configuration without its option, or with one where none belongs."""

import shlex
from itertools import pairwise
from typing import Any, cast

import typer

from monitor.cli.offline.laws import CommandWithLaws
from monitor.errors import BadInput

# typer brings its own click, or uses the one that is installed: of either, what both kinds of mistakes are
UsageError = cast("type[Exception]", typer.BadParameter.__base__)


class CommandWithHints(CommandWithLaws):
    """A command that, where its line names a configuration in the wrong way, says the line that would be right."""

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
