"""A production cell around a simulated arm: its program, its things, and the forces that the controller shows at the tool."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.cells.things import Grip, Layout, Mass, Thing, Tool
from monitor.simulate.machine.machine import Machine
from monitor.simulate.program.steps import Declare, Step
from monitor.simulate.settings import SimulateSettings

RUBBING_M_S = 0.03  # slower than this, what rubs on the tool pulls less: a direction that flips at rest would shake the arm
SENSOR_OFFSET_N, SENSOR_NOISE_N = 1.5, 0.4  # of a sensor in the flange: standard deviations of its zero, and of a reading
SENSOR_ARM_M = 0.1  # the same for torques, as if the force had this lever
ESTIMATE_NOISE_N = 2.0  # of a force that is computed from the currents
DAMPING = 1e-3  # of that computation near singularities

Cycle = Callable[[int], Iterator[Step]]  # number of the cycle, from 0 → its steps


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What a cell is made of."""

    name: str
    about: str
    layout: Layout
    tool: Mass  # what the arm carries at all times, and the installation knows
    tool_declared: tuple[float, ...]
    cycle: Cycle
    things: Sequence[Thing] = ()
    home_rad: tuple[float, ...]


def in_cell(settings: SimulateSettings, cell: Cell) -> SimulateSettings:
    """The settings of an arm that stands in this cell with its tool, and publishes what real arms publish."""
    tool = cell.tool
    return replace(settings, payload_kg=tool.kg, payload_com_m=tool.com_m, home_rad=cell.home_rad, personality="recorded")


@dataclass(slots=True, eq=False)
class _Outside:
    """Everything that presses on the arm now."""

    kinematics: Kinematics
    left_s: float = math.inf
    pressing: list[Thing] = field(default_factory=list)

    def force_n(self, at_m: Array) -> Array:
        """(3,) force on the tool's point at a place."""
        force: Array = sum((thing.force_n(at_m) for thing in self.pressing), np.zeros(3))
        return force

    def torque_nm(self, q: Array) -> Array:
        """(J,) torque on the joints at q (J,)."""
        tool = self.kinematics.at(q)
        force = self.force_n(tool.translation.copy())
        torque: Array = self.kinematics.jacobian(q)[:3].T @ force
        for thing in self.pressing:
            torque = torque + thing.torque_nm(len(q))
        return torque


class CellAround:
    """One cell around one arm; the `Surroundings` of its controller."""

    def __init__(self, cell: Cell) -> None:
        """The dice of the sensors are those of the cell's seed."""
        self.cell, self.name = cell, cell.name.replace("-", "_")
        self._grips = [thing for thing in cell.things if isinstance(thing, Grip)]
        self._others = [thing for thing in cell.things if not isinstance(thing, Grip)]
        self._outside = _Outside(cell.layout.kinematics)
        self._dice = np.random.default_rng([cell.layout.seed, 26])
        self._offset = SENSOR_OFFSET_N * self._dice.standard_normal(6) * np.repeat([1.0, SENSOR_ARM_M], 3)
        self._carried: tuple[bool, ...] = ()
        self._before: Array | None = None  # where the tool's point was in the control period before
        self.cycles = 0  # cycles that have begun

    def program(self, machine: Machine) -> Iterator[Step]:  # noqa: ARG002 - the signature of the protocol
        """Tool and payload are declared, then cycle follows cycle without end."""
        yield Declare("set_tcp", (0.0, 0.0, self.cell.layout.tcp_m, 0.0, 0.0, 0.0))
        yield Declare("set_payload", self.cell.tool_declared)
        while True:
            self.cycles += 1
            yield from self.cell.cycle(self.cycles - 1)

    def step(self, machine: Machine) -> None:
        """Grip, press and lead."""
        arm, outside = machine.arm, self._outside
        self._grip(machine)
        if not self._others:
            return
        at_m = self._tool_at(arm.q)
        way = np.zeros(3) if self._before is None else at_m - self._before
        tool = Tool(at_m=at_m, toward=way / max(float(np.linalg.norm(way)), RUBBING_M_S * machine.clock.tick_s))
        self._before = at_m
        outside.pressing = [thing for thing in self._others if thing.step(machine, tool)]
        if outside.pressing:
            arm.contact = outside
        elif arm.contact is outside:
            arm.contact = None
        machine.compliance.external_force_n = outside.force_n(at_m)

    def _tool_at(self, q: Array) -> Array:
        tool = self.cell.layout.kinematics.at(q)
        at_m: Array = tool.translation.copy()
        return at_m

    def _grip(self, machine: Machine) -> None:
        """Carry what the outputs hold."""
        grips = self._grips
        on = tuple(bool(machine.registers.outputs.digital >> grip.output & 1) for grip in grips)
        if on == self._carried:
            return
        self._carried, mass = on, self.cell.tool
        for grip, holds in zip(grips, on, strict=True):
            mass = mass.with_(grip.mass) if holds else mass
        machine.arm.carry(payload_kg=mass.kg, payload_com_m=mass.com_m, declared=False)
        machine.installation.declare()

    def wrench(self, machine: Machine) -> Array:
        """(6,) as `Surroundings` has it: of a sensor in the flange on the e-Series, computed from the currents on a CB3."""
        return self._sensed(machine) if machine.settings.polyscope.major >= 5 else self._estimated(machine)

    def _sensed(self, machine: Machine) -> Array:
        arm, (kg, *_) = machine.arm, machine.installation.payload
        force = self._outside.force_n(self._tool_at(arm.q))
        force = force + (arm.payload_kg - kg) * arm.model.gravity.linear  # of what is carried and not declared; its inertia is not modelled
        noise = SENSOR_NOISE_N * self._dice.standard_normal(6) * np.repeat([1.0, SENSOR_ARM_M], 3)
        result: Array = np.concatenate([force, np.zeros(3)]) + self._offset + noise
        return result

    def _estimated(self, machine: Machine) -> Array:
        """The torque that the currents and the controller's own model do not explain, as a force at the tool: wrong by tens of newtons."""
        arm, reference = machine.arm, machine.reference
        driven = machine.measurements.latest.current * arm.gain_nm_per_a
        friction = machine.personality.target_friction_nm(reference.qd)
        outside = machine.installation.target_moment(reference) + friction - driven
        J = self.cell.layout.kinematics.jacobian(reference.q)
        force = np.linalg.solve(J @ J.T + DAMPING * np.eye(6), J @ outside)
        result: Array = force + ESTIMATE_NOISE_N * self._dice.standard_normal(6) * np.repeat([1.0, SENSOR_ARM_M], 3)
        return result
