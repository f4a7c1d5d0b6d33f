"""The map in `monitor/__init__.py` against the linter's contracts and the folder itself."""

import re
import tomllib
from pathlib import Path

import monitor

ROOT = Path(__file__).parents[1]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
MAP = re.findall(r"^    (\w+) +(∘ )?(\S.*)$", monitor.__doc__.partition("only copy")[2], re.MULTILINE)


def contract(kind, word=""):
    return next(each for each in CONTRACTS if each["type"] == kind and word in each["name"])


def rooms(names):
    return [name.strip().removeprefix("monitor.") for name in names]


def test_the_map_names_every_entry_of_the_package_and_nothing_else():
    """At most 18 entries; the map's own file is not one that it names."""
    entries = {path.stem for path in (ROOT / "monitor").iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert {name for name, _, _ in MAP} == entries - {"__init__"}
    assert len(entries) <= 18


def test_the_map_stands_in_the_order_of_the_layers():
    """The linter's layers from top to bottom; rooms of one layer stand side by side."""
    layers = [rooms(layer.split("|")) for layer in contract("layers")["layers"]]
    order = [name for name, _, _ in MAP]
    for layer in layers:
        assert set(order[: len(layer)]) == set(layer)
        order = order[len(layer) :]
    assert not order


def test_the_rooms_marked_pure_are_those_that_the_linter_holds_pure():
    """The circle in the map and the contract's sources."""
    assert {name for name, pure, _ in MAP if pure} == set(rooms(contract("forbidden", "pure")["source_modules"]))


def test_the_linter_refuses_circles_everywhere():
    """Among modules and among folders, imports for annotations included: no import is ignored."""
    circles = contract("acyclic_siblings")
    assert circles["ancestors"] == ["monitor"]
    assert "ignore_imports" not in circles
    importlinter = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    assert not importlinter.get("exclude_type_checking_imports", False)


def test_every_room_says_in_one_line_what_it_is():
    """Each folder of Python modules has a docstring."""
    for face in (ROOT / "monitor").rglob("__init__.py"):
        assert face.read_text("utf-8").startswith('"""'), face
