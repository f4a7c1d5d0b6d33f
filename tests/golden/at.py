"""The command line at a time of one's own, one command after the other in one process, which is several times faster than one each.

`python -m tests.golden.at` reads a JSON object a line: `command`, `cwd`, `at_unix_s`; and answers each with `exit`, `stdout`, `stderr`.
With arguments, `python -m tests.golden.at UNIX_SECONDS COMMAND …` is that one command.
"""

import contextlib
import io
import json
import os
import sys
import time
import traceback
import warnings
from collections.abc import Iterator
from typing import Any

_now = [0.0]


@contextlib.contextmanager
def stopped_clock() -> Iterator[None]:
    """The time of day is that of the command."""
    running = time.time
    time.time = lambda: _now[0]
    try:
        yield
    finally:
        time.time = running


def main() -> None:
    """Stop the clock before anything of `monitor` is imported, then be `joint-monitor`."""
    time.time = lambda: _now[0]
    if len(sys.argv) > 1:
        _now[0] = float(sys.argv[1])
        from .entry import command_line

        sys.argv = ["joint-monitor", *sys.argv[2:]]
        command_line()
        return
    answers, questions = sys.stdout, sys.stdin
    sys.stdin = io.StringIO()
    warnings.simplefilter("always")  # not once a process: another order of the commands must not make another text
    for line in questions:
        answers.write(json.dumps(answer(json.loads(line))) + "\n")
        answers.flush()


def answer(asked: dict[str, Any]) -> dict[str, Any]:
    """What the command did."""
    from .entry import command_line

    _now[0] = asked["at_unix_s"]
    os.chdir(asked["cwd"])
    sys.argv = ["joint-monitor", *asked["command"]]
    code: Any = 0
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            command_line()
        except SystemExit as end:
            code = end.code
        except Exception as fault:
            code = "a fault: " + traceback.format_exception_only(fault)[-1].strip()
    return {"exit": code or 0, "stdout": out.getvalue(), "stderr": err.getvalue()}


if __name__ == "__main__":
    main()
