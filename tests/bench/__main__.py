"""Processor time of public functions, which take turns, so that a noisy machine is noisy for all; quotes medians and ratios."""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from monitor.config.files import find_excitation
from monitor.identify.settings import ProductionSettings
from monitor.model.robot import Mounting, load_robot

from .figaroh_fit import Figaroh

ROUNDS = 15


def cases() -> dict[str, Callable[[], object]]:
    """What is timed, by name; a name after `vs` is what its ratio is quoted against."""
    import pinocchio as pin

    from monitor.acquire.safety.torque_band import TorqueBand, learn_profile, recorded_rows
    from monitor.acquire.safety.torque_basis import BandBasis
    from monitor.acquire.settings import Installation, ReplaySettings
    from monitor.identify.fit.jackknife import block_steps
    from monitor.identify.fit.least_squares import Rows, factors
    from monitor.identify.fit.physically_consistent import physically_consistent
    from monitor.identify.identify import identify, identify_motions
    from monitor.identify.production.arm import ProductionArm, ProductionRows
    from monitor.identify.production.estimate import estimate
    from monitor.identify.production.gather import gather
    from monitor.identify.signals.arm import joint_torque
    from monitor.identify.signals.motion import motion
    from monitor.judge.assess import assess
    from monitor.model.base import base_parameters
    from monitor.model.regressor import felt_columns, felt_regressor, regressor
    from monitor.simulate.controller.controller import Controller
    from monitor.simulate.settings import SimulateSettings
    from monitor.simulate.stepped import stepped_replay

    robot, mounting = load_robot("ur5"), Mounting()
    excitation = find_excitation("ur5-ground", Path())
    _, path = excitation.sampled(125.0)
    q, qd, qdd = (signal[:3750] for signal in path)
    model = robot.pinocchio_model(mounting)
    data = model.createData()

    def pinocchio_loop() -> object:
        rows = np.empty((len(q), 6, 60))
        for n in range(len(q)):
            rows[n] = pin.computeJointTorqueRegressor(model, data, q[n], qd[n], qdd[n])
        return rows

    recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), excitation)
    memory = np.empty((3750, 6, 78))
    moved = motion(recording)
    torque = joint_torque(moved, robot)
    fitted = identify_motions([moved], [torque], robot, mounting)
    base = base_parameters(robot, mounting)
    felt = felt_columns(base.columns, robot.joints)
    Y = regressor(robot, mounting, moved.q, moved.qd, moved.qdd)[:, :, list(base.columns)]
    rows = Rows(Y, torque, moved.moving(), block_steps(moved, 0.8), moved.segments)
    factored = factors([rows])
    weights = 1.0 / fitted.rms_nm
    settings = ReplaySettings(host="127.0.0.1")
    model = getattr(assess(recording, robot=robot, mounting=mounting, belief=None, health=None), "model", None)
    learnt = BandBasis(model=None if model is None else model.as_document())
    learnt = replace(learnt, profile=learn_profile([recording], robot, excitation, settings, Installation(), learnt))
    seen = recorded_rows(recording)[:1000]

    def band(basis: BandBasis) -> object:
        guard = TorqueBand(robot, mounting, settings, Installation(), basis)
        return [guard.outside(row, 0.008 * n) for n, row in enumerate(seen)]

    worker = ProductionArm(robot=robot, mounting=mounting, identification=identify([recording], robot, mounting, residual_friction=True))
    twice = {name: np.concatenate([value, value]) for name, value in recording.signals.items() if name != "t_s"}
    production = ProductionRows(recording=replace(recording, t_s=recording.t_s[0] + 0.008 * np.arange(2 * recording.samples), **twice))

    slower = production.part(slice(None, None, 5))
    told = gather(production, worker, ProductionSettings())
    days = {(day, bin_): sums for (_, bin_), sums in told.cells.items() for day in range(7)}
    week = replace(told, cells=days)

    everything = {
        "regressor, 3750 samples": lambda: regressor(robot, mounting, q, qd, qdd),
        "what each joint feels of it, base columns alone": lambda: felt_regressor(robot, mounting, felt, q, qd, qdd, qd),
        "the same by a loop over pinocchio.computeJointTorqueRegressor": pinocchio_loop,
        "touching the memory of 3750 × 6 × 78": lambda: memory.fill(0.0),
        "identify ls, 30 s at 125 Hz": lambda: identify([recording], robot, mounting, method="ls"),
        "identify wls": lambda: identify([recording], robot, mounting, method="wls"),
        "identify robust": lambda: identify([recording], robot, mounting, method="robust"),
        "identify wls, friction auto": lambda: identify([recording], robot, mounting, friction="auto"),
        "physically consistent fit, from factors": lambda: physically_consistent(factored, weights, base.combination, robot),
        "friction from work, 60 s at 125 Hz": lambda: gather(production, worker, ProductionSettings()),
        "friction from work, 60 s at 25 Hz": lambda: gather(slower, worker, ProductionSettings()),
        "a day's judgement of work, beside a week": lambda: estimate(told, worker.identification, ProductionSettings(), 0.0, past=week),
        "torque band, 1000 rows, manufacturer's parameters": lambda: band(BandBasis()),
        "torque band, 1000 rows, model and profile": lambda: band(learnt),
    }
    try:
        other = Figaroh(model)
    except ImportError:
        print("figaroh is not installed: its case is left out (pip install figaroh)")
        return everything
    name = "ls and standard deviations by figaroh, filtered signals to parameters"
    return {**everything, name: lambda: other.fit(moved, torque)}


