"""What the cells of the catalogue are made with, and the steps that their programs share."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.model.robot import Robot
from monitor.simulate.cells.cell import Cell, Cycle
from monitor.simulate.cells.things import Bore, Grip, Hand, Layout, Leaning, Mass, Pace, Pose, Sticking, Stopping, Surface, Thing
from monitor.simulate.machine.moves import Comply
from monitor.simulate.program.steps import Declare, ForceMode, Freedrive, Output, Step, Wait

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


# --- The cells of production ----------------------------------------------------------------------------


def _pick_and_place(make: Maker) -> Cell:
    return handling(make)


def _palletising(make: Maker) -> Cell:
    layout = make.layout(pace=Pace(joints=1.5, joints_2=2.2, lines=0.45, lines_2=1.3))
    tool, box = make.mass(1.2, 0.07), make.mass(2.6, 0.2)
    alone, loaded = tool.declared(layout.dice), tool.with_(box).declared(layout.dice)
    belt, corner = layout.place(0.6, -75.0, 0.1), layout.place(0.72, 28.0, -0.16)
    size_m, tall_m = 0.2 * layout.reach_m, 0.1 * layout.reach_m

    def cycle(n: int) -> Iterator[Step]:
        slot, layer = n % 4, n // 4 % 3
        seat = layout.shifted(corner, -size_m * (slot // 2), size_m * (slot % 2), tall_m * layer)
        over = layout.shifted(seat, z_m=0.18 * layout.reach_m)
        yield layout.to(layout.up(belt, 0.25), blend_m=0.05)
        yield layout.along(belt)
        yield from grip(holds=True, declared=loaded)
        yield layout.along(layout.up(belt, 0.25), blend_m=0.08)
        yield layout.to(over, blend_m=0.05)
        yield layout.along(seat)
        yield from grip(holds=False, declared=alone)
        yield layout.along(over, blend_m=0.06)
        yield Wait(0.4)

    return make.cell(layout, tool, layout.up(belt, 0.25), cycle, Grip(output=GRIPPER, mass=box), declared=alone)


def _welding(make: Maker) -> Cell:
    layout = make.layout(tcp_m=0.3, pace=Pace(joints=1.0, joints_2=1.5, lines=0.3, lines_2=1.0))
    torch = make.mass(1.4, 0.1, 0.03)
    seams = [
        (layout.place(0.6, azimuth, height, turn=turn, tilt=tilt), length)
        for azimuth, height, turn, tilt, length in (
            (-25.0, 0.0, 0.0, 25.0, 0.22),
            (5.0, 0.0, 90.0, -20.0, 0.3),
            (32.0, 0.06, 30.0, 30.0, 0.18),
        )
    ]

    def cycle(n: int) -> Iterator[Step]:
        for k, (begin, length) in enumerate(seams):
            angle = math.atan2(begin[1], begin[0]) + math.radians(70.0 + 15.0 * k)  # nearly around the base
            end = layout.shifted(begin, length * layout.reach_m * math.cos(angle), length * layout.reach_m * math.sin(angle))
            yield layout.to(layout.up(begin, 0.12), blend_m=0.03)
            yield layout.along(begin)
            yield Wait(0.6)  # the arc starts
            yield layout.along(end, speed_m_s=0.012 + 0.004 * ((n + k) % 3))
            yield Wait(0.8)  # the crater is filled
            yield layout.along(layout.up(end, 0.12), blend_m=0.03)
        yield layout.to(layout.up(seams[0][0], 0.2))
        yield Wait(6.0)  # the clamps are opened and loaded

    return make.cell(layout, torch, layout.up(seams[0][0], 0.2), cycle)


def _tending(make: Maker) -> Cell:
    layout = make.layout(tcp_m=0.18)
    tool, blank, finished = make.mass(1.6, 0.08), make.mass(1.1, 0.18), make.mass(0.8, 0.18)
    alone = tool.declared(layout.dice)
    with_blank, with_finished = tool.with_(blank).declared(layout.dice), tool.with_(finished).declared(layout.dice)
    rack, chuck = layout.place(0.6, -60.0, 0.02), layout.place(0.72, 30.0, 0.22, turn=45.0)

    def cycle(_: int) -> Iterator[Step]:
        yield Wait(18.0)  # the machine works
        yield layout.to(layout.up(rack), blend_m=0.03)
        yield layout.along(rack)
        yield from grip(holds=True, declared=with_blank)
        yield layout.along(layout.up(rack), blend_m=0.05)
        yield layout.to(layout.up(chuck, 0.12))
        yield Wait(1.5)  # the door opens
        yield layout.along(chuck)
        yield from grip(holds=False, declared=alone)
        yield layout.along(layout.up(chuck, 0.12), blend_m=0.03)
        yield layout.along(chuck)
        yield from grip(holds=True, declared=with_finished, output=1)
        yield layout.along(layout.up(chuck, 0.12), blend_m=0.03)
        yield layout.to(layout.up(rack), blend_m=0.03)
        yield layout.along(rack)
        yield from grip(holds=False, declared=alone, output=1)
        yield layout.along(layout.up(rack), blend_m=0.03)
        yield layout.to(layout.up(chuck, 0.25))

    return make.cell(
        layout, tool, layout.up(chuck, 0.25), cycle, Grip(output=GRIPPER, mass=blank), Grip(output=1, mass=finished), declared=alone
    )


def _inspection(make: Maker) -> Cell:
    layout = make.layout(tcp_m=0.12, pace=Pace(joints=1.3, joints_2=2.0, lines=0.25, lines_2=1.0))
    camera = make.mass(0.6, 0.05)
    views = [
        layout.place(0.5 + 0.06 * (k % 3), -35.0 + 14.0 * k, 0.3, turn=35.0 * (k % 4) - 50.0, tilt=22.0 * math.sin(2.1 * k))
        for k in range(6)
    ]

    def cycle(_: int) -> Iterator[Step]:
        for view in views:
            yield layout.to(view)
            yield Wait(0.8)
        yield layout.along(layout.shifted(views[-1], y_m=-0.12 * layout.reach_m), speed_m_s=0.05)  # a scan
        yield Wait(2.0)

    return make.cell(layout, camera, views[0], cycle)


PRODUCTION: dict[str, Kind] = {
    "pick-and-place": Kind("parts of 1.5 kg from a belt into a tray, blended and fast", _pick_and_place),
    "palletising": Kind("boxes of 2.6 kg onto a pallet of three layers, with long reaches", _palletising),
    "welding": Kind("three seams at 12 to 20 mm/s with a tilted torch, and quick ways between them", _welding),
    "machine-tending": Kind("a machine is unloaded and loaded, with long waits", _tending),
    "inspection": Kind("a camera at six views, mostly by the wrists, and one slow scan", _inspection),
}


# --- The cells in which something disturbs: contact, loads that nobody declared, force control, people, stops, other tools ---

TOOL_A, TOOL_B = 4, 5  # digital outputs of a tool changer


def _undeclared(make: Maker) -> Cell:
    return handling(make, declared_kg=None, part_kg=1.0 / make.scale)


def _misdeclared(make: Maker) -> Cell:
    return handling(make, declared_kg=0.5 / make.scale, part_kg=1.5 / make.scale)


def _leaning(make: Maker) -> Cell:
    size = make.robot.max_torque_nm
    people = tuple(
        Leaning(joint=j, torque_nm_on_joint=0.12 * float(size[j]), first_s=6.0 + 5.0 * j, seconds=3.0, every_s=31.0) for j in (0, 2, 3)
    )
    return handling(make, extra=people)


def _sticking(make: Maker) -> Cell:
    return handling(make, extra=(Sticking(output=GRIPPER, breaks_n=70.0 * make.scale, every=2),))


def _stopping(make: Maker) -> Cell:
    return handling(make, extra=(Stopping(first_s=9.0, every_s=37.0),))


def _pressing(make: Maker) -> Cell:
    """Press a pin into a part, slowly, and hold it down."""
    layout = make.layout()
    tool = make.mass(1.1, 0.07)
    rack, seat = layout.place(0.55, -40.0, 0.0), layout.place(0.62, 25.0, -0.05)
    deep_m = 0.0028 * min(make.scale, 2.0)

    def cycle(_: int) -> Iterator[Step]:
        yield layout.to(layout.up(rack), blend_m=0.03)
        yield layout.along(rack)
        yield Wait(GRIP_S)
        yield layout.along(layout.up(rack), blend_m=0.03)
        yield layout.to(layout.up(seat))
        yield layout.along(layout.shifted(seat, z_m=0.01))
        yield layout.along(layout.shifted(seat, z_m=-deep_m), speed_m_s=0.01)
        yield Wait(0.8)
        yield layout.along(layout.up(seat), blend_m=0.03)

    return make.cell(layout, tool, layout.up(rack), cycle, Surface(point_m=seat[:3]))


def _insertion(make: Maker) -> Cell:
    """Push a shaft into a tight bore: friction along the way, both in and out, and an elastic end."""
    layout = make.layout()
    tool = make.mass(1.3, 0.09)
    hole, away = layout.place(0.62, 15.0, 0.0), layout.place(0.55, -35.0, 0.12)
    depth_m = 0.05 * layout.reach_m

    def cycle(_: int) -> Iterator[Step]:
        yield layout.to(layout.up(hole), blend_m=0.02)
        yield layout.along(layout.shifted(hole, z_m=0.01))
        yield layout.along(layout.shifted(hole, z_m=-depth_m), speed_m_s=0.04)
        yield Wait(0.5)
        yield layout.along(layout.shifted(hole, z_m=0.01), speed_m_s=0.04)
        yield layout.along(layout.up(hole), blend_m=0.02)
        yield layout.to(away)
        yield Wait(0.5)

    return make.cell(layout, tool, away, cycle, Bore(mouth_m=hole[:3], friction_n=45.0 * make.scale))


def _polishing(make: Maker) -> Cell:
    """Polish an uneven surface in force control: 25 N on it, to and fro."""
    layout = make.layout(tcp_m=0.2)
    spindle = make.mass(1.8, 0.1)
    corner = layout.place(0.6, -14.0, 0.0)
    long_m = 0.26 * layout.reach_m

    def cycle(_: int) -> Iterator[Step]:
        yield layout.to(layout.up(corner))
        yield layout.along(layout.shifted(corner, z_m=0.004))
        yield ForceMode(Comply((0.0, 0.0, -1.0), 25.0))
        for k in range(4):
            across = 0.03 * k
            ends = (0.0, long_m) if k % 2 == 0 else (long_m, 0.0)
            for y in ends:
                yield layout.along(layout.shifted(corner, x_m=across, y_m=y, z_m=0.004), blend_m=0.01, speed_m_s=0.12)
        yield Wait(0.3)
        yield ForceMode(None)
        yield layout.along(layout.up(corner))
        yield Wait(2.0)

    return make.cell(layout, spindle, layout.up(corner), cycle, Surface(point_m=corner[:3], friction=0.35, wave_m=0.0008))


def _guiding(make: Maker) -> Cell:
    """Between cycles, a person leads the arm by hand in freedrive of the program: no button is held."""
    layout = make.layout()
    tool = make.mass(0.9, 0.06)
    a, b = layout.place(0.6, -30.0, 0.1), layout.place(0.66, 30.0, 0.15, turn=40.0)
    r = layout.reach_m
    ways = ((0.0, 0.25 * r, 0.0), (-0.15 * r, 0.1 * r, 0.12 * r), (0.0, -0.2 * r, 0.0), (0.05 * r, 0.0, 0.08 * r))

    def cycle(_: int) -> Iterator[Step]:
        for _ in range(2):
            yield layout.to(a, blend_m=0.02)
            yield layout.along(layout.up(a), blend_m=0.02)
            yield layout.to(b)
            yield Wait(0.5)
        yield Freedrive(True)
        yield Wait(14.0)
        yield Freedrive(False)
        yield Wait(0.5)

    return make.cell(layout, tool, a, cycle, Hand(ways_m=ways))


def _tool_change(make: Maker) -> Cell:
    """Two tools from a tool changer in turn, each declared."""
    layout = make.layout()
    changer = make.mass(0.3, 0.03)
    tools = {TOOL_A: make.mass(0.9, 0.08), TOOL_B: make.mass(1.9, 0.1)}
    alone = changer.declared(layout.dice)
    declared = {output: changer.with_(tool).declared(layout.dice) for output, tool in tools.items()}
    racks = {TOOL_A: layout.place(0.6, -70.0, 0.05), TOOL_B: layout.place(0.6, -50.0, 0.05)}
    work = [layout.place(0.6 + 0.05 * k, 10.0 + 18.0 * k, 0.06 + 0.04 * k, turn=20.0 * k) for k in range(3)]

    def cycle(n: int) -> Iterator[Step]:
        output = TOOL_A if n % 2 == 0 else TOOL_B
        rack = racks[output]
        yield layout.to(layout.up(rack))
        yield layout.along(rack)
        yield from grip(holds=True, declared=declared[output], output=output)
        yield layout.along(layout.up(rack), blend_m=0.03)
        for _ in range(2):
            for place in work:
                yield layout.to(layout.up(place), blend_m=0.03)
                yield layout.along(place)
                yield Wait(0.2)
                yield layout.along(layout.up(place), blend_m=0.03)
        yield layout.to(layout.up(rack))
        yield layout.along(rack)
        yield from grip(holds=False, declared=alone, output=output)
        yield layout.along(layout.up(rack), blend_m=0.03)

    return make.cell(
        layout, changer, layout.up(work[0]), cycle, *(Grip(output=output, mass=tool) for output, tool in tools.items()), declared=alone
    )


DISTURBED: dict[str, Kind] = {
    "tool-change": Kind("two tools of 0.9 and 1.9 kg in turn, each declared", _tool_change),
    "undeclared-part": Kind("pick-and-place with a part of 1 kg that the program never declares", _undeclared),
    "misdeclared-part": Kind("pick-and-place with parts of 1.5 kg that are declared as 0.5 kg", _misdeclared),
    "pressing": Kind("pins are pressed in slowly and held down", _pressing),
    "insertion": Kind("a shaft goes into a tight bore and out again", _insertion),
    "stuck-part": Kind("pick-and-place in which every second part sticks until it is torn off", _sticking),
    "polishing": Kind("force control presses with 25 N on an uneven surface", _polishing),
    "hand-guiding": Kind("a person leads the arm in freedrive between the cycles", _guiding),
    "leaning": Kind("pick-and-place while somebody leans on a joint now and then", _leaning),
    "protective-stop": Kind("pick-and-place with protective stops that a person acknowledges", _stopping),
}


# --- The cells by their names ---------------------------------------------------------------------------

CELLS = PRODUCTION | DISTURBED


def cell(name: str, robot: Robot, seed: int = 0) -> Cell:
    """A cell by its name for one arm. Raises BadInput for a name that is not in the catalogue, or an arm that it is not made for."""
    if name not in CELLS:
        raise BadInput(f"cell {name!r} is not known; known are {', '.join(CELLS)}")
    if robot.joints != 6:
        raise BadInput(f"cell {name}: the arm has {robot.joints} joints; expected 6")
    kind = CELLS[name]
    return kind.make(Maker(name, kind.about, robot, seed))
