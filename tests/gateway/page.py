"""What docs/gateway.md shows, for the tests that compare it."""

import re
from dataclasses import fields
from pathlib import Path

TEXT = (Path(__file__).parents[2] / "docs" / "gateway.md").read_text("utf-8")


def section(title: str) -> str:
    """The text below a heading, down to the next one of its level."""
    level, text = re.search(rf"^(#+) {re.escape(title)}\n(.*)", TEXT, re.MULTILINE | re.DOTALL).groups()
    return re.split(rf"^#{{2,{len(level)}}} ", text, maxsplit=1, flags=re.MULTILINE)[0]  # a line of a console begins with one #


def first_cells(title: str, head: str) -> list[str]:
    """The code in the first column of the table with this heading."""
    table = re.search(rf"^\| {re.escape(head)} \|.*?\n\|[-|]+\|\n((?:\|.*\n)+)", section(title), re.MULTILINE)[1]
    return [cell for row in re.findall(r"^\| (.*?) \|", table, re.MULTILINE) for cell in re.findall(r"`([^`]+)`", row)]


def keys(settings: type) -> list[str]:
    return [each.name for each in fields(settings)]


def shape(text: str) -> str:
    """A line without hosts, paths, figures and days."""
    text = re.sub(r"(?<=[ :])/\S+/", "/", re.sub(r"broker\.plant\.example|127\.0\.0\.1|0\.0\.0\.0|192\.0\.2\.7", "HOST", text))
    return re.sub(r"[A-Z][a-z]{2} +#|\d[\d.:-]*", "#", re.sub(r"until \w{3} .*", "until #", text))


def findings(channel: str) -> list[str]:
    """The lines of `gateway check` that the page shows."""
    return [shape(line) for line in TEXT.splitlines() if line.startswith(f"{channel}: ")]


def said(found) -> list[str]:
    """The same of what was found."""
    return [shape(f"{each.channel}: {each.step}: {'' if each.ok else 'FAILED: '}{each.text}") for each in found]


def blocks(title: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", section(title), re.MULTILINE | re.DOTALL)