def show_errors() -> None:
    """The error of both on the motion that was fitted and on one that was not, as a part of the torque."""
    from monitor.identify.identify import identify
    from monitor.identify.signals.arm import joint_torque
    from monitor.identify.signals.motion import motion
    from monitor.identify.validate import predict_motion
    from monitor.simulate.controller.controller import Controller
    from monitor.simulate.settings import SimulateSettings
    from monitor.simulate.stepped import stepped_replay

    robot, mounting = load_robot("ur5"), Mounting()
    excitation = find_excitation("ur5-ground", Path())
    recordings = [
        stepped_replay(Controller(SimulateSettings(robot="ur5", seed=seed)), replace(excitation, time_scale=scale))
        for seed, scale in ((0, 1.0), (1, 0.8))
    ]
    motions = [motion(recording) for recording in recordings]
    measured = [joint_torque(moved, robot) for moved in motions]
    predictions: dict[str, list[np.ndarray]] = {}
    try:
        other = Figaroh(robot.pinocchio_model(mounting))
        fitted = other.fit(motions[0], measured[0])
        predictions["figaroh, ls"] = [other.predict(fitted, moved) for moved in motions]
    except ImportError:
        print("figaroh is not installed: its error is left out (pip install figaroh)")
    for name, options in {
        "identify ls": {"method": "ls"},
        "identify wls": {},
        "identify wls, friction auto": {"friction": "auto"},
        "identify robust, friction auto": {"method": "robust", "friction": "auto"},
    }.items():
        found = identify(recordings[:1], robot, mounting, **options)
        predictions[name] = [predict_motion(found, robot, moved).torque for moved in motions]
    print("\nerror of the predicted torque, RMS over the measured RMS, all joints and samples [%]\n   fitted  held out")
    for name, predicted in predictions.items():
        shares = [100.0 * np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(predicted, measured, strict=True)]
        print(f"{shares[0]:9.3f} {shares[1]:9.3f}  {name}")


def show_bounds() -> None:
    """The stages of `identify wls` beside figaroh."""
    from monitor.simulate.controller.controller import Controller
    from monitor.simulate.settings import SimulateSettings
    from monitor.simulate.stepped import stepped_replay
    from tests.bench import bounds

    robot, mounting = load_robot("ur5"), Mounting()
    recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), find_excitation("ur5-ground", Path()))
    try:
        other = Figaroh(robot.pinocchio_model(mounting)).fit
    except ImportError:
        print("figaroh is not installed: ratios to it are left out (pip install figaroh)")
        other = None
    bounds.show(recording, robot, mounting, other)


def run() -> dict[str, list[float]]:
    """Milliseconds of processor time of each round; the cases take turns."""
    taken: dict[str, list[float]] = {}
    todo = cases()
    for case in todo.values():
        case()  # warm up: caches, lazy imports
    for _ in range(ROUNDS):
        for name, case in todo.items():
            began = time.process_time()
            case()
            taken.setdefault(name, []).append(1000 * (time.process_time() - began))
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
    parser.add_argument("--errors", action="store_true", help="only how well torque is predicted, beside figaroh")
    parser.add_argument("--bounds", action="store_true", help="only what identify wls is made of, and below what it cannot fall")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("A", "B"), help="two saved runs: the ratio of their medians")
    arguments = parser.parse_args()
    if arguments.compare:
        a, b = (json.loads(path.read_text()) for path in arguments.compare)
        for name in a:
            if name in b:
                print(f"{statistics.median(b[name]) / statistics.median(a[name]):6.2f}  {name}")
        return
    if arguments.errors:
        show_errors()
        return
    if arguments.bounds:
        show_bounds()
        return
    taken = run()
    show(taken)
    show_errors()
    if arguments.save:
        arguments.save.write_text(json.dumps(taken))


main()
