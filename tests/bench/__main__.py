"""Times public functions in turn, so that a noisy machine is noisy for all of them; quotes medians and ratios."""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from monitor.config import find_excitation
from monitor.model.robot import Mounting, load_robot

ROUNDS = 15


def cases() -> dict[str, Callable[[], object]]:
    """What is timed, by name; a name after `vs` is what its ratio is quoted against."""
    import pinocchio as pin

    from monitor.identify.solve import identify
    from monitor.model.regressor import regressor
    from monitor.simulate.controller import Controller
    from monitor.simulate.settings import SimulateSettings
    from monitor.simulate.stepped import stepped_replay

    robot, mounting = load_robot("ur5"), Mounting()
    excitation = find_excitation("ur5-ground", Path())
    _, motion = excitation.sampled(125.0)
    q, qd, qdd = (signal[:3750] for signal in motion)
    model = robot.pinocchio_model(mounting)
    data = model.createData()

    def pinocchio_loop() -> object:
        rows = np.empty((len(q), 6, 60))
        for n in range(len(q)):
            rows[n] = pin.computeJointTorqueRegressor(model, data, q[n], qd[n], qdd[n])
        return rows

    recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), excitation)
    memory = np.empty((3750, 6, 78))
    return {
        "regressor, 3750 samples": lambda: regressor(robot, mounting, q, qd, qdd),
        "the same by a loop over pinocchio.computeJointTorqueRegressor": pinocchio_loop,
        "touching the memory of 3750 × 6 × 78": lambda: memory.fill(0.0),
        "identify wls, 30 s at 125 Hz": lambda: identify([recording], robot, mounting, method="wls"),
        "identify ls, 30 s at 125 Hz": lambda: identify([recording], robot, mounting, method="ls"),
    }


def run() -> dict[str, list[float]]:
    """Milliseconds of each round; the cases take turns."""
    taken: dict[str, list[float]] = {}
    todo = cases()
    for case in todo.values():
        case()  # warm up: caches, lazy imports
    for _ in range(ROUNDS):
        for name, case in todo.items():
            began = time.perf_counter()
            case()
            taken.setdefault(name, []).append(1000 * (time.perf_counter() - began))
    return taken


def show(taken: dict[str, list[float]]) -> None:
    """A line a case: minimum, median, maximum, and the ratio to the first."""
    first = statistics.median(next(iter(taken.values())))
    print(f"{'min':>9} {'median':>9} {'max':>9}   ratio  case   [ms, {ROUNDS} rounds]")
    for name, times in taken.items():
        median = statistics.median(times)
        print(f"{min(times):9.2f} {median:9.2f} {max(times):9.2f}  {median / first:6.2f}  {name}")


def main() -> None:
    """Run, or compare two saved runs."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("--save", type=Path, metavar="FILE", help="keep the figures as JSON")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("A", "B"), help="two saved runs: the ratio of their medians")
    arguments = parser.parse_args()
    if arguments.compare:
        a, b = (json.loads(path.read_text()) for path in arguments.compare)
        for name in a:
            if name in b:
                print(f"{statistics.median(b[name]) / statistics.median(a[name]):6.2f}  {name}")
        return
    taken = run()
    show(taken)
    if arguments.save:
        arguments.save.write_text(json.dumps(taken))


main()
