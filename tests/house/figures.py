"""What a reader of the program must hold, in figures: `python -m tests.house.figures [--repo DIR] [--json]`."""

import argparse
import ast
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

SMALL_LINES = 70  # a module below it with one importer belongs to its importer
CLOSURES = {"daemon": "monitor.service.run", "step": "monitor.judge.drift.step"}


def figures(repo: Path) -> dict[str, object]:
    """Every figure of the checkout `repo`, whose own package is imported by this Python in fresh processes."""
    modules = {path: path.read_text("utf-8") for path in sorted((repo / "monitor").rglob("*.py"))}
    tests = [path.read_text("utf-8") for path in (repo / "tests").rglob("*.py")]
    lines = {path: text.count("\n") for path, text in modules.items()}
    rooms: Counter[str] = Counter()
    files: Counter[str] = Counter()
    for path, count in lines.items():
        room = path.relative_to(repo / "monitor").parts[0].removesuffix(".py")
        rooms[room] += count
        files[room] += 1
    judge = {path: text for path, text in modules.items() if "judge" in path.relative_to(repo).parts}
    return {
        "lines": sum(lines.values()),
        "files": len(modules),
        "rooms": {room: {"lines": rooms[room], "files": files[room]} for room in sorted(rooms)},
        "closures": {name: closure(repo, module) for name, module in CLOSURES.items()},
        "small modules with one importer": small_with_one_importer(repo, modules),
        "numeric constants of the judge": sum(numeric_constants(text) for text in judge.values()),
        "dict[str, Any]": sum(text.count("dict[str, Any]") for text in modules.values()),
        "folders below monitor, at most": max(len(path.relative_to(repo / "monitor").parts) - 1 for path in modules),
        "files called settings.py": sum(path.name == "settings.py" for path in modules),
        "words in docs": sum(len(path.read_text("utf-8").split()) for path in (repo / "docs").glob("*.md")),
        "lines of tests": sum(text.count("\n") for text in tests),
        "tests": sum(len(re.findall(r"^def test_", text, re.MULTILINE)) for text in tests),
    }


def closure(repo: Path, module: str) -> dict[str, int]:
    """Modules of the package that importing `module` loads in a fresh process, and their lines."""
    code = (
        f"import sys, json, {module}; print(json.dumps([m.__file__ for n, m in sys.modules.items() if n.partition('.')[0] == 'monitor']))"
    )
    found = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=repo, env={"PYTHONPATH": str(repo)}, capture_output=True, text=True, check=False
    )
    if found.returncode:
        return {}
    paths = [Path(path) for path in json.loads(found.stdout)]
    assert all(path.is_relative_to(repo) for path in paths), paths[0]
    return {"lines": sum(path.read_text("utf-8").count("\n") for path in paths), "files": len(paths)}


def small_with_one_importer(repo: Path, modules: dict[Path, str]) -> int:
    """Modules below `SMALL_LINES` that exactly one other module imports; faces of folders and entry points are none."""
    importers: dict[str, set[Path]] = {}
    for path, text in modules.items():
        for name in imported(text):
            importers.setdefault(name, set()).add(path)
    count = 0
    for path, text in modules.items():
        name = ".".join(path.relative_to(repo).with_suffix("").parts)
        small = text.count("\n") < SMALL_LINES and not path.stem.startswith("__")
        count += small and len(importers.get(name, set()) - {path}) == 1
    return count


def imported(text: str) -> Iterator[str]:
    """The names that a module imports; of `from a import b` both a and a.b."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def numeric_constants(text: str) -> int:
    """Numbers that are assigned to a name of a module, or that are the default of a class's field."""
    tree = ast.parse(text)
    bodies = [tree.body, *(node.body for node in ast.walk(tree) if isinstance(node, ast.ClassDef))]
    values = (node.value for body in bodies for node in body if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None)
    return sum(numbers(value) for value in values)


def numbers(value: ast.expr) -> int:
    """How many numbers stand in an expression of numbers: 1 in `-0.5` and `6 * 3600`, 2 in `(20, 19)`, 0 where it holds anything else."""
    if isinstance(value, ast.Tuple):
        return sum(numbers(each) for each in value.elts)
    allowed = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop)
    whole = all(isinstance(node, allowed) for node in ast.walk(value))
    found = [node.value for node in ast.walk(value) if isinstance(node, ast.Constant)]
    return int(whole and bool(found) and all(isinstance(each, int | float) and not isinstance(each, bool) for each in found))


def shown(found: dict[str, object]) -> str:
    """The figures as a table."""
    rows = []
    for name, value in found.items():
        if isinstance(value, dict):
            rows.append(name)
            rows += [f"    {key:<30}{each.get('lines', 'absent'):>8} lines {each.get('files', ''):>5} files" for key, each in value.items()]
        else:
            rows.append(f"{name:<34}{value:>8}")
    return "\n".join(rows)


def main() -> None:
    """Print the figures of a checkout."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repo", type=Path, default=Path(__file__).parents[2])
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found = figures(arguments.repo.resolve())
    print(json.dumps(found, indent=1) if arguments.json else shown(found))


if __name__ == "__main__":
    main()
