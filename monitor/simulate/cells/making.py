"""What the cells of the catalogue are made with, and the steps that their programs share."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from monitor.model.robot import Robot
from monitor.simulate.cells.cell import Cell, Cycle
from monitor.simulate.cells.layout import Layout, Mass, Pace, Pose
from monitor.simulate.cells.things import Grip, Thing
from monitor.simulate.controller.program.steps import Declare, Output, Step, Wait

UR5_M = 0.817  # reach of the arm for which lengths of tools are given
GRIPPER = 0  # digital output of the gripper
GRIP_S = 0.35  # a gripper needs this time


class Kind(NamedTuple):
    """One name of the catalogue."""

    about: str
    make: Callable[["Maker"], Cell]


class Maker:
    """What every cell of one arm and one seed is made with: masses and lengths grow with the arm."""

    def __init__(self, name: str, about: str, robot: Robot, seed: int) -> None:
        """`seed` moves the places, and is that of declared masses."""
        self.name, self.about, self.robot, self.seed = name, about, robot, seed
        self.scale = robot.payload_max_kg / 5.0

    def layout(self, *, tcp_m: float = 0.15, pace: Pace | None = None) -> Layout:
        """A layout of this arm."""
        longer = float(np.abs(self.robot.a_m).sum()) / UR5_M
        return Layout(robot=self.robot, tcp_m=tcp_m * min(longer, 1.3), seed=self.seed, pace=pace or Pace())

    def mass(self, kg: float, z_m: float, x_m: float = 0.0) -> Mass:
        """A mass for an arm that carries 5 kg, scaled to this arm."""
        return Mass(self.scale * kg, (x_m, 0.0, z_m))

    def cell(self, layout: Layout, tool: Mass, home: Pose, cycle: Cycle, *things: Thing, declared: tuple[float, ...] | None = None) -> Cell:
        """The whole; `declared` is what the program says of the tool alone."""
        return Cell(
            name=self.name,
            about=self.about,
            layout=layout,
            tool=tool,
            tool_declared=declared or tool.declared(layout.dice),
            cycle=cycle,
            things=things,
            home_rad=tuple(layout.q(home).tolist()),
        )


def carry(figures: tuple[float, ...]) -> Declare:
    """A set_payload."""
    return Declare("set_payload", figures)


def grip(*, holds: bool, declared: tuple[float, ...] | None, output: int = GRIPPER) -> Iterator[Step]:
    """Close or open a gripper, and declare what is then carried; None declares nothing."""
    yield Output(output, holds)
    yield Wait(GRIP_S)
    if declared is not None:
        yield carry(declared)


def handling(make: Maker, *, declared_kg: float | None = 1.5, part_kg: float = 1.5, extra: tuple[Thing, ...] = ()) -> Cell:
    """Pick-and-place from a belt into a tray of 2 × 3. `declared_kg` is what the program says of the part; None: it says nothing."""
    layout = make.layout(pace=Pace(joints=1.8, joints_2=3.0, lines=0.5, lines_2=2.0))
    tool, part = make.mass(0.9, 0.06), make.mass(part_kg, 0.16)
    alone = tool.declared(layout.dice)
    loaded = None if declared_kg is None else tool.with_(make.mass(declared_kg, 0.16)).declared(layout.dice)
    pick, tray = layout.place(0.72, -42.0, 0.05), layout.place(0.66, 40.0, -0.02, turn=60.0)
    step_m = 0.09 * layout.reach_m
    seats = [layout.shifted(tray, step_m * (i // 3), step_m * (i % 3 - 1)) for i in range(6)]

    def cycle(n: int) -> Iterator[Step]:
        seat = seats[n % 6]
        yield layout.to(layout.up(pick), blend_m=0.03)
        yield layout.along(pick)
        yield from grip(holds=True, declared=loaded)
        yield layout.along(layout.up(pick), blend_m=0.04)
        yield layout.to(layout.up(seat), blend_m=0.04)
        yield layout.along(seat)
        yield from grip(holds=False, declared=None if loaded is None else alone)
        yield layout.along(layout.up(seat), blend_m=0.04)

    return make.cell(layout, tool, layout.up(pick), cycle, Grip(output=GRIPPER, mass=part), *extra, declared=alone)
