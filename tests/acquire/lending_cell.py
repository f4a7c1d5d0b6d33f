"""A cell on a simulated arm: a production program that plays round and round, and lends its arm at a node between two moves."""

import json
import socket
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from simulated_arm import simulated_arm

from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.driver import UniversalRobots
from monitor.acquire.ur.node_script import control_script, hand_over_script
from monitor.acquire.ur.node_server import HandOverServer
from monitor.simulate.remote import Remote

ROBOT_API = 18080  # of a cell with a PolyScope X
AT_NODE = (0.12, -1.5, 0.2, -1.4, 0.1, -0.1)  # near the start of `short()`
AFTER = (-0.05, -1.5, 0.2, -1.4, 0.1, -0.1)
CELL = """name = "cell"
[[node]]
move = {at_node}
[[node]]
script = "before.script"
[[node]]
external_control = "{host}:{port}"
[[node]]
script = "after.script"
[[node]]
move = {after}
[[node]]
wait = {rest_s}
"""
BEFORE = "test_q = get_target_joint_positions()\n"
CYCLES, ASTRAY = 12, 13  # output registers: how often the program went on after the node, and how often from another pose
AFTER_SCRIPT = f"""test_here_q = get_target_joint_positions()
test_astray = 0
test_joint = 0
while test_joint < 6:
  if norm(test_here_q[test_joint] - test_q[test_joint]) > 0.001:
    test_astray = 1
  end
  test_joint = test_joint + 1
end
write_output_integer_register({CYCLES}, read_output_integer_register({CYCLES}) + 1)
write_output_integer_register({ASTRAY}, read_output_integer_register({ASTRAY}) + test_astray)
"""


def settings(host: str, **others) -> ReplaySettings:
    """Of a replay that borrows the arm at this address."""
    values = {"allow_motion": True, "first_pass": False, "approach_speed_rad_s": 1.0, "hand_over": "external_control"}
    return ReplaySettings(host=host, **{**values, "hand_over_wait_h": 0.005, **others})


@dataclass
class Cell:
    """A cell whose program plays."""

    host: str
    text: str
    server: HandOverServer
    robot_api: bool = False

    def settings(self, **others) -> ReplaySettings:
        return settings(self.host, **others)

    @property
    def driver(self) -> UniversalRobots:
        return UniversalRobots(robot_api_port=ROBOT_API)

    def serve(self) -> None:
        """Serve the text of the node again."""
        self.server = HandOverServer(self.text, bind=self.host)

    def tell(self, line: str) -> None:
        """A word to the dashboard, whatever it answers."""
        self.dashboard(line)

    def dashboard(self, line: str) -> str:
        """The answer to a line, in the words of a dashboard also where the controller has a Robot API."""
        if self.robot_api:
            place = f"http://{self.host}:{ROBOT_API}/universal-robots/robot-api/program/v1/state"
            action = None if line == "programState" else json.dumps({"action": line}).encode()
            with urllib.request.urlopen(urllib.request.Request(place, action, method="PUT" if action else "GET"), timeout=10.0) as answer:
                return "Starting program" if line == "play" else f"{json.load(answer).get('state', '')} cell.urp"
        with socket.create_connection((self.host, 29999), timeout=10.0) as wire, wire.makefile("rw") as file:
            file.readline()
            file.write(line + "\n")
            file.flush()
            return file.readline().strip()

    @property
    def truth(self) -> dict:
        with Remote(self.host) as remote:
            return remote.truth()

    @property
    def cycles(self) -> int:
        """How often the program has gone on after its node."""
        return int(self.truth["output_integers"][CYCLES])

    @property
    def astray(self) -> int:
        """How often of these the arm was more than 1 mrad from where it was before the node."""
        return int(self.truth["output_integers"][ASTRAY])

    def fault(self, name: str, **arguments) -> None:
        with Remote(self.host) as remote:
            remote.fault(name, **arguments)


@contextmanager
def lending_cell(host: str, folder: Path, *options: str, rest_s: float = 0.2, play: bool = True) -> Iterator[Cell]:
    """The cell at this address; its server listens there too, as a monitor on another host would."""
    robot_api = any(option.startswith("10.") for option in options)
    options = (*options, "--robot-api-port", str(ROBOT_API)) if robot_api else options
    with simulated_arm(host, *options):
        text = hand_over_script(control_script(host))
    (folder / "before.script").write_text(BEFORE)
    (folder / "after.script").write_text(AFTER_SCRIPT)
    (folder / "cell.toml").write_text(CELL.format(at_node=list(AT_NODE), after=list(AFTER), host=host, port=50002, rest_s=rest_s))
    with simulated_arm(host, *options, "--program", str(folder / "cell.toml")):
        cell = Cell(host, text, HandOverServer(text, bind=host), robot_api=robot_api)
        try:
            if play:
                assert cell.dashboard("play") == "Starting program"
            yield cell
        finally:
            cell.server.close()
