"""What the time of an identification is made of, and below what it cannot fall with the operations that it is made of.

Processor time, stages in turns. A stage is measured by itself, on what the stages before it made. The bound of the regressor is its last
step alone, three products for each of its numbers; the bound of least squares is one pass of each operation that no arrangement avoids.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from monitor.identify.detectors import warnings_of
from monitor.identify.diagnosis import Fitted
from monitor.identify.fit.covariance import Causes, covariances
from monitor.identify.fit.fit import FitProblem, first_fit, problem_of
from monitor.identify.identify import identify
from monitor.identify.settings import IdentifySettings
from monitor.identify.signals.arm import joint_torque
from monitor.identify.signals.filters import low_pass
from monitor.identify.signals.motion import motion
from monitor.identify.signals.ripple import gear_ripple
from monitor.model.base import base_parameters
from monitor.model.regressor import felt_columns, felt_regressor
from monitor.model.robot import Mounting, Robot
from monitor.recording import Recording

ROUNDS = 25


def cases(recording: Recording, robot: Robot, mounting: Mounting) -> dict[str, Callable[[], object]]:
    """What is timed, by name. The stages are those of `identify wls`."""
    moved, base, settings = motion(recording), base_parameters(robot, mounting), IdentifySettings()
    torque, felt = joint_torque(moved, robot), felt_columns(base.columns, robot.joints)

    def problem() -> FitProblem:
        return problem_of([moved], [torque], robot, mounting, base, settings)

    equations = problem()
    fitted = first_fit(equations, "wls")
    causes = Causes(equations, fitted, equations.redundancy)

    def told() -> object:
        return warnings_of(
            Fitted(
                problem=equations,
                found=fitted,
                causes=causes,
                robot=robot,
                mounting=mounting,
                base=base,
                moving=[moved.moving()],
                friction=fitted.solution.values[equations.layout.friction],
                relative_rms=np.zeros(robot.joints),
                residual_ratio=None,
            )
        )

    N, sizes = moved.samples, [len(own) for own in felt.places]
    memory = np.empty(N * sum(sizes))
    blocks = [np.asfortranarray(np.column_stack([block, moved.qd[:, 0]])) for block in equations.equations[0].Y.at(slice(0, N))]
    signals, smooth = np.concatenate([moved.q, moved.qd, torque, moved.direction], axis=1), low_pass(moved.rate_hz, 2, 8.0)
    angle = np.ascontiguousarray(moved.q.T)
    links = [np.random.default_rng(0).normal(size=(3, max(i + 1, len(kinds)), N)) for i, kinds in enumerate(felt.kinds)]
    products = [np.empty((i + 1, len(kinds), N)) for i, kinds in enumerate(felt.kinds)]

    def last_step() -> None:
        for i, (vectors, into) in enumerate(zip(links, products, strict=True)):
            np.einsum("cin,ckn->ikn", vectors[:, : i + 1], vectors[:, : into.shape[1]], out=into)

    return {
        "touching what the joints feel of the base columns": lambda: memory.fill(0.0),
        "the last step of computing them alone": last_step,
        "computing them": lambda: felt_regressor(robot, mounting, felt, moved.q, moved.qd, moved.qdd, moved.direction),
        "bound: sines and cosines": lambda: (np.sin(angle), np.cos(angle)),
        "bound: one QR of each joint's rows": lambda: [scipy.linalg.lapack.dgeqrt(8, block) for block in blocks],
        "bound: one pass of the filter": lambda: smooth(signals),
        "stage: signals, from the recording": lambda: motion(recording),
        "stage: rows": problem,
        "stage: least squares": lambda: first_fit(equations, "wls"),
        "stage: causes beside the law": lambda: Causes(equations, fitted, equations.redundancy),
        "stage: covariances of correlated residuals": lambda: covariances(equations, fitted, causes),
        "stage: warnings of the fit": told,
        "stage: gear ripple": lambda: gear_ripple(moved.unfiltered, robot.gear_ratio, moved.rate_hz),
        "identify wls": lambda: identify([recording], robot, mounting),
    }


def show(recording: Recording, robot: Robot, mounting: Mounting, other: Callable[[Any, Any], object] | None) -> None:
    """Print medians, and their ratio to `other`, which fits a motion and its torque by plain least squares; None where it is not there."""
    todo = cases(recording, robot, mounting)
    if other is not None:
        moved = motion(recording)
        torque = joint_torque(moved, robot)
        todo["figaroh"] = lambda: other(moved, torque)
    taken: dict[str, list[float]] = {name: [] for name in todo}
    for case in todo.values():
        case()
    for _ in range(ROUNDS):
        for name, case in todo.items():
            began = time.process_time()
            case()
            taken[name].append(1000 * (time.process_time() - began))
    show_taken(taken)


def show_taken(taken: dict[str, list[float]]) -> None:
    """Print of each case its times [ms], and their ratio to touching the memory and to figaroh: a dash where that is absent."""
    medians = {name: statistics.median(times) for name, times in taken.items()}
    touching, whole = next(iter(medians.values())), medians.get("figaroh")
    print(f"{'min':>9} {'median':>9}  × touching  × figaroh  what   [ms, {ROUNDS} rounds]")
    for name, median in medians.items():
        beside = "–" if whole is None else f"{median / whole:.3f}"
        print(f"{min(taken[name]):9.2f} {median:9.2f}  {median / touching:10.1f}  {beside:>9}  {name}")
    print(f"{medians['computing them'] / touching:.1f} × touching for the regressor, of which its last step alone is", end=" ")
    print(f"{medians['the last step of computing them alone'] / touching:.1f} ×")
    for kind, text in (("bound: ", "one pass of each operation that no least squares avoids"), ("stage: ", "the stages above")):
        total = sum(median for name, median in medians.items() if name.startswith(kind))
        total += medians["the last step of computing them alone"] if kind == "bound: " else 0.0
        share = "" if whole is None else f", {total / whole:.3f} of figaroh"
        print(f"{total:.1f} ms{share}: {text}")
