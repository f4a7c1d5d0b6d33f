"""The README against the code: what it tells people to type must exist."""

import re
from pathlib import Path

import pytest
import typer.main

from monitor.cli import app

README = (Path(__file__).parent.parent / "README.md").read_text("utf-8")
COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
TYPED = [
    match.group(1).replace("\\\n", " ")
    for match in re.finditer(r"(?:\$ |`)joint-monitor ((?:[a-z]+)(?: [^\n`]*?(?:\\\n[^\n`]*)*)?)(?=[\n`])", README)
]


def options(command):
    return {name for parameter in COMMANDS[command].params for name in (*parameter.opts, *parameter.secondary_opts)}


@pytest.mark.parametrize("line", sorted(set(TYPED)))
def test_every_command_line_of_the_readme_exists(line):
    """The command, and each of its options."""
    command = line.split()[0]
    assert command in COMMANDS
    asked = set(re.findall(r"(?<!\S)\[?(--?[a-z][a-z-]*)", line))
    assert asked <= options(command), f"unknown: {asked - options(command)}"


def test_every_option_named_in_a_table_of_identify_exists():
    """The first cell of each row that begins with an option."""
    named = set(re.findall(r"--[a-z][a-z-]+", "\n".join(re.findall(r"^\| (`--.*?) \| ", README, re.MULTILINE))))
    assert len(named) > 8
    assert named <= options("identify")


def test_every_command_is_in_the_readme():
    """Nothing that exists is left untold."""
    told = {line.split()[0] for line in TYPED}
    assert set(COMMANDS) - told <= {"demo"}  # `make demo` tells it
    assert "make demo" in README
