"""What stands around an arm, as its controller knows it: it acts on the arm in every control period, and brings the cell's program."""

from collections.abc import Iterator
from typing import Protocol

from monitor.recording import Array
from monitor.simulate.controller.program.machine import Machine
from monitor.simulate.controller.program.steps import Step


class Surroundings(Protocol):
    """A cell around one arm. The steps of its program may ask for the state of the machine."""

    name: str

    def program(self, machine: Machine) -> Iterator[Step]:
        """The steps of the cell's program from its beginning, as at Play."""

    def step(self, machine: Machine) -> None:
        """Act on the arm: grip, press, lead it by the hand."""

    def wrench(self, machine: Machine) -> Array:
        """(6,) force [N] and torque [N·m] that the controller shows as `actual_TCP_force`."""
