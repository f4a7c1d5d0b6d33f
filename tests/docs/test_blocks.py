"""Every fenced block of README and docs/: read, compiled or run by what it is for, or its words are those of the program."""

import ast
import importlib.util
import json
import re
import shlex
import shutil
import socket
import subprocess
import sys
from fnmatch import fnmatch
from functools import cache
from textwrap import dedent
from typing import NamedTuple

import numpy as np
import pytest
from doc_pages import GENERATED, PAGES, ROOT
from empty_plant import empty_plant
from test_shown_commands import NOT_RUN

import monitor.api as jm
from monitor.acquire.ur import node_script
from monitor.cli.main import every_command
from monitor.config.load import load
from monitor.errors import BadConfiguration
from monitor.gateway.mqtt.channel import request_in
from monitor.gateway.settings import CHANNELS, load_gateway
from monitor.gateway.tickets.listener import Acknowledge
from monitor.judge.friction.noise import NoisePriors
from monitor.plant.database import Database
from monitor.plant.settings import load_plant
from monitor.publish.registry import KINDS
from monitor.simulate.program.language import parsed
from monitor.simulate.scenario import load_scenario
from monitor.studies.reassess.plan import read_changes


class Block(NamedTuple):
    """One fenced block."""

    page: str
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        """Where it stands."""
        return f"{self.page}:{self.line}"


