"""The daemon borrows the arm of a program that plays: real processes, the real wire, real Zenoh, in real time."""

import json
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import ended
from simulated_arm import simulated_arm
from test_daemon import Cell, eventually, stop

from monitor.acquire.ur.node_server import REQUEST
from monitor.publish.client import Client
from monitor.service.node import number_of
from monitor.simulate.remote import Remote
from monitor.store.store import Store

pytestmark = pytest.mark.real_time

AT_NODE = (0.12, -1.5, 0.2, -1.4, 0.1, -0.1)
AFTER = (-0.05, -1.5, 0.2, -1.4, 0.1, -0.1)
TREE = """name = "cell"
[[node]]
move = {at_node}
[[node]]
external_control = "{host}:50002"
[[node]]
move = {after}
[[node]]
wait = 0.2
"""


class LendingCell(Cell):
    """The daemon's configuration, and a program that asks that daemon for its node's text."""

    def __init__(self, folder: Path, host: str, port: int) -> None:
        super().__init__(folder, host, port)
        text = self.config.read_text().replace("[replay]", f'[replay]\nhand_over = "external_control"\nhand_over_listen = "{host}:50002"')
        self.config.write_text(text)
        tree = TREE.format(at_node=list(AT_NODE), after=list(AFTER), host=host)
        (folder / "program.toml").write_text(tree)

    def dashboard(self, line: str) -> str:
        with socket.create_connection((self.host, 29999), 10.0) as wire, wire.makefile("rw") as file:
            file.readline()
            file.write(line + "\n")
            file.flush()
            return file.readline().strip()

    def node(self) -> str | None:
        """The number of the text that a node would get; None while there is none."""
        try:
            with socket.create_connection((self.host, 50002), 2.0) as wire, wire.makefile() as file:
                wire.sendall(REQUEST + b"\n")
                return number_of(file.readline())
        except OSError:
            return None

    def passes(self, remote: Remote, count: int) -> bool:
        """Whether the program goes round so often: the arm is seen at the place after the node, and away from it again."""

        def after_the_node() -> bool:
            return max(abs(q - there) for q, there in zip(remote.truth()["q"], AFTER, strict=True)) < 0.01

        return all(eventually(after_the_node, 20.0) and eventually(lambda: not after_the_node(), 20.0) for _ in range(count))


@pytest.fixture
def cell(tmp_path: Path, free_port: int, worker_id: str) -> Iterator[LendingCell]:
    host = f"127.0.5.{40 + (0 if worker_id == 'master' else int(worker_id[2:]))}"
    cell = LendingCell(tmp_path, host, free_port)
    with simulated_arm(host, "--robot", "ur5", "--program", str(tmp_path / "program.toml")):
        try:
            yield cell
        finally:
            cell.end()


def due(client: Client) -> dict | None:
    documents = client.get("monitor")
    return documents[0].document["due"] if documents else None


def test_the_arm_is_borrowed_at_the_node_once_the_program_plays_and_the_program_goes_on(cell: LendingCell):
    """Due since `--now`, told on the bus and by `status`, still due after kill −9; then the program plays, and lends the arm once."""
    daemon = cell.daemon("--now")
    with cell.client() as client:
        assert eventually(lambda: due(client) is not None, 30.0), daemon.kill() or daemon.communicate()[1]
        since = due(client)["since"]
    assert eventually(lambda: cell.node() is not None, 30.0)
    checked = json.loads(ended("check", "--config", str(cell.config), "--json").stdout)
    (served,) = [each for each in checked["service"] if each["name"] == "hand_over"]
    assert cell.node() in served["text"]
    daemon.kill()
    daemon.communicate()

    daemon = cell.daemon()
    with cell.client() as client, Remote(cell.host) as remote:
        assert eventually(lambda: due(client) is not None and due(client)["since"] == since, 30.0), daemon.kill() or daemon.communicate()[1]
        shown = ended("status", "--config", str(cell.config)).stdout
        assert f"replay due since {since} (asked for), " in shown.replace("\n", " ")
        assert cell.node() is not None  # from the first moment on: the text was kept
        assert cell.dashboard("play") == "Starting program"
        assert eventually(lambda: bool(client.get("replay")) and client.get("replay")[0].document["state"] == "ended", 60.0)
        assert cell.passes(remote, 2), (cell.dashboard("programState"), client.get("monitor")[0].document["last_replay"])
        assert cell.dashboard("programState") == "PLAYING cell.urp"
        truth = remote.truth()
        assert (truth["stops"], truth["watchdog_s"]) == ([], None)
        assert eventually(lambda: client.get("monitor")[0].document["due"] is None, 15.0)
        last = client.get("monitor")[0].document["last_replay"]
    output = stop(daemon)
    assert last["state"] == "assessed", output
    assert last["borrowed"]["program"] == "cell.urp"
    assert last["borrowed"]["due_since"] == since
    assert 5.0 < last["borrowed"]["waited_s"] < 40.0
    assert last["borrowed"]["given_back"]
    with Store.reader(cell.folder / "history") as store:
        (row,) = store.ledger.rows()
        assert row.kind == "requested"
        assert store.stops.waiting() == []
    shown = ended("status", "--config", str(cell.config)).stdout
    assert "borrowed from cell.urp, which waited" in shown
