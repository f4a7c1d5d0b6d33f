"""What a search reaches in a given time: `python -m tests.bench.design [--seconds 60] [--seed 1]`, UR5, one process.

CMA-ES beside the paper's GA (population 300) on the condition number, both from the same code of cost and constraints; the optimum on
the ceiling beside the ground's; the friction objective's expected variances beside those of the condition number's optimum.
"""

import argparse
import time

import numpy as np

from monitor.design.optimise import Progress, optimise
from monitor.design.trajectory import Task, problem_of
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, load_robot

NO_BUDGET = 10**9


def searched(objective: str, optimiser: str, mounting: str, seed: int, seconds: float) -> tuple[Excitation, int]:
    """The best curve after so many seconds of this process's own time, and how many evaluations they held."""
    problem = problem_of(Task(robot=load_robot("ur5"), mounting=Mounting.parse(mounting), objective=objective))
    began = time.process_time()

    def in_time(_: Progress) -> bool:
        return time.process_time() - began < seconds

    found = optimise(problem, evaluations=NO_BUDGET, seed=seed, optimiser=optimiser, on_progress=in_time)
    return problem.family.excitation(found.u), found.evaluations


def main() -> None:
    """Run and print the figures of issue 4."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.design", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of processor time for each search")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    robot = load_robot("ur5")
    cases = {
        "condition, CMA-ES, ground": ("condition", "cma", "ground"),
        "condition, GA 300, ground": ("condition", "ga", "ground"),
        "condition, CMA-ES, ceiling": ("condition", "cma", "ceiling"),
        "friction, CMA-ES, ground": ("friction", "cma", "ground"),
    }
    condition, viscous = {}, {}
    print(f"UR5, {arguments.seconds:g} s of processor time each, seed {arguments.seed}")
    for name, (objective, optimiser, mounting) in cases.items():
        excitation, evaluations = searched(objective, optimiser, mounting, arguments.seed, arguments.seconds)
        information = problem_of(Task(robot=robot, mounting=Mounting.parse(mounting))).information
        merits = information.merits(excitation)
        condition[name], viscous[name] = merits.condition, information.friction_std(excitation)[1]
        print(
            f"{name:28} {evaluations:6} evaluations  condition {merits.condition:6.1f}  log det friction {merits.friction:7.2f}", flush=True
        )
    ground, ga, ceiling, friction = cases
    print(f"condition number, CMA-ES / GA at equal time: {condition[ground] / condition[ga]:.2f} (at most 0.75 is asked)")
    print(f"condition number, ceiling / ground: {condition[ceiling] / condition[ground]:.2f} (the paper: about half)")
    ratio = (viscous[friction] / viscous[ground]) ** 2
    print(
        f"variance of fv, friction / condition objective: {np.round(ratio, 2).tolist()}, mean {np.mean(ratio):.2f} (at most 0.6 is asked)"
    )


if __name__ == "__main__":
    main()
