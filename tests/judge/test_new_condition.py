"""The walk-through of docs/CONTRIBUTING.md, "Add an alert condition": its steps, carried out in a copy of the program."""

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

pytest.importorskip("babel", reason="Babel is not installed: texts are not gathered anew")

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "CONTRIBUTING.md").read_text("utf-8").partition("\n## Add an alert condition\n")[2].partition("\n## ")[0]
(RECORD,) = (textwrap.dedent(block) for block in re.findall(r"^ *```python\n(.*?)^ *```", PAGE, re.MULTILINE | re.DOTALL))
FILE = re.search(r"Add one record to `CONDITIONS` in \[`([\w/.]+)`\]", PAGE)[1]
BEFORE = re.search(r"here before\s+`([^`]+)`", PAGE)[1]  # the record in front of which the new one is put
CATALOGUE = re.search(r"Translate them in\s+`([\w/.]+)`", PAGE)[1]
GERMAN = {  # by context and text
    ("", "overheated"): "überhitzt",
    ("hot_joint", "{joint:joint} is hotter than 70 °C, in {replays} replays in a row."): "{joint:joint} ist über 70 °C, {replays}-mal.",
    ("overheated.joint", "{joint:name} is too hot."): "{joint:name} ist zu heiß.",
    ("overheated.advisory", "Let the arm cool down."): "Lassen Sie den Arm abkühlen.",
}
# three hot days of joint 2, and what the copy says of them; run in the copy
LIVE = """
import importlib.util, json, sys
import numpy as np
from synthetic_arm import Arm, History
from monitor.judge.alerts.health import alert_document
from monitor.publish.documents import Alert, read
from monitor.publish.timestamps import outside
from monitor.views.alert_sentence import JointPast, sentences
from monitor.views.language.catalogue import language

history, arm = History(), Arm(seed=1)
for day in range(3):
    history.add(day, arm.replay(np.array([30.0, 75.0, 30.0, 30.0, 30.0, 30.0])))
[alert] = history.health.active_alerts
document = read(Alert, outside(alert_document(alert)))
spec = importlib.util.spec_from_file_location("reference", "docs/site/reference.py")
reference = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reference)
told = {code: sentences(document, JointPast(), alert.raised_at_unix_s, language(code)) for code in ("en", "de")}
print(json.dumps({
    "why": {code: language(code).say(history.health.why) for code in told},
    "headline": {code: each.headline for code, each in told.items()},
    "due": {code: each.due for code, each in told.items()},
    "row": [line for line in reference.alerts_page().splitlines() if "overheated" in line],
}))
"""


class Program:
    """A copy of the program with the page's record in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        environment = os.environ | {"PYTHONPATH": f"{self.folder}{os.pathsep}{ROOT / 'tests'}"}
        command = [sys.executable, *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=250, check=False, cwd=self.folder, env=environment)


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Program:
    """The copy after the first step."""
    made = Program(tmp_path_factory.mktemp("program"))
    for folder in ("monitor", "config", "docs"):
        shutil.copytree(ROOT / folder, made.folder / folder, ignore=shutil.ignore_patterns("*.pyc.*", "*.png"))
    file = made.folder / FILE
    place = re.compile(rf"^( +){re.escape(BEFORE)},$", re.MULTILINE)
    text, edits = place.subn(lambda at: textwrap.indent(RECORD.rstrip() + ",\n", at[1]) + at[0], file.read_text("utf-8"))
    assert edits == 1, f"{FILE} has no place like {BEFORE!r}"
    file.write_text(text, "utf-8")
    return made


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_the_steps_of_the_page_make_a_condition_that_is_told_in_every_language(program: Program) -> None:
    """`make texts` asks for four translations and for no more; after them headline, advice, state and table's row are there."""
    asked = program.run("docs/site/texts.py")
    assert asked.returncode == 1, asked.stderr
    assert asked.stdout.splitlines() == [f"de: not translated: {f'{code}: ' if code else ''}{text}" for code, text in GERMAN]
    catalogue = program.folder / CATALOGUE
    text = catalogue.read_text("utf-8")
    for (code, english), german in GERMAN.items():
        context = f'msgctxt "{code}"' if code else ""
        empty = f'{context}\nmsgid "{english}"\nmsgstr ""\n'
        assert text.count(empty) == 1
        text = text.replace(empty, empty.replace('msgstr ""', f'msgstr "{german}"'))
    catalogue.write_text(text, "utf-8")
    made = program.run("docs/site/texts.py")
    assert (made.returncode, made.stdout) == (0, ""), made.stderr

    lived = program.run("-c", LIVE)
    assert lived.returncode == 0, lived.stderr
    assert json.loads(lived.stdout) == {
        "why": {"en": "Shoulder (joint 2): overheated (advisory)", "de": "Schulter (Gelenk 2): überhitzt (Hinweis)"},
        "headline": {"en": "Shoulder is too hot.", "de": "Schulter ist zu heiß."},
        "due": {"en": "Let the arm cool down.", "de": "Lassen Sie den Arm abkühlen."},
        "row": [
            "| `overheated` | advisory | Let the arm cool down. | a joint is hotter than 70 °C in three replays in a row | `OFF_SPEC` |"
        ],
    }


def test_the_record_has_the_styles_approval(program: Program) -> None:
    """Ruff finds nothing in the file with the page's record, and would not format it otherwise."""
    for check in (["check"], ["format", "--check"]):
        done = program.run("-m", "ruff", *check, "--config", str(ROOT / "pyproject.toml"), str(program.folder / FILE))
        assert done.returncode == 0, done.stdout + done.stderr
