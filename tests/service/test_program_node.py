"""The text of a program's node: made once, served by the daemon from its first moment on, written as a file, and looked at by `check`."""

import json
import os
import socket
import struct
import threading
import time
from pathlib import Path

import pytest
from command_line import ended
from sim_process import Spawned
from test_hand_over_script import CONTROL

from monitor.acquire.driver import usual_driver
from monitor.acquire.safety.inputs import ConditionResult
from monitor.acquire.settings import HandOver
from monitor.acquire.ur.driver import UniversalRobots
from monitor.acquire.ur.node_script import BEAT, DUE, IDLE, OFFER, OFFERED, STATE, TAKE, TAKEN, VERSION
from monitor.acquire.ur.rtde import PORT as RTDE_PORT
from monitor.config.load import load
from monitor.errors import BadConfiguration, RobotUnreachable
from monitor.service.node import (
    NO_TEXT,
    PROBLEM,
    NodeServer,
    NodeText,
    keep,
    kept,
    node_conditions,
    node_text,
    number_of,
    own_address,
    version_of,
)
from monitor.service.problems import Problems
from monitor.simulate.controller.controller import Controller
from monitor.simulate.program_tree import load_tree
from monitor.simulate.settings import SimulateSettings

HOST = f"127.0.9.{10 + int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])}"
SILENT = "127.0.9.250"  # nothing answers there
SLOW = "127.0.9.251"


@pytest.fixture(scope="module")
def arm():
    """A simulated UR5e, of which the tests only ask who it is."""
    spawned = Spawned(HOST, "--robot", "ur5e")
    yield spawned
    spawned.end()


@pytest.fixture(scope="module")
def node(arm) -> NodeText:
    return node_text(HOST)


@pytest.fixture
def config(tmp_path: Path, free_port: int):
    def write(by: str, listen: str | None = None, host: str = HOST) -> Path:
        path = tmp_path / "cell.toml"
        path.write_text(
            f'[robot]\nmodel = "ur5e"\nsite = "lab"\nid = "cell-1"\nhost = "{host}"\n[store]\ndirectory = "history"\n'
            f'[replay]\nhand_over = "{by}"\nhand_over_listen = "{listen or f"127.0.0.1:{free_port}"}"\n'
        )
        return path

    return write


def asked(port: int) -> str:
    """What a controller reads: one request, everything until the connection ends."""
    with socket.create_connection(("127.0.0.1", port), timeout=2.0) as wire:
        wire.sendall(b"request_program\n")
        answer = b""
        while data := wire.recv(65536):
            answer += data
    return answer.decode()


def lending(port: int) -> HandOver:
    return HandOver(by="external_control", bind="127.0.0.1", port=port, wait_s=60.0)


class Named(UniversalRobots):
    """A controller that says this software, or does not answer."""

    def __init__(self, firmware: str | None) -> None:
        self.firmware = firmware

    def identity(self, host: str):
        if self.firmware is None:
            raise RobotUnreachable(f"{host}: off")
        return UniversalRobots().identity(host)._replace(firmware=self.firmware)


def test_the_text_is_made_for_the_controller_and_numbered(node: NodeText):
    """Another text has another number, the same one the same; the number stands in the first line, where a person can read it."""
    assert node.text.splitlines()[0] == f"# joint-monitor node {node.number}"
    assert NodeText.of(node.software, node.control, usual_driver()).number == node.number
    assert NodeText.of(node.software, node.control.replace("sync()", "sleep(0.01)"), usual_driver()).number != node.number
    assert number_of("def program():\nend\n") is None


