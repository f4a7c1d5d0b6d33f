"""The program's commands as the tests call them: in a process of their own, or in this one, which is faster."""

import subprocess
import sys

from typer.testing import CliRunner

from monitor.cli.main import app


def program(*arguments: object, timeout_s: float = 100.0) -> "subprocess.CompletedProcess[str]":
    """The command in a process of its own, as a person runs it."""
    command = [sys.executable, "-m", "monitor", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


def printed(*arguments: object, code: int = 0) -> str:
    """What the command prints on standard output, in this process. An error of the command is raised, not printed."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return result.stdout
