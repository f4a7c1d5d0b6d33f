"""The map in `monitor/__init__.py` against the linter's contracts and the folder itself."""

import ast
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

import monitor

ROOT = Path(__file__).parents[1]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
MAP = re.findall(r"^    (\w+) +(∘ )?(\S.*)$", monitor.__doc__.partition("only copy")[2], re.MULTILINE)

FORBIDDEN_NAMES = {"open", "print", "input", "exec", "eval", "__import__"}
FORBIDDEN_METHODS = {"read_text", "write_text", "read_bytes", "write_bytes", "tofile"}
FORBIDDEN_OF_NUMPY = {"save", "savez", "savez_compressed", "savetxt", "load", "loadtxt", "genfromtxt", "fromfile", "memmap"}
GENERATORS = {"default_rng", "Generator", "BitGenerator", "SeedSequence", "PCG64", "Philox"}  # of np.random: they have a state of their own


def contract(kind, word=""):
    return next(each for each in CONTRACTS if each["type"] == kind and word in each["name"])


def rooms(names):
    return [name.strip().removeprefix("monitor.") for name in names]


def test_the_map_names_every_entry_of_the_package_and_nothing_else():
    """At most 20 entries; the map's own file is not one that it names."""
    entries = {path.stem for path in (ROOT / "monitor").iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert {name for name, _, _ in MAP} == entries - {"__init__"}
    assert len(MAP) <= 20


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
    pure = contract("forbidden", "pure")
    assert {name for name, circle, _ in MAP if circle} == set(rooms(pure["source_modules"]))
    assert pure["ignore_imports"] == ["monitor.model.robot -> importlib"]


def modules(room):
    path = ROOT / "monitor" / room
    return sorted(path.rglob("*.py")) if path.is_dir() else [path.with_suffix(".py")]


def forbidden_calls(text):
    """What a pure room must not do although it imports nothing for it: files, the terminal, the clock, chance without a seed."""
    found = []
    for node in ast.walk(ast.parse(text)):
        name = ast.unparse(node) if isinstance(node, ast.Attribute) else ""
        owner, _, last = name.rpartition(".")
        if owner in {"np.random", "numpy.random"} and last not in GENERATORS:
            found.append(name)
        if not isinstance(node, ast.Call):
            continue
        call = ast.unparse(node.func)
        owner, _, last = call.rpartition(".")
        first = ast.unparse(node.args[0]) if node.args else ""
        unseeded = last == "default_rng" and ((not node.args and not node.keywords) or first == "None")
        reads_clock = last == "datetime64" and first in {"'now'", "'today'"}
        of_numpy = owner in {"np", "numpy"} and last in FORBIDDEN_OF_NUMPY
        if call in FORBIDDEN_NAMES or (owner and last in FORBIDDEN_METHODS) or unseeded or reads_clock or of_numpy:
            found.append(ast.unparse(node))
    return found


@pytest.mark.parametrize(
    "text",
    [
        "open('a')", "print(1)", "input()", "exec('')", "eval('1')", "__import__('os')", "path.read_text('utf-8')", "path.write_bytes(b'')",
        "np.save('a', x)", "np.load('a')", "np.loadtxt('a')", "x.tofile('a')", "np.fromfile('a')", "np.random.default_rng()",
        "default_rng(None)", "np.random.normal(size=3)", "np.random.seed(1)", "np.datetime64('now')",
    ],
)  # fmt: skip
def test_the_check_of_pure_rooms_finds_what_it_forbids(text):
    """One call of each kind."""
    assert forbidden_calls(text)


@pytest.mark.parametrize("room", [name for name, pure, _ in MAP if pure])
def test_a_pure_room_calls_nothing_impure(room):
    """`model.robot` alone reads a file: the packaged data of a robot."""
    found = {path.relative_to(ROOT / "monitor").as_posix(): forbidden_calls(path.read_text("utf-8")) for path in modules(room)}
    packaged = found.pop("model/robot.py", [])
    assert not any(found.values()), found
    assert all(call.startswith("files('monitor.model.robots')") for call in packaged)


def test_the_simulator_imports_nothing_by_a_name_made_at_run_time():
    """The linter cannot see such an import, so it could reach the monitor's model."""
    for path in modules("simulate"):
        text = path.read_text("utf-8")
        assert not re.search(r"import_module|__import__|runpy|\b(exec|eval)\(", text), path


def test_the_simulator_knows_of_the_model_only_robots_and_trajectories():
    """Every other module of `model` is forbidden to it, so that it computes forces by its own equations."""
    known = {"robot", "fourier", "__init__"}
    others = {f"monitor.model.{path.stem}" for path in modules("model") if path.stem not in known}
    assert others <= set(contract("forbidden", "simulator")["forbidden_modules"])


def test_the_linter_refuses_circles_everywhere():
    """Among modules and among folders, imports for annotations included: no import is ignored."""
    circles = contract("acyclic_siblings")
    assert circles["ancestors"] == ["monitor"]
    assert "ignore_imports" not in circles
    importlinter = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    assert not importlinter.get("exclude_type_checking_imports", False)


def test_every_room_has_a_docstring():
    """Each folder of Python modules has a docstring."""
    for face in (ROOT / "monitor").rglob("__init__.py"):
        assert face.read_text("utf-8").startswith('"""'), face


def test_no_test_imports_a_conftest():
    """There are several of that name, and which one is found depends on which folder was read first."""
    imported = re.compile(r"^\s*(from|import) conftest\b", re.MULTILINE)
    assert [path for path in (ROOT / "tests").rglob("test_*.py") if imported.search(path.read_text("utf-8"))] == []


def private_names_used(text):
    """Private names of the program that this text imports, or that it takes from a module of the program."""

    def private(name):
        return name.startswith("_") and not name.startswith("__")

    tree, modules, used = ast.parse(text), set(), []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "monitor":
            used += [f"{node.module}.{each.name}" for each in node.names if private(each.name)]
            folder = ROOT.joinpath(*node.module.split("."))
            modules |= {each.asname or each.name for each in node.names if (folder / f"{each.name}.py").is_file()}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            used += [f"{node.value.id}.{node.attr}"] * private(node.attr)
    return used


@pytest.mark.parametrize(
    "text", ["from monitor.judge.assess import _assess", "def f():\n    from monitor.acquire.ur import stream\n    stream._wait()"]
)
def test_the_check_of_private_names_finds_them(text):
    """Imported, or taken from their module."""
    assert len(private_names_used(text)) == 1


def test_no_test_imports_a_private_name_of_the_program():
    """What a test needs is worth a public name: otherwise the test holds how it is done instead of what it does."""
    used = {str(path.relative_to(ROOT)): private_names_used(path.read_text("utf-8")) for path in (ROOT / "tests").rglob("*.py")}
    assert {path: names for path, names in used.items() if names} == {}


def test_no_two_modules_listen_at_one_address():
    """A module runs on one worker; 127.0.0.1 is everybody's, with ports that the kernel chooses."""
    owners = {}
    for module in sorted((ROOT / "tests").rglob("test_*.py")):
        for address in set(re.findall(r"127\.(?!0\.0\.)\d+\.\d+\.\d+", module.read_text("utf-8"))):
            owners.setdefault(address, []).append(module.name)
    assert ["test_robot_api.py"] in owners.values()
    assert {address: several for address, several in owners.items() if len(several) > 1} == {}


def test_whatever_moves_an_arm_in_real_time_is_marked():
    """Many beside each other would be late: a module that starts an arm and replays on it has the mark `real_time`."""
    starts = re.compile(r"\bsimulated_arm\(|replaying\(|Simulated\(|\bSpawned\(")
    replays = re.compile(r"monitor\.acquire\.replay import [^\n]*\breplay\b|replaying\(|\"replay\"|\"--now\"")
    for path in sorted((ROOT / "tests").glob("*/test_*.py")):
        text = path.read_text("utf-8")
        if starts.search(text) and replays.search(text):
            assert "mark.real_time" in text, path


FOLDERS = {".ci", "config", "deploy", "docs", "monitor", "tests"}
TOP_LEVEL = FOLDERS | {".github", ".gitignore", "LICENSE", "Makefile", "README.md", "constraints.txt", "pyproject.toml"}


def test_the_top_level_holds_what_belongs_there_and_nothing_else():
    """A file that somebody's trial has left there is no part of the project."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("this is no checkout, or git is absent")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert {name.partition("/")[0] for name in listed.split("\0") if name} == TOP_LEVEL