def _blocks() -> list[Block]:
    fence = re.compile(r"^( *)```(\S*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
    return [
        Block(page, text.count("\n", 0, found.start()) + 1, found[2], dedent(found[3]))
        for page, text in PAGES.items()
        if page not in GENERATED or page == "docs/python.md"  # what is generated is compared with its generator
        for found in fence.finditer(text)
        if not (page == "docs/python.md" and found[2] == "text")
    ]


BLOCKS = _blocks()
SHELLS = {"console", "sh", "bash"}
COMMANDS = dict(every_command())


def of(*languages: str):
    """The blocks in these languages, as parameters."""
    return pytest.mark.parametrize("block", [each for each in BLOCKS if each.language in languages], ids=str)


def test_every_block_has_a_language_that_a_test_here_holds():
    """A block in a new language needs a test."""
    assert {each.language for each in BLOCKS} == {*SHELLS, "toml", "json", "js", "python", "sql", "text"}
    assert len(BLOCKS) > 140
    assert sum(text.count("```") for page, text in PAGES.items() if page not in GENERATED) == 2 * len(
        [each for each in BLOCKS if each.page not in GENERATED]
    )


# --- TOML: the program that reads such a file takes it, with the files and secrets that it names beside it ---

ARM = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\nhost = "192.0.2.1"\n'
OF_PLANT = {"plant", "screen", "metrics", *(kind.section for kind in CHANNELS)}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where a block is put: the shipped cell and trajectory, and each secret that a page names."""
    shutil.copy(ROOT / "config" / "cell" / "example.toml", tmp_path / "cell.toml")
    shutil.copy(ROOT / "config" / "excitation" / "ur5e-ground.json", tmp_path / "motion.json")
    (tmp_path / "users").write_text("scada:look:" + "0" * 64 + "\n")
    secrets = tmp_path / "credentials"
    secrets.mkdir()
    named = {name for each in BLOCKS for name in re.findall(r'"credential:([\w-]+)"', each.text)}
    for name in named:
        (secrets / name).write_text("json://hooks.plant.example" if name == "chat" else "whsec_" + "c2VjcmV0" * 4)
    (secrets / "archive").write_text("[default]\naws_access_key_id = abc\naws_secret_access_key = def\n")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(secrets))
    return tmp_path


@of("toml")
def test_a_toml_block_is_taken_by_the_program_that_reads_it(block, folder):
    """As a file of its own; where it is a part of a file, with what the file must have besides."""
    file = folder / "file.toml"
    file.write_text(block.text)
    heads = {name.partition(".")[0] for name in re.findall(r"^\[+([\w.]+)\]+", block.text, re.MULTILINE)}
    if "fleet.json" in block.text:  # taken where there is one: tests/studies/test_fleet_prior.py
        file.write_text(ARM + block.text)
        with pytest.raises(BadConfiguration, match=r"drift\.prior: .*fleet\.json"):
            load(file)
    elif block.page == "docs/reassess.md":
        assert read_changes(file)
    elif block.text.startswith("about = "):
        assert load_scenario(str(file)).about
    elif block.text.startswith("coupling = "):
        arm = (ROOT / "monitor/model/robots/ur5.toml").read_text("utf-8")
        file.write_text(block.text + "\n" + arm)
        assert jm.robot(file).coupling is not None
    elif heads <= OF_PLANT and not (heads == {"notify"} and block.page == "docs/getting-started.md"):
        assert load_plant(file)
        assert set(load_gateway(file).enabled) == heads & {kind.section for kind in CHANNELS}
    else:
        file.write_text(block.text if "robot" in heads else ARM + block.text)
        assert load(file, reads_files=True)


# --- JSON, JavaScript, SQL ---


@of("json")
def test_a_json_block_is_a_document_that_the_program_takes_or_writes(block):
    """A request is taken by what reads it. What MQTT says of a joint is compared where it is said, tests/gateway/test_mqtt_messages.py."""
    document = json.loads(block.text)
    if "ticket" in document:
        assert set(document) <= set(Acknowledge.model_fields)
        assert Acknowledge.model_validate(document).by == "Ada"
    elif "wear_percent" not in document:
        assert request_in(block.text.encode()) == document


@of("js")
def test_a_javascript_block_is_javascript_and_the_fields_that_it_reads_exist(block, tmp_path):
    """Of the document whose key it watches."""
    (kind,) = re.findall(r'"--keys", "(\w+)"', block.text)
    assert set(re.findall(r"document\.(\w+)", block.text)) <= set(KINDS[kind].model.model_fields)
    if node := shutil.which("node"):
        (tmp_path / "block.mjs").write_text(block.text)
        assert subprocess.run([node, "--check", tmp_path / "block.mjs"], check=False, timeout=60).returncode == 0


@of("sql")
def test_an_sql_block_runs_on_the_database_of_a_plant(block, tmp_path):
    """On one that has no arm yet."""
    (tmp_path / "plant.sqlite").write_bytes(empty_plant())
    database = Database(tmp_path / "plant.sqlite")
    try:
        with database.read() as connection:
            assert connection.exec_driver_sql(block.text.rstrip().rstrip(";")).fetchall() == []
    finally:
        database.close()


# --- Shell: syntax, programs, options, and the files that are named ---


def commands(block: Block) -> list[str]:
    """The command lines of a block of a shell: after a prompt, or all of it where it has none."""
    text = block.text.replace("\\\n", "")
    if block.language == "console":
        return re.findall(r"^[$#] (.+)$", text, re.MULTILINE)
    return text.replace("|\n", "| ").splitlines()


OTHERS = {".", "cp", "curl", "dask", "editor", "install", "jq", "openssl", "printf", "systemctl"}
OURS_OF_SYSTEMD = {path.name for path in (ROOT / "deploy").glob("*.service")}


def _words(line: str) -> list[list[str]]:
    """The words of each command of a line."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;")
    lexer.whitespace_split, found = True, [[]]
    for word in lexer:
        if set(word) <= set("|&;"):
            found.append([])
        else:
            found[-1].append(word)
    return [[word for word in words if not re.match(r"[A-Z_]+=", word)] for words in found if words]


def _holds(words: list[str], where: Block) -> None:
    """The program, its options and the files that it names exist."""
    name, *rest = words
    if name == "joint-monitor":
        command = " ".join(rest[:2]) if " ".join(rest[:2]) in COMMANDS else rest[0]
        if command.startswith("--"):
            return
        known = {each for parameter in COMMANDS[command].params for each in (*parameter.opts, *parameter.secondary_opts)} | {"--help"}
        assert {word.partition("=")[0] for word in rest if re.match(r"--?[a-z]", word)} <= known, f"{where}: {words}"
    elif name == "make":
        assert re.search(rf"^{rest[0]}:.*##", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE), f"{where}: {words}"
    elif name == "python" and rest[0] == "-m":
        assert importlib.util.find_spec(rest[1]), f"{where}: {words}"
    elif name == "python":
        assert rest[0] == "-c", f"{where}: {words}"
        subprocess.run([sys.executable, *rest], check=True, timeout=100, stdout=subprocess.DEVNULL)
    else:
        assert name in OTHERS, f"{where}: {words}"
    for word in words:
        if word.startswith(("config/", "deploy/", "docs/")):
            assert list(ROOT.glob(word)), f"{where}: {word}"
        if name == "systemctl" and word.startswith("joint-monitor"):
            assert any(fnmatch(unit, re.sub(r"@.*", "@", word.removesuffix(".service")) + ".service") for unit in OURS_OF_SYSTEMD), word


