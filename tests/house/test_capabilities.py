"""The table of capabilities is whole: each test exists, and each entry of the program's registries has its row."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from monitor.acquire.safety import conditions as of_motion
from monitor.cli.main import app
from monitor.design.objective import OBJECTIVES
from monitor.errors import ReplayAborted
from monitor.gateway.settings import CHANNELS
from monitor.judge.alerts import conditions as of_alerts
from monitor.model.friction import LAWS
from monitor.plant.screen.interface import Guarded, Interface
from monitor.publish.registry import KINDS
from monitor.simulate.faults import FAULTS
from tests.house import capabilities

ROOT = Path(__file__).parents[2]


def commands(group: Any, before: tuple[str, ...] = ()) -> Iterator[str]:
    """The names of all commands, those of a group after its name."""
    for name, command in getattr(group, "commands", {}).items():
        yield " ".join((*before, name))
        yield from commands(command, (*before, name))


def routes(folder: str) -> set[str]:
    """The addresses that the modules of a folder serve: the first argument of each `Route`."""
    trees = (ast.parse(path.read_text("utf-8")) for path in (ROOT / "monitor" / folder).rglob("*.py"))
    calls = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "Route")
    return {call.args[0].value for call in calls if isinstance(call.args[0], ast.Constant)}


REGISTERED = {
    "COMMANDS": set(commands(get_command(app))),
    "DOCUMENTS": set(KINDS),
    "ALERTS": set(of_alerts.CONDITIONS),
    "MOTION_CONDITIONS": {condition.name for condition in of_motion.CONDITIONS},
    "CHANNELS": {kind.section for kind in CHANNELS},
    "FRICTION_LAWS": set(LAWS),
    "OBJECTIVES": set(OBJECTIVES),
    "SCENARIOS": {path.stem for path in (ROOT / "config" / "scenarios").glob("*.toml")},
    "SIMULATED_FAULTS": set(FAULTS),
    "INTERFACE": {route.operation_id for route in Interface(*[None] * 6).application().routes if isinstance(route, Guarded)},
    "PAGES": {f"arm {route}" for route in routes("views")} | {f"plant {route}" for route in routes("plant")},
}


@pytest.mark.parametrize("table", REGISTERED)
def test_what_the_program_registers_has_a_row_and_nothing_is_lost(table):
    """A new entry of a registry needs a row, and an entry that is gone takes its capability with it."""
    assert set(getattr(capabilities, table)) == REGISTERED[table]


def test_every_harmless_end_of_a_motion_has_a_row():
    """By its cause."""
    assert set(ReplayAborted.HARMLESS) <= set(capabilities.ENDS_OF_A_MOTION)


@cache
def top_of(path: str) -> list[ast.stmt]:
    """The statements of a file of tests; none where there is no such file."""
    file = ROOT / "tests" / path
    return ast.parse(file.read_text("utf-8")).body if file.is_file() else []


def functions(path: str) -> dict[str, ast.FunctionDef]:
    """Those of a file of tests."""
    return {node.name: node for node in top_of(path) if isinstance(node, ast.FunctionDef)}


def test_every_capability_has_a_test_that_exists():
    """A test that was moved or renamed takes its row along."""
    assert [f"{path}::{name}" for path, names in by_file().items() for name in sorted(names - functions(path).keys())] == []


def is_soak(path: str, name: str) -> bool:
    """Whether the whole test is left to `make soak`, by its own mark or by its file's."""
    marks = [ast.unparse(node) for node in top_of(path) if isinstance(node, ast.Assign)]
    whole = any(text.startswith("pytestmark") and "mark.soak" in text for text in marks)
    return whole or "pytest.mark.soak" in map(ast.unparse, functions(path)[name].decorator_list)


ONLY_IN_SOAK = {"a study's workers killed"}  # for minutes


def test_every_capability_has_a_test_that_is_no_soak():
    """`make test` holds each; the soak adds evidence."""
    soak = {f"{path}::{name}" for path, names in by_file().items() for name in names if is_soak(path, name)}
    rows = [row for table in capabilities.CAPABILITIES.values() for row in table.items()]
    assert {what for what, tests in rows if soak.issuperset(tests)} == ONLY_IN_SOAK


def by_file() -> dict[str, set[str]]:
    """The tests that the table names, by their file."""
    found: dict[str, set[str]] = {}
    for rows in capabilities.CAPABILITIES.values():
        for what, tests in rows.items():
            assert tests, what
            for test in tests:
                path, _, name = test.partition("::")
                found.setdefault(path, set()).add(name)
    return found
