"""Small tasks that the tests share."""

from functools import lru_cache

import numpy as np

from monitor.design.problem import Problem
from monitor.design.trajectory import Task, problem_of
from monitor.model.robot import Mounting, load_robot


def task(robot: str = "ur5", mounting: str = "ground", **changes: object) -> Task:
    """The defaults of the command."""
    return Task(robot=load_robot(robot), mounting=Mounting.parse(mounting), **changes)


@lru_cache
def problem(robot: str = "ur5", mounting: str = "ground", objective: str = "friction") -> Problem:
    """The regressor's base parameters, computed once."""
    return problem_of(task(robot, mounting, objective=objective))


def pose(*angles: float) -> np.ndarray:
    """(6,) rad."""
    return np.array(angles, dtype=float)
