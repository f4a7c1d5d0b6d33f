"""The cells of production."""

import math
from collections.abc import Iterator

from monitor.simulate.cells.cell import Cell
from monitor.simulate.cells.layout import Pace
from monitor.simulate.cells.making import GRIPPER, Kind, Maker, grip, handling
from monitor.simulate.cells.things import Grip
from monitor.simulate.controller.program.steps import Step, Wait


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
