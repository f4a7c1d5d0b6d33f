"""The cells in which something disturbs: contact, loads that nobody declared, force control, people, stops, other tools."""

from collections.abc import Iterator

from monitor.simulate.cells.cell import Cell
from monitor.simulate.cells.making import GRIP_S, GRIPPER, Kind, Maker, grip, handling
from monitor.simulate.cells.things import Bore, Grip, Hand, Leaning, Sticking, Stopping, Surface
from monitor.simulate.controller.giving import Comply
from monitor.simulate.controller.program.steps import Freedrive, GiveWay, Step, Wait

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
        yield GiveWay(Comply((0.0, 0.0, -1.0), 25.0))
        for k in range(4):
            across = 0.03 * k
            ends = (0.0, long_m) if k % 2 == 0 else (long_m, 0.0)
            for y in ends:
                yield layout.along(layout.shifted(corner, x_m=across, y_m=y, z_m=0.004), blend_m=0.01, speed_m_s=0.12)
        yield Wait(0.3)
        yield GiveWay(None)
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