@of(*SHELLS)
def test_a_block_of_a_shell_has_its_syntax_and_names_programs_options_and_files_that_exist(block):
    """`bash -n`; our own commands by what they offer, other programs by name."""
    for line in commands(block):
        checked = subprocess.run(["bash", "-n", "-c", line.replace("…", "x")], capture_output=True, text=True, check=False, timeout=60)
        assert checked.returncode == 0, f"{block}: {checked.stderr}"
        in_a_loop = re.search(r"; do (.*?); sleep", line)
        for words in _words(in_a_loop[1] if in_a_loop else line):
            _holds(words, block)


# --- Python ---


@of("python")
def test_a_python_block_compiles(block):
    """Its imports of ours exist: tests/docs/test_pages.py."""
    ast.parse(block.text)


def test_the_blocks_of_the_python_page_run(tmp_path, monkeypatch):
    """With recordings of a simulated arm under the names that it has."""
    first, second, third = jm.simulated("ur5", (18.0, 22.0, 26.0))
    (block,) = [each for each in BLOCKS if each.page == "docs/python.md"]
    import pandas as pd

    columns = {"timestamp": first.t_s}
    for name, signal in (("actual_q", first.q), ("actual_qd", first.qd), ("actual_current", first.current)):
        columns |= {f"{name}_{joint}": signal[:, joint] for joint in range(6)}
    pd.DataFrame(columns).to_parquet(tmp_path / "replay.parquet")
    monkeypatch.chdir(tmp_path)
    known = {"first": first, "second": second, "third": third, "q": np.zeros(6), "qd": np.full(6, 0.5), "qdd": np.zeros(6)}
    exec(compile(block.text, str(block), "exec"), known)  # the page's own
    assert known["found"].coulomb_nm.shape == (6,)
    assert np.all(known["predicted"].std > 0.0)


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory):
    """Where a daemon answers that has one replay of an arm."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, ROOT / "tests/publish/quiet_daemon.py", tmp_path_factory.mktemp("daemon"), address]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout.readline() == "up\n"
        yield address
        daemon.communicate("\n", timeout=60)


@pytest.mark.slow
@pytest.mark.parametrize("block", [each for each in BLOCKS if each.page == "docs/bus.md" and each.language == "python"], ids=str)
def test_a_program_of_the_bus_page_runs_beside_a_daemon(block, endpoint):
    """With the address and the arm of this one: the first line that it prints is the state, or six torques."""
    program = block.text.replace("tcp/127.0.0.1:7447", endpoint).replace("sim-1", "cell-1")
    with subprocess.Popen([sys.executable, "-u", "-c", program], stdout=subprocess.PIPE, text=True) as running:
        line = running.stdout.readline()
        running.terminate()  # the second one goes on until somebody ends it
    assert line.startswith("[" if "torque_nm" in program else "NORMAL ["), line


# --- Drawings, formulas and scripts of the robot ---

DRAWN = [each for each in BLOCKS if each.language == "text" and "──" in each.text and each.page != "docs/figures.md"]
FORMULAS = [each for each in BLOCKS if each.language == "text" and each.page == "docs/friction-model.md"]
SCRIPTS = [each for each in BLOCKS if each.language == "text" and "halt" in each.text]


@pytest.mark.parametrize("block", DRAWN, ids=str)
def test_a_drawing_names_programs_rooms_and_values_that_exist(block):
    """What stands at the head of an arrow, and along it."""
    for name in re.findall(r"joint-monitor (\w+)", block.text):
        assert name in {command.split()[0] for command in COMMANDS}
    rooms = set(re.findall(r"──▶ ([a-z]+) ──\w", block.text)) | set(re.findall(r"── (\w+):", block.text))
    assert all((ROOT / "monitor" / room).is_dir() for room in rooms), rooms
    assert all(f"class {value}" in _said() for value in set(re.findall(r"──(\w+)──▶", block.text)) - {"RTDE", "Zenoh"})


def test_the_figures_of_the_formulas_are_those_of_the_code():
    """Each stands in the code of the verdicts, or is computed from those that do."""
    text = "\n".join(each.text for each in FORMULAS)
    code = "\n".join(path.read_text("utf-8") for path in (ROOT / "monitor/judge").rglob("*.py"))
    computed = {"11 356": 365 * 7 / (0.9 * 0.25), "102 200": 365 * 7 / (0.1 * 0.25)}
    for figure, value in computed.items():
        assert figure in text
        assert float(figure.replace(" ", "")) == pytest.approx(value, abs=1.0)
        text = text.replace(figure, "")
    figures = set(re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.])", text))
    assert len(figures) > 25
    assert [each for each in figures if not re.search(rf"(?<![\d.]){re.escape(each)}(?:\.0)?(?![\d.])", code)] == []
    kinds = NoisePriors().kinds
    plain = [kind for kind in kinds if kind.kappa == 0.0][:9]
    (row,) = re.findall(r"^ 9  ρ = (.*?)  +prior weights (.*)$", text, re.MULTILINE)
    assert [[float(each) for each in part.split(", ")] for part in row] == [[k.rho for k in plain], [k.weight for k in plain]]


@pytest.mark.parametrize("block", SCRIPTS, ids=str)
def test_a_script_of_the_robot_is_urscript_or_the_lines_that_a_node_gets(block):
    """The figures of the node's registers and limits are filled in."""
    code = [line for line in (re.sub(r"#.*", "", row).strip() for row in block.text.splitlines()) if line]
    if block.page != "docs/hand-over.md":
        assert parsed("\n".join(code), "production", {"set_standard_digital_out"})
        return

    def shape(text: str) -> str:
        return re.sub(r"\{\w+\}|\b\d+(\.\d+)?\b", "#", text)

    code = [line.replace("jm_rtde_cmd()", "rtde_cmd()") for line in code]  # each name of ur-rtde's gets its jm_ where it is served
    ours = shape((ROOT / "monitor/acquire/ur/node_script.py").read_text("utf-8"))
    assert [line for line in code if shape(line) not in ours] == []
    assert f"write_output_integer_register({node_script.OFFER}, jm_number)" in code
    assert f"stopj({node_script.LIMITS['stop_rad_s2']:g})" in code
    assert f"wait up to {node_script.LIMITS['wait_s']} s" in block.text


