"""README and docs/ against the code: every command on a page exists, and everything that exists is documented."""

import ast
import importlib
import re
import shutil
import tomllib
from pathlib import Path

import pytest
from doc_pages import GENERATED, PAGES, ROOT, first_cells, section, shown, typed

from monitor.cli.main import every_command
from monitor.config.load import load
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.publish.registry import KINDS
from monitor.simulate.faults import FAULTS

COMMANDS = dict(every_command())
TYPED = typed()
MAKEFILE = (ROOT / "Makefile").read_text("utf-8")
PACKAGE = ROOT / "monitor"


def command_of(line):
    """The command of a line, with its word where it has one."""
    words = line.split()
    return " ".join(words[:2]) if " ".join(words[:2]) in COMMANDS else words[0]


def options(command):
    return {name for parameter in COMMANDS[command].params for name in (*parameter.opts, *parameter.secondary_opts)} | {"--help"}


@pytest.mark.parametrize(("page", "line"), sorted(set(TYPED)))
def test_every_command_line_of_a_page_exists(page, line):
    """The command and each of its options exist."""
    command = command_of(line)
    assert command in COMMANDS
    asked = set(re.findall(r"(?<!\S)\[?(--?[a-z][a-z-]*)", line))
    assert asked <= options(command), f"unknown: {asked - options(command)}"


def test_every_command_is_shown_on_a_page():
    """Every command is on a page besides the generated one, which alone is no explanation."""
    assert set(COMMANDS) - {command_of(line) for _, line in TYPED} <= {"demo"}  # `make demo` runs it


def test_every_make_target_of_a_page_exists():
    """Every target for people is on the page for contributors or on that for operators."""
    targets = set(re.findall(r"^([a-z]+):.*##", MAKEFILE, re.MULTILINE))
    documented = {name for text in PAGES.values() for name in re.findall(r"(?:`|\$ |# )make ([a-z]+)", text)}
    assert documented <= targets
    assert targets - documented <= {"clean", "help"}


def test_every_option_named_in_the_table_of_identify_exists():
    """The first cell of each row that begins with an option."""
    named = set(re.findall(r"--[a-z][a-z-]+", " ".join(first_cells(section("docs/identification.md", "Options")))))
    assert len(named) > 8
    assert named <= options("identify")


def test_every_objective_in_the_table_exists():
    """Every choice of the command is in the table."""
    from monitor.design.objective import OBJECTIVES

    assert {cell for cell in first_cells(section("docs/trajectories.md", "Objective")) if cell[0] != "-"} == set(OBJECTIVES)


def spoken_keys():
    """The keys of every registered kind of document, as key expressions, and the liveliness tokens that the source names."""
    keys = {selector for kind in KINDS.values() for selector in kind.selectors}
    for path in PACKAGE.rglob("*.py"):
        keys |= set(re.findall(r"alive/[a-z]+", path.read_text("utf-8")))
    return keys


def test_every_key_that_the_daemon_publishes_or_answers_is_in_the_table():
    """The keys of publications, of answers, of the daemon's own queries, and of liveliness."""
    keys = spoken_keys()
    assert len(keys) >= 14
    assert {"health", "monitor", "torque/live", "torque", "cmd/ack", "joint/*/friction", "alive/robot"} <= keys
    documented = {re.sub(r"<[^>]+>", "*", cell) for cell in first_cells(section("docs/bus.md", "Keys"))}
    documented |= {key.replace("/j*/", "/*/").replace("/arm/", "/*/") for key in documented}
    assert keys <= documented


def test_every_kind_of_document_has_a_schema_that_can_be_printed():
    """`joint-monitor schema` prints what the bus page promises."""
    assert "$ joint-monitor schema\n" in PAGES["docs/bus.md"]
    assert {"health", "friction", "alert", "torque", "history"} <= set(KINDS)


