"""Programs outside the package: the unchanged examples of the bus page, and `watch` to a terminal, a pipe and a program."""

import json
import os
import pty
import re
import select
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import zenoh
from published import raw
from rich.text import Text

from monitor.publish.bus import Bus, QueryHandler
from monitor.publish.session import BusSettings, prefix
from monitor.views.terminal.watch import line

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "bus.md").read_text("utf-8")
RECORDED = Path(__file__).parent / "recorded_v1" / "2026-11-27"


def document(kind: str) -> dict:
    (path,) = RECORDED.glob(f"{kind}.*.json")
    return json.loads(path.read_text("utf-8"))["document"]


@pytest.fixture
def cell(tmp_path, free_port):
    """A bus with the recorded documents and answers of a daemon, its configuration, and `joint-monitor` on the path."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    config = (ROOT / "config" / "simulated.toml").read_text("utf-8") + f'\n[bus]\nlisten = ["{endpoint}"]\n'
    assert "[bus]" not in (ROOT / "config" / "simulated.toml").read_text("utf-8")
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "simulated.toml").write_text(config, "utf-8")
    script = tmp_path / "joint-monitor"
    script.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m monitor "$@"\n')
    script.chmod(0o755)
    answers = {
        "torque": QueryHandler("torque", lambda _: raw("torque", document("torque"))),
        "event": QueryHandler("events", lambda _: raw("events", EVENTS), payload=False),
    }
    with Bus(BusSettings(listen=(endpoint,)), prefix("lab", "sim-1"), answers) as bus:
        bus.say(raw("health", document("health")))
        bus.say(raw("alert", document("alert")))
        stop, number = threading.Event(), [3]

        def speak() -> None:
            while not stop.wait(0.2):
                number[0] += 1
                bus.say(raw("alert", document("alert")))
                bus.say(raw("event", document("event") | {"seq": number[0]}))

        speaker = threading.Thread(target=speak)
        speaker.start()
        try:
            yield tmp_path, endpoint
        finally:
            stop.set()
            speaker.join()


EVENTS = {"events": [], "first_kept": 1, "last": 3}


def first_lines(command: list[str], count: int, folder: Path, **more: object) -> list[str]:
    """The first lines of a program that does not end by itself."""
    environment = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder, env=environment, start_new_session=True, **more)
    try:
        return [process.stdout.readline() for _ in range(count)]
    finally:
        os.killpg(process.pid, 9)
        process.communicate()


def block(language: str, holds: str) -> str:
    (found,) = [text for text in re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL) if holds in text]
    return found


def plain(cell) -> Path:
    """The program of the page; the test replaces only the endpoint."""
    folder, endpoint = cell
    text = block("python", "import itertools, json, zenoh\n\nconfig")
    assert len([row for row in text.splitlines() if row]) <= 15
    (folder / "plain.py").write_text(text.replace("tcp/127.0.0.1:7447", endpoint), "utf-8")
    return folder


def test_the_plain_zenoh_example_runs_unchanged(cell):
    """It uses no code of this package: a torque, then the texts of alerts."""
    torque, *alerts = first_lines([sys.executable, "-u", "plain.py"], 3, plain(cell))
    assert json.loads(torque) == document("torque")["torque_nm"]
    assert alerts == ["joint-monitor/v1/lab/sim-1/alert/j3/wear_rising Joint 3: friction rose\n"] * 2


def test_the_plain_zenoh_example_prints_alerts_that_were_raised_long_before_it(tmp_path, free_port):
    """Nothing is published after its start. A plain subscriber alone gets none of it, as the page says, and a `get` gets all."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    answers = {"torque": QueryHandler("torque", lambda _: raw("torque", document("torque")))}
    with Bus(BusSettings(listen=(endpoint,)), prefix("lab", "sim-1"), answers) as bus:
        bus.say(raw("alert", document("alert") | {"joint": None, "condition": "stopped", "text": "Nothing moves"}))
        bus.say(raw("alert", document("alert") | {"active": False}))
        _, alert = first_lines([sys.executable, "-u", "plain.py"], 2, plain((tmp_path, endpoint)))
        assert alert == "joint-monitor/v1/lab/sim-1/alert/arm/stopped Nothing moves\n"
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        with zenoh.open(config) as session:
            late = session.declare_subscriber("joint-monitor/v1/*/*/alert/**")
            assert len(list(session.get("joint-monitor/v1/*/*/alert/**"))) == 2
            assert late.try_recv() is None