def test_a_kept_text_is_one_of_the_same_library_and_unhurt(node: NodeText, tmp_path: Path):
    """A file of another ur-rtde, half a file and none are no text; the controller is asked again then."""
    assert kept(tmp_path) is None
    keep(tmp_path, node)
    assert kept(tmp_path) == node
    path = tmp_path / "hand-over-node.json"
    whole = path.read_text()
    path.write_text(json.dumps({**json.loads(whole), "library": "0.1"}))
    assert kept(tmp_path) is None
    path.write_text(whole[: len(whole) // 2])
    assert kept(tmp_path) is None


def test_the_server_answers_while_the_controller_is_off_and_takes_another_text_with_other_software(
    node: NodeText, tmp_path: Path, free_port: int
):
    """The first start of all serves a node that does nothing; every later one serves what is kept. New software brings a new text."""
    problems = Problems(lambda: 0.0)
    off = Named(None)

    def refused(host: str) -> NodeText:
        raise RobotUnreachable(f"{host}: off")

    with NodeServer(lending(free_port), HOST, tmp_path, problems, driver=off, make=refused) as server:
        server.look()
        assert asked(free_port) == NO_TEXT
        assert PROBLEM in problems
    keep(tmp_path, node)
    problems = Problems(lambda: 0.0)
    with NodeServer(lending(free_port), HOST, tmp_path, problems, driver=off, make=refused) as server:
        assert asked(free_port) == node.text
        server.look()
        assert PROBLEM not in problems  # the node is answered, and the controller will be asked again
    other = NodeText.of("9.9", node.control.replace("sync()", "sleep(0.01)"), usual_driver())
    with NodeServer(lending(free_port), HOST, tmp_path, problems, driver=Named("9.9"), make=lambda _: other) as server:
        server.look()
        assert asked(free_port) == other.text
    assert kept(tmp_path) == other


def test_a_port_in_use_is_named(tmp_path: Path, free_port: int):
    """Another External Control server on the port: the daemon does not start beside it, and says why."""
    taken = pytest.raises(BadConfiguration, match=f":{free_port}: another program listens there")
    with socket.create_server(("127.0.0.1", free_port)), taken:
        NodeServer(lending(free_port), HOST, tmp_path, Problems(lambda: 0.0))


def found(path: Path) -> ConditionResult:
    (condition,) = node_conditions(load(path))
    return condition


def test_check_says_what_a_node_would_get_and_from_where(node: NodeText, config, tmp_path: Path, free_port: int):
    """Nobody on the port, the daemon's server, another program, an address that no controller reaches; nothing where nobody lends."""
    path = config("external_control")
    nobody = found(path)
    assert nobody.holds
    assert not nobody.checked
    assert f"127.0.0.1, port {free_port}: nothing answers" in nobody.text
    keep(tmp_path, node)
    with NodeServer(lending(free_port), HOST, tmp_path, Problems(lambda: 0.0)):
        served = found(path)
    assert not served.checked
    assert f"a node gets text {node.number}" in served.text
    assert "no node was reached yet" in served.text
    with socket.create_server(("127.0.0.1", free_port)) as other:

        def hang_up() -> None:
            other.accept()[0].close()

        threading.Thread(target=hang_up, daemon=True).start()
        assert not found(path).holds
    assert "listens on 192.0.2.1 alone" in found(config("external_control", f"192.0.2.1:{free_port}")).text
    assert node_conditions(load(config("none"))) == ()
    assert own_address("127.0.0.1") == "127.0.0.1"


def says(version: int, reached: int) -> None:
    """Leave in the arm's registers what a node would leave there."""
    with socket.create_connection((HOST, 30002), timeout=2.0) as wire:
        words = "".join(f"  write_output_integer_register({place}, {value})\n" for place, value in ((VERSION, version), (OFFER, reached)))
        wire.sendall(f"sec node():\n{words}end\n".encode())
        until = time.monotonic() + 5.0
        while UniversalRobots().node_says(HOST) != (version, reached):
            assert time.monotonic() < until
            time.sleep(0.02)


def test_check_compares_the_text_of_today_with_that_of_the_program(node: NodeText, config, tmp_path: Path, free_port: int):
    """Which one the controller's program holds, nobody could see: a program that was not played again after an update has the old one."""
    keep(tmp_path, node)
    path = config("external_control")
    with NodeServer(lending(free_port), HOST, tmp_path, Problems(lambda: 0.0)):
        says(version_of(node.number), 1234)
        same = found(path)
        says(version_of(node.number) + 1, 1235)
        other = found(path)
    says(0, 0)
    assert same.checked
    assert "the program that was played last has it, its nodes were reached 1234 times" in same.text
    assert other.holds  # it speaks against no service: the program works
    assert not other.checked
    assert "HAS ANOTHER TEXT: stop it and play it again" in other.text


def test_a_controller_that_takes_its_time_still_says_what_its_program_has():
    """On a busy host or a slow network each answer takes half a second; that is not a controller that does not say it."""
    outputs = bytes((1,)) + b"INT32,INT32"
    answers = ((b"V", b"\x01"), (b"O", outputs), (b"S", b"\x01"), (b"U", b"\x01" + struct.pack(">2i", 77, 12)))

    def answer(listening: socket.socket) -> None:
        wire, _ = listening.accept()
        with wire:
            for kind, payload in answers:
                if kind != b"U":
                    wire.recv(4096)
                time.sleep(0.5)
                wire.sendall(struct.pack(">H", 3 + len(payload)) + kind + payload)

    with socket.create_server((SLOW, RTDE_PORT)) as listening:
        threading.Thread(target=answer, args=(listening,), daemon=True).start()
        assert UniversalRobots().node_says(SLOW) == (77, 12)


def test_what_a_program_says_of_its_text_is_what_check_expects(node: NodeText):
    """In its first lines, as the number of 32 bits that a register takes."""
    assert f"write_output_integer_register({VERSION}, {version_of(node.number)})" in node.text
    assert 0 < version_of(node.number) < 2**31


def test_the_file_of_a_script_node_is_written_once_and_never_replaced_unasked(arm, config, tmp_path: Path):
    """Written, found right already, refused where something else stands there, replaced with --force; as JSON as well."""
    path, file = config("script_node"), tmp_path / "lend.script"
    (tmp_path / "history").mkdir()  # the service has run; its folder is not made for it, because it would be of another user
    assert not found(path).checked
    command = ("script-node", "--config", str(path), "--output", str(file))
    first = json.loads(ended(*command, "--json").stdout)
    assert first["written"]
    assert number_of(file.read_text()) == first["number"]
    assert first["number"] in found(path).text  # kept beside the history, for `check`
    again = ended(*command)
    assert again.returncode == 0
    assert "is right already" in again.stdout
    file.write_text("def somebody_elses():\nend\n")
    refused = ended(*command)
    assert refused.returncode == 2
    assert "exists; nothing was done" in refused.stderr
    assert file.read_text().startswith("def somebody")
    assert ended(*command, "--force").returncode == 0
    assert number_of(file.read_text()) == first["number"]


@pytest.mark.parametrize(
    ("answers", "output", "code", "text"),
    [
        (True, "lend.txt", 2, "ends in .script"),
        (True, "missing/lend.script", 2, "does not exist"),
        (False, "lend.script", 1, SILENT),
    ],
)
def test_what_cannot_be_written_is_told_and_leaves_nothing(arm, config, tmp_path: Path, answers: bool, output: str, code: int, text: str):
    """A wrong name, a folder that is missing, a controller that does not answer."""
    host = HOST if answers else SILENT
    done = ended("script-node", "--config", str(config("script_node", host=host)), "--output", str(tmp_path / output))
    assert done.returncode == code
    assert text in done.stderr
    assert not (tmp_path / output).exists()


def test_the_file_lends_the_arm_from_an_ordinary_script_node(tmp_path: Path):
    """No server at Play: the text stands inline in the program's loop, is passed by while nothing is due, lends the arm, and goes on."""
    text = NodeText.of("5.11", CONTROL, usual_driver()).text
    (tmp_path / "lend.script").write_text(text)
    nodes = ('message = "before"', 'script = "lend.script"', "wait = 0.02")
    (tmp_path / "cell.toml").write_text('name = "cell"\n' + "".join(f"[[node]]\n{node}\n" for node in nodes))
    controller = Controller(SimulateSettings(robot="ur5e", program=load_tree(tmp_path / "cell.toml")))
    controller.step()
    assert controller.programs.play()
    inputs, outputs = controller.registers.inputs.ints, controller.registers.output_ints

    def steps(count: int) -> None:
        for _ in range(count):
            inputs[BEAT] = (inputs[BEAT] + 1) % 1000
            controller.step()

    steps(100)
    passed = outputs[OFFER]
    assert passed > 5  # a round takes some ticks beside its wait of 0.02 s
    inputs[DUE] = 1
    while outputs[STATE] != OFFERED:
        steps(1)
    inputs[TAKE] = outputs[OFFER]
    steps(100)
    assert outputs[STATE] == TAKEN
    inputs[TAKE] = inputs[DUE] = 0
    steps(100)
    assert outputs[STATE] == IDLE
    assert outputs[OFFER] > passed + 5
