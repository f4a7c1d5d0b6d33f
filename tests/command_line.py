"""The program's commands as the tests call them: in a process of their own, or in this one, which is faster."""

import io
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

from typer.testing import CliRunner

from monitor.cli.main import app, main


def program(*arguments: object, timeout_s: float = 100.0) -> "subprocess.CompletedProcess[str]":
    """The command in a process of its own, as a person runs it."""
    command = [sys.executable, "-m", "monitor", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


def ended(*arguments: object, cwd: Path | None = None) -> "subprocess.CompletedProcess[str]":
    """What `program` gives, from the same entry point in this process: it saves half a second of imports, or two where scipy is needed."""
    command = ["joint-monitor", *map(str, arguments)]
    output, errors, code = io.StringIO(), io.StringIO(), 0
    with patch.object(sys, "argv", command), chdir(cwd or Path.cwd()), redirect_stdout(output), redirect_stderr(errors):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
    return subprocess.CompletedProcess(command, code, output.getvalue(), errors.getvalue())


def printed(*arguments: object, code: int = 0) -> str:
    """What the command prints on standard output, in this process. An error of the command is raised, not printed."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return result.stdout