def test_every_alert_condition_and_tier_is_in_the_table_with_what_it_asks():
    """The table has each condition with each of its tiers, in the order of the records, and no other."""
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \|", section("docs/alerts.md", "Conditions"), re.MULTILINE)
    assert rows == [(name, tier) for name, condition in CONDITIONS.items() for tier in condition.tiers]


def test_every_cause_that_ends_a_replay_and_every_problem_is_in_its_table():
    """The table has the names of the source, and the causes that need no person are the harmless ones."""
    from monitor.errors import ReplayAborted

    source = "\n".join(path.read_text("utf-8") for path in PACKAGE.rglob("*.py"))
    rows = re.findall(r"^\| (`[^|]*) \| ([^|]*) \| ", section("docs/supervision.md", "How a motion ends"), re.MULTILINE)
    documented = {name: then == "next" for cells, then in rows for name in re.findall(r"`(\w+)`", cells)}
    assert len(documented) > 20
    assert {name for name, harmless in documented.items() if harmless} == set(ReplayAborted.HARMLESS)
    problems = set(first_cells(section("docs/operations.md", "When something is wrong"))) - {"least_free_mb", "[bus] connect"}
    for name in (*documented, *(name for name in problems if re.fullmatch(r"\w+", name))):
        assert re.search(rf"""["']{name}["']""", source), name


def test_every_condition_of_a_motion_is_one_that_check_prints():
    """The shown output names conditions that exist."""
    source = "\n".join(path.read_text("utf-8") for path in PACKAGE.rglob("*.py"))
    (check,) = [each for each in shown() if each.line.startswith("joint-monitor check")]
    named = [row.split()[0] for row in check.output if re.match(r"\w+ +(ok|NO|not checked) ", row)]
    assert len(named) > 20
    for name in named:
        assert f'"{name}"' in source, name


def test_the_table_of_conditions_has_every_condition_in_its_order():
    """And no other."""
    from monitor.acquire.safety.conditions import CONDITIONS as OF_A_MOTION

    rows = re.findall(r"^\| `(\w+)` \|", section("docs/real-robot-safety.md", "The conditions"), re.MULTILINE)
    assert rows == [condition.name for condition in OF_A_MOTION]


