"""Recordings of production faster than real time: a cell's program on the same controller, servo, physics and sensors as on the wire.

A row is what a client of RTDE would have received: the newest values of a control period, without a mean over the periods between.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from monitor.errors import BadInput
from monitor.recording import Array, Context
from monitor.simulate.arm.friction import FrictionLaw
from monitor.simulate.cells.catalogue import cell
from monitor.simulate.cells.cell import Cell, CellAround, in_cell
from monitor.simulate.controller.controller import Controller
from monitor.simulate.scenario import Room, Scenario
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire.packing import reader
from monitor.simulate.wire.variables import output_variables

RATES_HZ = (1.0, 125.0)  # least and most rows a second
SPEEDS = (0.05, 1.0)  # least and most of the speed slider
HOURS_MAX, DAYS_MAX = 23.9, 366
WEAR = (0.1, 10.0)  # least and most multiple of the usual friction
NIGHT_S = 20.0  # of standing still that a recording shows before the controller is left alone for the night
MONDAY_UNIX_S, BEGINS_S = 1_767_571_200.0, 5.0 * 3600.0  # the first shift begins at 5:00 UTC on Monday, 5 January 2026

PER_JOINT = (
    *("actual_q", "actual_qd", "actual_current", "joint_temperatures"),
    *("target_q", "target_qd", "target_qdd", "target_current", "target_moment"),
)
WRENCH, CENTRE = "actual_TCP_force", "payload_cog"  # of 6 and of 3 columns
SCALARS = (
    *("timestamp", "payload", "robot_mode", "safety_mode", "runtime_state", "speed_scaling", "target_speed_fraction"),
    *("robot_status_bits", "actual_digital_output_bits"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductionSettings:
    """What is recorded: a cell of the catalogue, on one arm, at one speed, for some hours of each day."""

    cell: str
    robot: str = "ur5"
    seed: int = 0  # of the cell's places, of declared masses, and of the noise
    hours: float = 1.0  # of each shift
    days: int = 1  # shifts, one a day
    speed: float = 1.0  # of the slider, 0 … 1
    rate_hz: float = 25.0
    run_in: float = 0.0  # what the friction of the joints has more after rest, as a share
    room: Room = field(default_factory=lambda: Room(mean_c=22.0, daily_swing_k=2.0))

    def __post_init__(self) -> None:
        """Check the fields. Raises BadInput with the field, its value and what is expected."""
        if not 0.0 < self.hours <= HOURS_MAX:
            raise BadInput(f"work: hours = {self.hours:g}; expected more than 0, and {HOURS_MAX:g} at most")
        if not 1 <= self.days <= DAYS_MAX:
            raise BadInput(f"work: days = {self.days}; expected 1 … {DAYS_MAX}")
        if not SPEEDS[0] <= self.speed <= SPEEDS[1]:
            raise BadInput(f"work: speed = {100 * self.speed:g} %; expected {100 * SPEEDS[0]:g} … {100 * SPEEDS[1]:g} %")
        if not RATES_HZ[0] <= self.rate_hz <= RATES_HZ[1]:
            raise BadInput(f"work: rate = {self.rate_hz:g} Hz; expected {RATES_HZ[0]:g} … {RATES_HZ[1]:g} Hz")
        if self.seed < 0:
            raise BadInput(f"work: seed = {self.seed}; expected 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionRecording:
    """Production as it was recorded."""

    columns: dict[str, Array]  # (N,) each, by RTDE's names; those of a joint end in its index, `actual_q_0` … `actual_q_5`
    context: Context
    cycles: int
    stops: tuple[str, ...]  # reasons of protective stops

    @property
    def rows(self) -> int:
        """N."""
        return len(self.columns["timestamp"])


def arm_in_cell(
    production: ProductionSettings, law: FrictionLaw | None = None, wear: Sequence[float] | None = None, made: Cell | None = None
) -> tuple[Controller, CellAround]:
    """The controller of an arm that stands in its cell, and the cell.

    law : the friction of the arm; None means that of its model. wear : (J,) multiples of its friction. Raises BadInput for wrong ones.
    made : the cell; None makes the one that `work` names.
    """
    settings = SimulateSettings(robot=production.robot, run_in=production.run_in)
    around = CellAround(made or cell(production.cell, settings.arm, production.seed))
    scenario = Scenario(name=production.cell, about=around.cell.about, started_s=BEGINS_S, room=production.room)
    controller = Controller(in_cell(replace(settings, seed=production.seed, scenario=scenario), around.cell), law=law, surroundings=around)
    if wear is not None:
        if len(wear) != settings.arm.joints or not all(WEAR[0] <= factor <= WEAR[1] for factor in wear):
            raise BadInput(f"work: wear = {list(wear)}; expected {settings.arm.joints} numbers, each {WEAR[0]:g} … {WEAR[1]:g}")
        for joint, factor in enumerate(wear):
            controller.arm.set_wear(joint, coulomb=factor, viscous=factor)
    controller.inject("speed_slider", {"fraction": production.speed})
    return controller, around


def record(
    production: ProductionSettings,
    arm: tuple[Controller, CellAround] | None = None,
    *,
    progress: Callable[[float], None] = lambda _: None,
) -> ProductionRecording:
    """Play the shifts and record them.

    arm : the controller in its cell, as `arm_in_cell` makes it and as an earlier recording left it; None makes a new one.
    progress : receives the share that is done, 0 … 1, about once for each second of work.
    """
    controller, around = arm or arm_in_cell(production)
    ticks = max(1, round(1.0 / production.rate_hz / controller.clock.tick_s))
    row_s = ticks * controller.clock.tick_s
    began_s, first_cycle = controller.clock.now_s, around.cycles
    stops_before = len(controller.journal.stops)
    variables = output_variables(controller)
    read = reader(controller, [variables[name] for name in (*SCALARS, *PER_JOINT, WRENCH, CENTRE)])
    rows: list[tuple[float, ...]] = []

    def sample() -> None:
        """Let some control periods pass, and take what RTDE publishes after them."""
        for _ in range(ticks):
            controller.step()
        rows.append(read())

    for day in range(production.days):
        if not controller.programs.play():
            raise BadInput(f"work: the program cannot start: {controller.modes.obstacle or 'another one runs'}")
        count = round(3600.0 * production.hours / row_s)
        for i in range(count):
            sample()
            if i % max(1, round(1.0 / row_s)) == 0:
                progress((day + i / count) / production.days)
        if day + 1 < production.days:
            controller.stop_program("the shift is over", kind="program_end")
            for _ in range(round(NIGHT_S / row_s)):
                sample()
            night_s = began_s + 86_400.0 * (day + 1) - controller.clock.now_s
            controller.pass_time(max(night_s, 0.0) / 3600.0, duty=0.0)
    controller.stop_program("the recording is over", kind="program_end")
    settings, stops = controller.settings, list(controller.journal.stops)[stops_before:]
    context = Context(
        robot=settings.robot,
        serial=settings.serial,
        firmware=".".join(map(str, settings.polyscope)),
        mounting_rad=settings.mounting.angles_rad,
        recorded_at_unix_s=MONDAY_UNIX_S + BEGINS_S + began_s,
        note=f"work of the simulator: {production.cell} at {100 * production.speed:g} %",
    )
    return ProductionRecording(
        columns=dict(zip(column_names(controller.robot.joints), np.array(rows, dtype=float).T, strict=True)),
        context=context,
        cycles=around.cycles - first_cycle,
        stops=tuple(stop.reason for stop in stops if stop.kind == "protective_stop"),
    )


def column_names(joints: int) -> list[str]:
    """The names of the columns in their order."""
    each = [f"{name}_{j}" for name in PER_JOINT for j in range(joints)]
    return [*SCALARS, *each, *(f"{WRENCH}_{k}" for k in range(6)), *(f"{CENTRE}_{k}" for k in range(3))]
