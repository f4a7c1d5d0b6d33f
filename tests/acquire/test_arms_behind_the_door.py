"""What knows a make of robots lies behind one door: its own folder, and one line of `acquire.driver`."""

import ast
import re
from pathlib import Path

from monitor.acquire.driver import MAKES, driver_of

PACKAGE = Path(__file__).parent.parent.parent / "monitor"
FOLDER = PACKAGE / "acquire" / "ur"
LIBRARIES = {"rtde_control", "rtde_receive", "rtde_io", "dashboard_client", "script_client"}
OUTSIDE = sorted(path for path in PACKAGE.rglob("*.py") if FOLDER not in path.parents and PACKAGE / "simulate" not in path.parents)


def imported(path: Path) -> set[str]:
    """Every module that a file imports, also within a function or a text that is run as a program."""
    text = path.read_text("utf-8")
    found = set(re.findall(r"(?:from|import)\s+((?:monitor\.acquire\.ur|rtde_\w+|dashboard_client|script_client)[\w.]*)", text))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def of_a_make(path: Path) -> set[str]:
    """What a file imports of a make's folder or library."""
    return {name for name in imported(path) if name.startswith("monitor.acquire.ur") or name.split(".")[0] in LIBRARIES}


def test_nobody_outside_imports_a_make_of_robots_or_its_library():
    """Whoever does, is written for one make, and would be read and changed for a second."""
    assert {path.relative_to(PACKAGE).as_posix(): names for path in OUTSIDE if (names := of_a_make(path))} == {}


def test_the_test_sees_what_it_looks_for(tmp_path):
    """Also within a function, and within a text."""
    for number, text in enumerate(
        ("from monitor.acquire.ur import arm", "def f():\n    import rtde_control", "X = 'from monitor.acquire.ur.arm import Arm; Arm()'")
    ):
        file = tmp_path / f"{number}.py"
        file.write_text(text)
        assert any(name.startswith(("monitor.acquire.ur", "rtde_control")) for name in imported(file))


def test_each_make_is_one_line_and_has_a_driver():
    """The line names the module; a second make adds its folder and its line."""
    text = (PACKAGE / "acquire" / "driver.py").read_text("utf-8")
    for make, module in MAKES.items():
        assert text.count(module) == 1
        assert driver_of(make).client_library