def test_the_jq_example_runs_unchanged(cell):
    """It prints the last values first and then live ones."""
    if shutil.which("jq") is None:
        pytest.skip("jq is not installed: apt-get install jq")
    shown = first_lines(["sh", "-c", block("sh", "jq")], 2, cell[0])
    assert shown == ["alert/j3/wear_rising: Joint 3: friction rose inspect\n"] * 2


def test_the_node_example_runs_unchanged(cell):
    """It prints the transitions in another language."""
    if shutil.which("node") is None:
        pytest.skip("Node is not installed: apt-get install nodejs")
    (cell[0] / "watch.mjs").write_text(block("js", "spawn"), "utf-8")
    shown = first_lines(["node", "watch.mjs"], 2, cell[0])
    numbers = [int(row.split()[0]) for row in shown]
    assert numbers[1] == numbers[0] + 1
    assert shown[0].endswith(" raised 3 wear_rising Joint 3: friction rose\n")


def test_watch_is_coloured_on_a_terminal_and_plain_in_a_pipe(cell):
    """The same line has escape sequences on a terminal and none in a pipe."""
    folder, _ = cell
    command = ["joint-monitor", "watch", "--config", "config/simulated.toml", "--keys", "health"]
    (plain,) = first_lines(command, 1, folder)
    assert plain.startswith("health  NORMAL  J1 NORMAL")
    master, slave = pty.openpty()
    environment = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "TERM": "xterm-256color", "COLUMNS": "200"}
    environment.pop("NO_COLOR", None)
    process = subprocess.Popen(command, stdout=slave, stderr=slave, cwd=folder, env=environment, start_new_session=True)
    os.close(slave)
    try:
        seen, deadline = b"", time.monotonic() + 60.0
        while b"\n" not in seen and time.monotonic() < deadline:
            if select.select([master], [], [], 1.0)[0]:
                seen += os.read(master, 4096)
    finally:
        os.killpg(process.pid, 9)
        process.wait()
        os.close(master)
    coloured = seen.decode().splitlines()[0]
    assert "\x1b[32mNORMAL" in coloured
    assert Text.from_ansi(coloured).plain.rstrip() == plain.rstrip()


@pytest.mark.parametrize("path", sorted(RECORDED.glob("*.*.json")), ids=lambda path: path.stem)
def test_every_document_is_shown_on_one_line_and_streams_in_words(path):
    """This holds for every recorded document. Only answers to queries, which nobody watches, are shown as JSON."""
    recorded = json.loads(path.read_text("utf-8"))
    shown = line(recorded["key"], recorded["document"]).plain
    assert "\n" not in shown
    assert len(shown) < 400
    if recorded["kind"] in ("health", "alert", "event", "friction", "torque-live", "info", "model", "replay", "monitor"):
        assert "{" not in shown


@pytest.mark.parametrize(
    "key", ["health", "alert/j1/x", "event", "joint/1/friction", "torque/live", "info", "model", "replay", "monitor", "new/kind"]
)
@pytest.mark.parametrize("strange", [{}, {"state": 1, "joints": [{}]}, {"text": None, "active": 1, "tier": []}, {"predicted_nm": ["x"]}])
def test_a_document_that_is_not_as_expected_is_still_shown(key, strange):
    """No published document ends a watch."""
    assert key in line(key, strange).plain


def test_the_monitors_problems_are_shown_as_a_line_and_not_as_json():
    """The line comes every ten seconds, with the problems or "none", and the time of the next replay."""
    fine = {"troubles": [], "next_replay_due": "2026-11-21T17:00:00Z"}
    assert line("monitor", fine).plain == "monitor  no trouble  next replay 2026-11-21T17:00:00Z"
    wrong = {"troubles": [{"name": "arm", "text": "127.0.0.2:\nnobody"}, {"name": "disk", "text": "full"}], "next_replay_due": None}
    assert line("monitor", wrong).plain == "monitor  arm: 127.0.0.2: nobody; disk: full  next replay none"