def test_every_hazard_has_a_measure_and_a_test_that_exists():
    """An integrator can look up each test by its name."""
    sources = "\n".join(path.read_text("utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    rows = [row for row in section("docs/hazards.md", "Each hazard").splitlines() if row.startswith("| **")]
    assert len(rows) > 15
    for row in rows:
        hazard, measure, test, _ = (cell.strip() for cell in row.strip("|").split(" | ")) if row.count(" | ") == 3 else (row, "", "", "")
        names = re.findall(r"`(test_\w+)`", test)
        assert len(measure) > 10, hazard
        assert names, hazard
        for name in names:
            assert f"def {name}(" in sources, name


def test_the_table_of_faults_names_every_fault():
    """And no other."""
    named = {cell.split()[0] for cell in first_cells(section("docs/simulator.md", "Faults"))}
    assert named == set(FAULTS)


def test_the_table_of_scenarios_names_every_scenario():
    """And no other."""
    named = set(first_cells(section("docs/simulator.md", "Scenarios")))
    assert named == {path.stem for path in (ROOT / "config" / "scenarios").glob("*.toml")}


def test_the_configuration_of_the_first_steps_is_valid(tmp_path):
    """It is accepted unchanged, with the shipped cell and trajectory beside it, and it allows no motion."""
    (text,) = re.findall(r"```toml\n(.*?)```", PAGES["docs/real-robot-safety.md"], re.DOTALL)
    (tmp_path / "cell-1.toml").write_text(text)
    shutil.copy(ROOT / "config" / "cell" / "example.toml", tmp_path / "cell.toml")
    shutil.copy(ROOT / "config" / "excitation" / "ur5e-ground.json", tmp_path / "motion.json")
    configuration = load(tmp_path / "cell-1.toml")
    assert configuration.replay.allow_motion is False
    assert configuration.replay.cell.name == "press 3"


def test_every_section_and_key_of_the_configuration_is_on_its_page():
    """Each is named with its purpose, and every `section.key` of a page exists."""
    reference = (ROOT / "config" / "monitor.toml").read_text("utf-8")
    document = tomllib.loads(reference)
    for name in document:
        assert re.search(rf"^\[{name}\]  # \S.{{10,}}", reference, re.MULTILINE), name
    page, keys = PAGES["docs/configuration.md"], set()
    for name in re.findall(r"^\[([\w.]+)\]", reference, re.MULTILINE):
        assert set(re.findall(r"^(?:# )?(\w+) = ", reference.partition(f"\n[{name}]")[2].partition("\n[")[0], re.MULTILINE)) == {
            cell for cell in first_cells(section("docs/configuration.md", name)) if re.fullmatch(r"\w+", cell)
        } & set(re.findall(r"^\| `(\w+)`", page, re.MULTILINE)), name
        keys |= {f"{name}.{key}" for key in re.findall(r"^\| `(\w+)`", section("docs/configuration.md", name), re.MULTILINE)}
    for where, text in PAGES.items():
        for name, key in re.findall(r"`(\w+)\.(\w+)(?: = [^`]*)?`", text):
            assert name not in document or f"{name}.{key}" in keys, f"{where}: {name}.{key}"


def slug(title):
    """The anchor of a heading, as GitHub and MkDocs both make it; a title of which they make two is refused."""
    words = re.sub(r"[^\w\- ]", "", title.lower().replace("`", ""))
    assert "  " not in words, f"{title!r}: GitHub and MkDocs make different anchors of it"
    return words.replace(" ", "-")


def test_every_link_between_pages_leads_somewhere():
    """The target is a page, a heading of a page, or a file of the repository."""
    bare = {page: re.sub(r"```.*?```", "", text, flags=re.DOTALL) for page, text in PAGES.items()}
    for page, text in bare.items():
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            if link.startswith("https://"):
                continue
            name, _, anchor = link.partition("#")
            path = ((ROOT / page).parent / name).resolve() if name else ROOT / page
            assert path.is_file(), f"{page}: {link}"
            if anchor:
                titles = re.findall(r"^#+ (.+)$", bare[path.relative_to(ROOT).as_posix()], re.MULTILINE)
                assert anchor in {slug(title) for title in titles if "—" not in title}, f"{page}: {link}"


@pytest.mark.parametrize("name", sorted({name for text in PAGES.values() for name in re.findall(r"`(monitor(?:\.\w+)+)`", text)}))
def test_every_python_name_of_a_page_can_be_imported(name):
    """Each is a module, or a name in a module."""
    module, _, attribute = name.rpartition(".")
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        assert hasattr(importlib.import_module(module), attribute)


def test_every_python_example_compiles_and_its_imports_of_ours_exist():
    """Examples that no test runs compile, and their imports exist."""
    examples = [code for text in PAGES.values() for code in re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)]
    assert len(examples) >= 4
    for code in examples:
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("monitor"):
                assert all(hasattr(importlib.import_module(node.module), each.name) for each in node.names)


def messages(module):
    """A pattern of each message that a module logs."""
    calls = [node for node in ast.walk(ast.parse(Path(importlib.import_module(module).__file__).read_text("utf-8"))) if is_log_call(node)]
    texts = [part.value for call in calls for part in ast.walk(call) if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    return [re.compile(re.sub(r"%[.\d]*[a-z]", ".*", re.escape(text))) for text in texts if re.search(r"[a-z]{3}", text)]


def is_log_call(node):
    """Whether it is a call like `log.info(…)`."""
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and ast.unparse(node.func.value) == "log"


def test_every_logger_and_folder_of_a_page_exists():
    """The module that a line of the log names contains the line's text; whatever is called `folder/name` exists."""
    shown_lines = 0
    for page, text in PAGES.items():
        for name, line in re.findall(r"^\S+Z (?:INFO|WARNING) (monitor[\w.]+) (.+)$", text, re.MULTILINE):
            shown_lines += 1
            assert any(pattern.fullmatch(line) for pattern in messages(name)), f"{page}: {name} logs no line like {line!r}"
        if page in GENERATED or page == "docs/CHANGELOG.md":
            continue
        for name in re.findall(r"`((?:monitor|config|deploy|tests|docs)/[\w./@-]*)`", text):
            assert (ROOT / name).exists(), f"{page}: {name}"
    assert shown_lines >= 6


@pytest.mark.parametrize("page", sorted(PAGES))
def test_no_section_of_a_page_is_empty(page):
    """Below each heading stands a text, or a heading of a lower level."""
    bare = re.sub(r"^ *```.*?^ *```$", "block", PAGES[page], flags=re.MULTILINE | re.DOTALL)
    parts = re.split(r"^(#+) (.+)$", bare, flags=re.MULTILINE)[1:]
    headings = list(zip(parts[::3], parts[1::3], parts[2::3], [*parts[3::3], "#"], strict=True))
    assert headings
    assert [title for level, title, text, after in headings if not text.strip() and len(after) <= len(level)] == []


def test_published_names_that_differ_from_the_pages_terms_exist():
    """Each name of the table stands in the code or in the reference configuration."""
    names = first_cells(section("docs/bus.md", "Published names and the terms of these pages"))
    assert len(names) > 10
    source = "\n".join(path.read_text("utf-8") for path in (*PACKAGE.rglob("*.py"), ROOT / "config" / "monitor.toml"))
    assert [name for name in names if not re.search(rf"\b{name}\b", source)] == []


def test_the_readme_is_short_and_leads_on():
    """At most 250 lines; every page is one link away, or two."""
    readme = PAGES["README.md"]
    assert readme.count("\n") <= 250
    assert "make demo" in readme
    assert "make test" in readme
    linked = set(re.findall(r"\]\((?:docs/)?([\w-]+\.md)", readme + PAGES["docs/index.md"]))
    assert {page.removeprefix("docs/") for page in PAGES} - {"README.md", "index.md"} <= linked


def test_the_shown_output_of_the_demo_has_its_titles_columns_and_last_sentence():
    """Titles, columns and the last sentence are those of `make demo`. Its figures are compared where it runs."""
    (block,) = re.findall(r"```console\n(status page while it runs.*?)```", PAGES["README.md"], re.DOTALL)
    words = {cell.strip() for row in block.splitlines() if row.startswith("┃") for cell in row.strip("┃").split("┃")}
    words |= {row for row in block.splitlines() if re.fullmatch(r"[a-z][^\d…]+", row)}
    assert len(words) > 12
    source = "\n".join(path.read_text("utf-8") for path in PACKAGE.rglob("*.py"))
    assert not {each for each in words if each not in source}


def test_the_picture_is_there_and_small():
    """It has at most 200 kB, and the README and the first page show it."""
    picture = ROOT / "docs" / "page.png"
    assert all(10_000 < each.stat().st_size <= 200_000 for each in (ROOT / "docs").glob("*.png"))
    assert f"](docs/{picture.name})" in PAGES["README.md"]
    assert f"]({picture.name})" in PAGES["docs/index.md"]
    assert 10_000 < picture.stat().st_size <= 200_000


def test_every_figure_of_the_verdict_stands_among_all_figures():
    """The short page is written by hand: a new card would leave it behind."""
    card = PAGES["docs/figures.md"].replace("%", " %")
    page = PAGES["docs/validation.md"].partition("Try it with")[0].replace("%", " %")
    told = set(re.findall(r"\d+\.\d+", page)) | set(re.findall(r"(?<=\| )\d+(?= \(\d)", page)) | set(re.findall(r"\| (\d+) \|", page))
    assert len(told) > 20
    for figure in told:
        assert re.search(rf"(?<![\d.]){re.escape(figure)}(?![\d.])", card), figure
