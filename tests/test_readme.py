"""The README against the code: what it tells people to type must exist."""

import re
import shutil
import textwrap
import tomllib
from pathlib import Path

import pytest
import typer.main

from monitor.cli.main import app
from monitor.config.load import load
from monitor.judge.alerts.health import ACTIONS
from monitor.publish.documents import KINDS
from monitor.publish.permit import KEY as PERMIT

README = (Path(__file__).parent.parent / "README.md").read_text("utf-8")
COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
TYPED = [
    match.group(1).replace("\\\n", " ")
    for match in re.finditer(r"(?:\$ |`)joint-monitor ((?:[a-z]+)(?: [^\n`]*?(?:\\\n[^\n`]*)*)?)(?=[\n`])", README)
]


def options(command):
    return {name for parameter in COMMANDS[command].params for name in (*parameter.opts, *parameter.secondary_opts)}


@pytest.mark.parametrize("line", sorted(set(TYPED)))
def test_every_command_line_of_the_readme_exists(line):
    """The command, and each of its options."""
    command = line.split()[0]
    assert command in COMMANDS
    asked = set(re.findall(r"(?<!\S)\[?(--?[a-z][a-z-]*)", line))
    assert asked <= options(command), f"unknown: {asked - options(command)}"


def test_every_option_named_in_a_table_of_identify_exists():
    """The first cell of each row that begins with an option."""
    named = set(re.findall(r"--[a-z][a-z-]+", "\n".join(re.findall(r"^\| (`--.*?) \| ", README, re.MULTILINE))))
    assert len(named) > 8
    assert named <= options("identify")


def test_every_command_is_in_the_readme():
    """Nothing that exists is left untold."""
    told = {line.split()[0] for line in TYPED}
    assert set(COMMANDS) - told <= {"demo"}  # `make demo` tells it
    assert "make demo" in README


def section(title):
    return README.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def first_cells(text):
    return [cell for row in re.findall(r"^\| (.*?) \|", text, re.MULTILINE) for cell in re.findall(r"`([^`]+)`", row)]


def test_every_key_that_the_daemon_speaks_or_answers_is_in_the_table():
    """Read from the source: what is said, what is answered, what is asked, liveliness."""
    package = Path(__file__).parent.parent / "monitor"
    daemon, bus = ((package / name).read_text("utf-8") for name in ("service/daemon.py", "publish/bus.py"))
    keys = set(re.findall(r"""(?:_say|stream)\(f?"([^"]+)",""", daemon)) | set(
        re.findall(r"""^ +"([a-z/]+)": Answer\(""", daemon, re.MULTILINE)
    )
    keys |= set(re.findall(r"alive/[a-z]+", bus)) | {PERMIT, "event"}
    assert len(keys) >= 14
    told = {re.sub(r"<[^>]+>", "*", cell) for cell in first_cells(section("Ask and listen"))}
    told |= {key.replace("/j*/", "/*/").replace("/arm/", "/*/") for key in told}
    missing = {key for key in keys if re.sub(r"\{[^}]+\}", "*", key) not in told}
    assert not missing


def test_every_alert_condition_and_tier_is_in_the_table_with_what_it_asks():
    """Each condition that the judge may raise, and for those with tiers each tier."""
    text = section("What an alert asks of you")
    told = set(first_cells(text))
    assert {condition for condition, _ in ACTIONS} <= told
    for tier in {tier for _, tier in ACTIONS}:
        assert re.search(rf"\| {tier} \|", text), tier


def test_the_configuration_of_the_first_steps_is_one(tmp_path):
    """As it stands, with the shipped example of a cell and a shipped trajectory beside it: nothing is refused, and nothing may move."""
    root = Path(__file__).parent.parent
    steps = README.partition("### A real arm, step by step")[2]
    text = textwrap.dedent(re.search(r"```toml\n(.*?)```", steps, re.DOTALL).group(1).replace("\n   ", "\n").removeprefix("   "))
    (tmp_path / "cell-1.toml").write_text(text)
    shutil.copy(root / "config" / "cell" / "example.toml", tmp_path / "cell.toml")
    shutil.copy(root / "config" / "excitation" / "ur5e-ground.json", tmp_path / "motion.json")
    configuration = load(tmp_path / "cell-1.toml")
    assert configuration.replay.allow_motion is False
    assert configuration.replay.cell.name == "press 3"


def test_every_link_within_the_readme_leads_somewhere():
    """Headings as GitHub makes anchors of them."""
    titles = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", README, flags=re.DOTALL), re.MULTILINE)
    anchors = {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
    assert {link.replace("\n", "") for link in re.findall(r"\]\(#([^)]+)\)", README)} <= anchors


def test_every_section_of_the_configuration_is_spoken_of():
    """In the README by name, or in the reference with a word of what it is for; the keys are held by test_config."""
    reference = (Path(__file__).parent.parent / "config" / "monitor.toml").read_text("utf-8")
    for name in tomllib.loads(reference):
        assert re.search(rf"^\[{name}\]  # \S.{{10,}}", reference, re.MULTILINE), name
    for name in ("schedule", "metrics", "page"):
        assert f"[{name}]" in README, name


def test_every_kind_of_document_has_a_schema_that_can_be_printed():
    """What the README promises of `joint-monitor schema`."""
    assert "joint-monitor schema" in README
    assert {"health", "friction", "alert", "torque", "history"} <= set(KINDS)


def test_the_picture_is_there_and_small():
    """At most 200 kB, and named in the README."""
    picture = Path(__file__).parent.parent / "docs" / "page.png"
    assert f"](docs/{picture.name})" in README
    assert 10_000 < picture.stat().st_size <= 200_000
