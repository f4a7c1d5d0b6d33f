"""The site: every page is in it, no link is broken, and the generated pages agree with the code."""

import importlib.util
import logging
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SITE = ROOT / "docs" / "site"


def test_the_generated_pages_are_those_that_the_code_generates():
    """Keys of the configuration, commands with their options, alert conditions, kinds of documents. To repair: `make docs`."""
    spec = importlib.util.spec_from_file_location("docs_reference", SITE / "reference.py")
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    assert set(reference.PAGES) == {"alerts.md", "bus.md", "configuration.md", "commands.md", "python.md", "real-robot-safety.md"}
    for name, page in reference.PAGES.items():
        assert (ROOT / "docs" / name).read_text("utf-8") == page(), f"docs/{name} is not of today: run `make docs`"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder that MkDocs built, and its log messages."""
    pytest.importorskip("mkdocs", reason="MkDocs is absent: it comes with the extra `dev`")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    messages: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: messages.append(record.getMessage())
    logging.getLogger("mkdocs").addHandler(handler)
    folder = tmp_path_factory.mktemp("site")
    try:
        build(load_config(str(SITE / "mkdocs.yml"), site_dir=str(folder), strict=False))
    finally:
        logging.getLogger("mkdocs").removeHandler(handler)
    return folder, messages


def test_the_site_is_built_without_a_warning(site):
    """There is no broken link or anchor, and no page outside the menu."""
    folder, messages = site
    assert messages == []
    assert {path.stem for path in (ROOT / "docs").glob("*.md")} <= {path.stem for path in folder.glob("*.html")}


def test_the_site_needs_no_other_host(site):
    """A reader beside a robot has no internet: the site contains its styles, scripts, fonts and pictures."""
    folder, _ = site
    for page in folder.glob("*.html"):
        fetched = re.findall(r"<(?:link|script|img|iframe)[^>]+(?:href|src)=\"([^\"]+)\"", page.read_text("utf-8"))
        assert not [address for address in fetched if address.startswith(("http", "//"))], page.name


def test_files_that_a_page_links_to_are_copied_to_the_site(site):
    """A link to a file outside docs/ leads to a copy of it."""
    folder, _ = site
    copies = {path.relative_to(folder / "files").as_posix().removesuffix(".txt") for path in (folder / "files").rglob("*.txt")}
    assert "config/monitor.toml" in copies
    for name in copies:
        assert (folder / "files" / f"{name}.txt").read_bytes() == (ROOT / name).read_bytes()


def test_a_new_card_keeps_the_text_below_it(tmp_path):
    """`make card` writes its own part of the page, and the page has the other part."""
    from evidence.card import END, HEAD, TARGET, beside

    page = (ROOT / TARGET).read_text("utf-8")
    card, _, rest = page.partition(END)
    assert card.startswith(HEAD.partition("{")[0])
    assert "## Try your own thresholds" in rest
    assert beside("new\n", ROOT / TARGET) == f"new\n{END}{rest}"
    assert beside("new\n", tmp_path / "card.md") == "new\n"
