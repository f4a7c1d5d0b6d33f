"""From a task to a trajectory file: search, scale, prove, report. The command `design` calls this."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from monitor.design.cell import Cell, plain_cell
from monitor.design.clearance import surroundings
from monitor.design.curve import Family, Limits
from monitor.design.objective import information
from monitor.design.optimise import Progress, SearchResult, optimise, random_curve
from monitor.design.problem import Problem
from monitor.design.proof import prove
from monitor.errors import BadInput
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array

PAPER_OFFSET_RAD = (0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0)  # upright: Raviola et al. (2021), section 2.3
HOME_RAD = (0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0)  # the pose of a UR after its first start


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """What is designed."""

    robot: Robot
    mounting: Mounting
    cell: Cell | None = None  # None: the plain cell of the mounting
    objective: str = "friction"
    harmonics: int = 5
    period_s: float = 10.0
    repetitions: int = 3
    offset_rad: Array | None = None  # (J,) None: the paper's
    start_rad: Array | None = None  # (J,) start and end of the curve, instead of an offset
    approaches_rad: tuple[Array, ...] = ()  # (J,) poses from which the approach to the start must be free
    speed_limit_rad_s: float | None = None  # None: the robot's own; a given one counts where it is stricter
    acceleration_limit_rad_s2: float | None = None
    flange_speed_limit_m_s: float | None = None
    torque_share: float = 0.9  # fraction of the robot's torque limit that may be used
    noise_nm: Array | None = None  # (J,) torque noise; None: a fraction of the torque limit
    parameters: Array | None = None  # (13·J,) of the present model; None: the manufacturer's masses and a nominal friction


def design(
    task: Task,
    *,
    software: str,
    seed: int = 0,
    evaluations: int = 4000,
    optimiser: str = "cma",
    random: bool = False,
    on_progress: Callable[[Progress], bool] | None = None,
) -> tuple[Excitation, SearchResult]:
    """A trajectory with its cell, proof and figures of merit, and the result of the search. With `random`, a validation trajectory.

    The same arguments give the same trajectory. on_progress : as for `optimise`. Raises BadInput for a task that is wrong, Infeasible where
    no curve keeps the limits.
    """
    problem = problem_of(task)
    if random:
        found = random_curve(problem, seed)
        how = f"pseudo-random, seed {seed}"
    else:
        found = optimise(problem, evaluations=evaluations, seed=seed, optimiser=optimiser, on_progress=on_progress)
        ended = f" of {evaluations}, stopped" if found.stopped else ""
        how = f"{optimiser}, objective {task.objective}, seed {seed}, {found.evaluations} evaluations{ended}"
    return finished(problem, found, task.repetitions, f"{software} design: {how}", software), found


def problem_of(task: Task) -> Problem:
    """The search problem of a task.

    Raises BadInput and Infeasible as `design`.
    """
    robot, mounting = task.robot, task.mounting
    if task.repetitions < 1:
        raise BadInput(f"repetitions = {task.repetitions}; expected 1 or more")
    if task.offset_rad is not None and task.start_rad is not None:
        raise BadInput("an offset and a start were given: the start fixes the offset; give one of them")
    around = surroundings(robot, mounting, task.cell or plain_cell(mounting))
    middle = next(pose for pose in (task.start_rad, task.offset_rad, np.array(PAPER_OFFSET_RAD)) if pose is not None)
    limits = Limits.of(
        robot,
        speed_rad_s=task.speed_limit_rad_s,
        acceleration_rad_s2=task.acceleration_limit_rad_s2,
        torque_share=task.torque_share,
        flange_speed_m_s=task.flange_speed_limit_m_s,
    )
    family = Family(
        robot=robot,
        mounting=mounting,
        limits=limits,
        harmonics=task.harmonics,
        period_s=task.period_s,
        offset_rad=middle,
        starts_there=task.start_rad is not None,
    )
    merits = information(robot, mounting, noise_nm=task.noise_nm, parameters=task.parameters)
    home = np.array(HOME_RAD)
    rest = task.approaches_rad
    if not rest and around.line(home, home).keeps(around.cell):  # no pose of rest was given: the one after the first start
        rest = (home,)
    for pose in rest:
        near = around.line(pose, pose).short_of(around.cell)
        if near is not None:
            raise BadInput(f"standing at {np.round(pose, 4).tolist()} rad, from where it was to approach, {near}")
    return Problem(family=family, surroundings=around, information=merits, objective=task.objective, rest_rad=rest)


def finished(problem: Problem, found: SearchResult, repetitions: int, source: str, software: str) -> Excitation:
    """The trajectory of the search's result, with a proof that is computed anew.

    Raises Infeasible where a limit is broken.
    """
    excitation = problem.family.excitation(found.u, repetitions=repetitions)
    around, merits = problem.surroundings, problem.information
    return replace(
        excitation,
        source=source,
        cell={**around.cell.as_document(), "digest": around.cell.digest},
        proof=prove(excitation, around, problem.family.limits, merits, problem.approaches_rad, software),
        objectives=merits.document(excitation),
    )
