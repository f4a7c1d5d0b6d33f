"""The table of faults in the documentation: every code in it exists in the program and is told in a test, and the other way round."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/identification.md").read_text("utf-8")
TABLE = PAGE.split("## What it notices")[1].split("## ")[0]
SIGNALS = "\n".join(path.read_text("utf-8") for path in sorted((ROOT / "monitor/identify").rglob("*.py")))
CLEANING = (ROOT / "monitor/identify/signals/cleaning.py").read_text("utf-8")
TESTS = "\n".join(path.read_text("utf-8") for path in sorted((ROOT / "tests").rglob("test_*.py")) if path.name != Path(__file__).name)


def test_every_code_in_the_table_is_said_by_the_program_and_held_by_a_test():
    """A row that nobody tests would be a promise without proof."""
    codes = set(re.findall(r"`([a-z]+(?:_[a-z]+)*)`", TABLE))
    assert len(codes) > 20
    assert {code for code in codes if f'"{code}"' not in SIGNALS} == set()
    assert {code for code in codes if f'"{code}"' not in TESTS and f"'{code}'" not in TESTS} == set()


def test_every_correction_and_doubt_is_in_the_table():
    """What the program corrects or doubts in a recording has a row."""
    said = set(re.findall(r'Sentence\(\s*"([a-z_]+)",\s*"\{source\}', CLEANING))
    assert len(said) > 10
    assert said - set(re.findall(r"`([a-z_]+)`", TABLE)) == set()
