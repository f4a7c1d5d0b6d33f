"""The pages of the documentation, and the commands that they show."""

import re
import shlex
from pathlib import Path
from textwrap import dedent
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PAGES = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))}
GENERATED = {"docs/configuration.md", "docs/commands.md", "docs/python.md"}
_BLOCK = re.compile(r"^ *```console\n(.*?)^ *```", re.MULTILINE | re.DOTALL)


class Shown(NamedTuple):
    """One command of a page, and the lines that the page shows below it."""

    page: str
    line: str
    output: tuple[str, ...]

    @property
    def words(self) -> list[str]:
        """The words of the command, split as in a shell."""
        return shlex.split(self.line, comments=True)


def section(page: str, title: str) -> str:
    """The text below a heading, down to the next one of its level."""
    level, text = re.search(rf"^(#+) {re.escape(title)}\n(.*)", PAGES[page], re.MULTILINE | re.DOTALL).groups()
    return re.split(rf"^#{{1,{len(level)}}} ", text, maxsplit=1, flags=re.MULTILINE)[0]


def first_cells(text: str) -> list[str]:
    """The code in the first column of the section's tables."""
    return [cell for row in re.findall(r"^\| (.*?) \|", text, re.MULTILINE) for cell in re.findall(r"`([^`]+)`", row)]


def shown() -> list[Shown]:
    """Every command line that begins with `$ `, over all pages."""
    found = []
    for page, text in PAGES.items():
        for block in _BLOCK.findall(text):
            for part in re.split(r"^\$ ", dedent(block).replace("\\\n", ""), flags=re.MULTILINE)[1:]:  # a block in a list is indented
                line, *output = part.splitlines()
                found.append(Shown(page, " ".join(line.split()), tuple(output)))
    return found


def typed() -> list[tuple[str, str]]:
    """Page and arguments of every `joint-monitor …`, in blocks and in sentences."""
    pattern = re.compile(
        r"(?:\$ |# |`|^(?=\S+ \S+ -))joint-monitor ((?:[a-z][a-z-]*)(?: [^\n`]*?(?:\\\n[^\n`]*)*)?)(?=[\n`])", re.MULTILINE
    )
    return [
        (page, match[1].replace("\\\n", " ")) for page, text in PAGES.items() if page not in GENERATED for match in pattern.finditer(text)
    ]
