"""A cell on a simulated arm: a production program that plays round and round, and lends its arm at a node between two moves."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from simulated_arm import simulated_arm

from monitor.acquire.hand_over.script import hand_over_script
from monitor.acquire.hand_over.server import HandOverServer
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.control_script import control_script
from monitor.simulate.remote import Remote

AT_NODE = (0.12, -1.5, 0.2, -1.4, 0.1, -0.1)  # near the start of `short()`
AFTER = (-0.05, -1.5, 0.2, -1.4, 0.1, -0.1)
CELL = """name = "cell"
[[node]]
move = {at_node}
[[node]]
external_control = "{host}:{port}"
[[node]]
move = {after}
[[node]]
wait = {rest_s}
"""


@dataclass(frozen=True)
class Cell:
    """A cell whose program plays."""

    host: str
    server: HandOverServer

    def settings(self, **others) -> ReplaySettings:
        values = {"allow_motion": True, "first_pass": False, "approach_speed_rad_s": 1.0, "hand_over": "external_control"}
        return ReplaySettings(host=self.host, **{**values, "hand_over_wait_h": 0.005, **others})

    def dashboard(self, line: str) -> str:
        with socket.create_connection((self.host, 29999), timeout=10.0) as wire, wire.makefile("rw") as file:
            file.readline()
            file.write(line + "\n")
            file.flush()
            return file.readline().strip()

    @property
    def truth(self) -> dict:
        with Remote(self.host) as remote:
            return remote.truth()

    def fault(self, name: str, **arguments) -> None:
        with Remote(self.host) as remote:
            remote.fault(name, **arguments)


@contextmanager
def lending_cell(host: str, folder: Path, *options: str, rest_s: float = 0.2, play: bool = True) -> Iterator[Cell]:
    """The cell at this address; its server listens there too, as a monitor on another host would."""
    with simulated_arm(host, *options):
        text = hand_over_script(control_script(host))
    (folder / "cell.toml").write_text(CELL.format(at_node=list(AT_NODE), after=list(AFTER), host=host, port=50002, rest_s=rest_s))
    with (
        HandOverServer(text, bind=host) as server,
        simulated_arm(host, *options, "--program", str(folder / "cell.toml")),
    ):
        cell = Cell(host, server)
        if play:
            assert cell.dashboard("play") == "Starting program"
        yield cell


class Poses(threading.Thread):
    """Looks at the true position of the arm again and again, and remembers the passes through the place after the node."""

    def __init__(self, cell: Cell) -> None:
        super().__init__(daemon=True)
        self.cell, self.over, self.after = cell, threading.Event(), 0

    def __enter__(self) -> "Poses":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.over.set()
        self.join()

    def run(self) -> None:
        there = False
        with Remote(self.cell.host) as remote:
            while not self.over.wait(0.05):
                near = bool(np.max(np.abs(np.array(remote.truth()["q"]) - AFTER)) < 0.005)
                self.after += near and not there
                there = near
