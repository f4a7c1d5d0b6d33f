"""The sections of CONTRIBUTING that add something: their code is the code that the walk-through tests run."""

import re
import textwrap

import pytest
from doc_pages import ROOT, section

PAGE = "docs/CONTRIBUTING.md"


@pytest.mark.parametrize(
    ("title", "test"),
    [
        ("Add a friction law", "tests/identify/test_new_friction_law.py"),
        ("Add an alert condition", "tests/judge/test_conditions.py"),
        ("Add a bus document", "tests/publish/test_new_document.py"),
    ],
)
def test_the_code_of_a_section_is_the_code_of_its_test(title, test):
    """Each code block is in the test file that its section links to, except for the indentation and the name that it is assigned to."""
    text, source = section(PAGE, title), (ROOT / test).read_text("utf-8")
    assert f"(../{test})" in text
    lines = {line.strip() for line in source.splitlines()}
    blocks = re.findall(r"^ *```python\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    assert blocks
    for block in blocks:
        first, *others = textwrap.dedent(block).strip().splitlines()
        assert any(line.endswith(first) for line in lines), first
        assert {line.strip() for line in others} - {""} <= lines
