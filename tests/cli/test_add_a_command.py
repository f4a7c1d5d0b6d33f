"""The walk-through of docs/CONTRIBUTING.md, "Add a command": its steps, read from the page, in a copy of the program."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from monitor.store.store import Store

ROOT = Path(__file__).parents[2]
DAY_S = 86_400.0


def section() -> str:
    page = (ROOT / "docs" / "CONTRIBUTING.md").read_text("utf-8")
    return page.partition("\n## Add a command\n")[2].partition("\n## ")[0]


(MODULE,) = (textwrap.dedent(block) for block in re.findall(r"^ *```python\n(.*?)^ *```", section(), re.MULTILINE | re.DOTALL))
BEFORE = re.search(r"here after `(\w+)`", section())[1]  # the topic that stands before the new one in TOPICS


class Program:
    """A copy of the program, and a robot with four windows in its history."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.main = folder / "monitor" / "cli" / "main.py"
        self.room = self.main.parent
        self.config = folder / "cell.toml"

    def run(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        environment = os.environ | {"PYTHONPATH": str(self.folder)}
        command = [sys.executable, "-m", "monitor", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=100, check=False, cwd=self.folder, env=environment)


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Program:
    """The copy after the page's edits: one new module, two names in main.py."""
    made = Program(tmp_path_factory.mktemp("program"))
    # with what is compiled already, but for files that another worker is just writing
    shutil.copytree(ROOT / "monitor", made.folder / "monitor", ignore=shutil.ignore_patterns("*.pyc.*"))
    shutil.copytree(ROOT / "config", made.folder / "config")
    (made.room / "outcomes.py").write_text(MODULE, "utf-8")
    text = made.main.read_text("utf-8")
    for place, new in ((r"^from monitor\.cli import \(?\s*", "outcomes, "), (rf"^TOPICS = \([^)]*\b{BEFORE},", " outcomes,")):
        text, edits = re.subn(place, lambda match, new=new: match[0] + new, text, count=1, flags=re.MULTILINE)
        assert edits == 1, f"main.py has no place like {place!r}"
    made.main.write_text(text, "utf-8")
    made.config.write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n')
    with Store.open(made.folder / "history") as store:
        for day, reason in enumerate(("", "the cell's door is open", "", "no permit")):
            window = store.ledger.claim(day * DAY_S, "scheduled", day * DAY_S)
            store.ledger.end(window, "skipped" if reason else "aborted", reason, day * DAY_S + 60.0)
    return made


def test_the_page_names_a_topic_that_exists():
    """The module after which the page puts the new one is a topic, and so is every module that has a table of commands."""
    from monitor.cli import main

    names = [topic.__name__.rpartition(".")[2] for topic in main.TOPICS]
    assert BEFORE in names
    modules = {path.stem for path in (ROOT / "monitor" / "cli").rglob("*.py") if "\nCOMMANDS: Commands = " in path.read_text("utf-8")}
    assert set(names) == modules


def test_the_new_command_is_in_the_help(program):
    """`--help` lists it in the place that TOPICS gives it, and its own help has its options."""
    listed = re.findall(r"^  ([a-z]+) ", program.run("--help").stdout.partition("Commands:")[2], re.MULTILINE)
    before = list(importlib.import_module(f"monitor.cli.{BEFORE}").COMMANDS)[-1]
    assert listed.index("outcomes") == listed.index(before) + 1
    assert "--last" in program.run("outcomes", "--help").stdout


def test_the_new_command_runs(program):
    """As text and as JSON; `--last` is used."""
    assert program.run("outcomes", "-c", str(program.config)).stdout == "2 aborted, 2 skipped\n"
    document = json.loads(program.run("outcomes", "-c", str(program.config), "--last", "1", "--json").stdout)
    assert document == {"robot": "cell-1", "outcomes": {"skipped": 1}}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-c", "cell.toml", "--last", "0"), "joint-monitor: --last 0: expected 1 or more\n"),
        (("-c", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_a_mistake_is_a_sentence_and_exit_code_2(program, arguments, message):
    """Nothing on standard output, no traceback."""
    ended = program.run("outcomes", *arguments)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert message in ended.stderr
    assert "Traceback" not in ended.stderr


def test_the_new_module_has_the_styles_approval(program):
    """Ruff finds nothing in the page's module, and would not format it otherwise."""
    module = str(program.room / "outcomes.py")
    for check in (["check"], ["format", "--check"]):
        command = [sys.executable, "-m", "ruff", *check, "--config", str(ROOT / "pyproject.toml"), module]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
