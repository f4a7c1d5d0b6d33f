"""MkDocs hooks: a page may link to a file of the repository; the site carries a copy of that file, so that the link works there too."""

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"\]\(\.\./([^)#]+)(#[^)]*)?\)")  # `](../config/monitor.toml)`, as it works where the pages lie


def linked(text: str) -> set[str]:
    """Names, relative to the repository, of the files outside docs/ that a page links to."""
    return {match[1] for match in LINK.finditer(text)}


def on_files(files: Any, config: Any) -> Any:
    """Add every linked file as `files/NAME.txt`: a browser shows text, and does not offer to save it."""
    names = {name for file in files.documentation_pages() for name in linked(Path(file.abs_src_path).read_text("utf-8"))}
    for name in sorted(names):
        files.append(File.generated(config, f"files/{name}.txt", abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Point the links to the copies."""
    return LINK.sub(r"](files/\1.txt)", markdown)
