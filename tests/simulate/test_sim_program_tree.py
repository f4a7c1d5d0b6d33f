"""Production programs as trees of nodes: what is asked of other hosts at Play, and what plays."""

import socket
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from sim_process import eventually

from monitor.errors import BadInput
from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.journal import TextMessage
from monitor.simulate.machine.state import Runtime
from monitor.simulate.program_tree import Host, load_tree
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire import dashboard

SERVED = (
    "# HEADER_BEGIN\nglobal visits = 0\ndef visit():\n  visits = visits + 1\n  return visits\nend\n# HEADER_END\n"
    'textmsg("visit ", visit())\n'
)
HOST = Host("127.0.0.1", 50002)


def tree_of(tmp_path: Path, *nodes: str, loop: bool = True, name: str = "cell"):
    file = tmp_path / "cell.toml"
    file.write_text(f'name = "{name}"\nloop = {str(loop).lower()}\n' + "".join(f"[[node]]\n{node}\n" for node in nodes))
    return load_tree(file)


def played(tree, seconds: float, served=None) -> Controller:
    controller = Controller(SimulateSettings(robot="ur5e", program=tree))
    controller.step()
    controller.programs.files.serve(served or {})
    assert controller.programs.play()
    run(controller, seconds)
    return controller


def run(controller: Controller, seconds: float) -> None:
    for _ in range(round(seconds / controller.clock.tick_s)):
        controller.step()


def texts(controller: Controller) -> list[str]:
    return [message.text for message in controller.journal.messages if isinstance(message, TextMessage)]


def test_nodes_play_in_order_and_again_and_again(tmp_path):
    """Moves, waits, messages and script nodes. The arm ends where the last move took it."""
    (tmp_path / "mine.script").write_text('textmsg("mine ", 1 + 1)\n')
    move = "move = [0.1, -1.57, 0, -1.57, 0, 0]\nspeed = 3.0\nacceleration = 20.0"
    tree = tree_of(tmp_path, 'message = "begin"', move, "wait = 0.05", 'script = "mine.script"')
    controller = played(tree, 1.0)
    assert texts(controller)[:4] == ["begin", "mine 2", "begin", "mine 2"]
    assert controller.reference.q[0] == pytest.approx(0.1, abs=1e-3)
    once = played(tree_of(tmp_path, 'message = "begin"', loop=False), 0.1)
    assert texts(once) == ["begin"]
    assert once.modes.runtime == Runtime.STOPPED


def test_a_served_header_stands_once_and_its_node_at_every_place(tmp_path):
    """Two nodes of one host share their variables; the text is that of the last Play."""
    node = 'external_control = "127.0.0.1"'
    tree = tree_of(tmp_path, node, 'message = "between"', node, loop=False)
    assert tree.hosts == (HOST,)
    assert tree.script({HOST: SERVED}).count("def visit") == 1
    assert texts(played(tree, 0.1, {HOST: SERVED})) == ["visit 1", "between", "visit 2"]


def test_a_host_that_is_away_blocks_the_program_with_a_popup_until_it_is_closed(tmp_path):
    """The node behind it plays only after a person has closed the popup; a stop of the program closes it too."""
    tree = tree_of(tmp_path, 'external_control = "127.0.0.1:50002"', 'message = "behind"', loop=False)
    controller = played(tree, 1.0, {HOST: None})
    assert "127.0.0.1:50002" in controller.modes.popup
    assert texts(controller) == []
    dashboard.reply(controller, "close popup")
    run(controller, 0.1)
    assert texts(controller) == ["behind"]


def test_a_served_text_that_is_no_urscript_is_refused_at_play(tmp_path):
    """The program does not start, and the reason names the line."""
    tree = tree_of(tmp_path, 'external_control = "127.0.0.1"')
    controller = Controller(SimulateSettings(robot="ur5e", program=tree))
    controller.programs.files.serve({HOST: "this is no program"})
    assert dashboard.reply(controller, "play") == "Failed to execute: play"
    assert "line" in controller.journal.refused_scripts[-1]
    assert np.all(controller.reference.qd == 0.0)


@pytest.mark.parametrize(
    ("node", "expected"),
    [
        ("move = [0, 1]", "6 joint positions"),
        ("wait = -1", "from 0 to"),
        ('wait = 1\nmessage = "two kinds"', "exactly one of"),
        ('external_control = "127.0.0.1:here"', "ADDRESS:PORT"),
        ('script = "nowhere.script"', "nowhere.script"),
        ("speed = 1.0", "exactly one of"),
        ('message = "x"\ncolour = 1', "colour is not an argument"),
    ],
)
def test_a_wrong_node_is_named_with_what_is_expected(tmp_path, node, expected):
    """The message names the file and the node."""
    with pytest.raises(BadInput, match="node 2") as wrong:
        tree_of(tmp_path, 'message = "good"', node)
    assert expected in str(wrong.value)


@contextmanager
def serving(text: str) -> Iterator[tuple[int, list[bytes]]]:
    asked: list[bytes] = []

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            asked.append(self.rfile.readline())
            self.wfile.write(text.encode())

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_address[1], asked
        server.shutdown()


def test_play_on_the_dashboard_asks_each_host_once(tmp_path, spawn):
    """The request is that of the manufacturer's node. The next Play asks again; a host that has gone is a popup."""
    with serving(SERVED) as (port, asked):
        node = f'external_control = "127.0.0.1:{port}"'
        tree_of(tmp_path, node, node, "wait = 0.02", loop=False)
        simulator = spawn("--robot", "ur5e", "--program", str(tmp_path / "cell.toml"))
        for count in (1, 2):
            assert ask(simulator.address, "play") == "Starting program"
            assert asked == [b"request_program\n"] * count
            assert eventually(lambda: ask(simulator.address, "programState") == "STOPPED cell.urp", 5.0)
    assert ask(simulator.address, "play") == "Starting program"
    with simulator.remote() as remote:
        assert eventually(lambda: "could not be established" in remote.truth()["popup"], 5.0)
    assert ask(simulator.address, "close popup") == "closing popup"


def ask(host: str, line: str) -> str:
    """One line to the dashboard on a connection of its own."""
    with socket.create_connection((host, 29999), timeout=8) as wire, wire.makefile("rw") as file:
        file.readline()
        file.write(line + "\n")
        file.flush()
        return file.readline().strip()