# --- Printed text: the pairs of words that a program prints stand in the program ---


def _of_a_program(block: Block) -> bool:
    """Whether no other test compares what it shows: output without a command, or of a command that the pages' tests do not run."""
    if block.language == "text":
        return block not in (*DRAWN, *FORMULAS, *SCRIPTS)
    lines = [line.removeprefix("joint-monitor ") for line in commands(block)]
    return block.language == "console" and (not lines or any(line.startswith(words) for line in lines for words in NOT_RUN))


@cache
def _said() -> str:
    """Every text of the program, its benches and its studies, in one line; what is filled in is a #."""
    paths = [path for room in ("monitor", "tests/bench", "tests/evidence") for path in (ROOT / room).rglob("*.py")]
    paths += (ROOT / "config").rglob("*.toml")
    text = "\n".join(re.sub(r"""["']\s*\n\s*f?["']""", "", path.read_text("utf-8")) for path in paths)
    return re.sub(r"\s+", " ", re.sub(r"\{[^{}\n]*\}", "#", text))


@pytest.mark.parametrize("block", [each for each in BLOCKS if _of_a_program(each)], ids=str)
def test_what_a_block_shows_as_printed_is_worded_as_the_program_words_it(block):
    """Of its pairs of neighbouring words at most one in eight is not the program's: names, and words beside what is filled in."""
    rows = [row for row in block.text.splitlines() if not re.match(r"[$#] ", row)]
    pairs = [pair for row in rows for pair in re.findall(r"(?<![\w/.@-])(?=([a-z]{2,} [a-z]{2,})(?![\w/.@=-]))", row)]
    strange = {pair for pair in pairs if pair not in _said() + " ".join(commands(block))}
    assert len(strange) <= max(1, len(set(pairs)) // 8), strange
