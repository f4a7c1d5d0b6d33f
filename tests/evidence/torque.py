"""How well torque is predicted at another temperature: the compensated model against the noise-free torque of the full simulator.

An arm is replayed at many temperatures. Then it moves at other temperatures inside the learned range. The torque of these tests is
predicted once with the joints' temperatures and once without, and both predictions are compared with the torque of the simulated drives
without noise. The same replays show whether the surrogate of the simulated fleet has the distribution of the full simulator.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from monitor.errors import BadInput
from monitor.judge.assess import assess
from monitor.judge.assessment import Assessment
from monitor.judge.friction.observation import observe
from monitor.judge.settings import AssessSettings
from monitor.judge.torque.model import CompensatedModel
from monitor.judge.torque.predictor import predict_torque
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, Robot, load_robot
from monitor.recording import DAY_S, Array, Recording
from monitor.simulate.arm.friction import default_law
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.studies.figures import NINETY, SLIDING_RAD_S, over_arms
from monitor.studies.rehearsal.fleet import WITHIN_SHARE, various

START_UNIX_S = 1_750_000_000.0
ROOM_C = (4.0, 34.0)  # temperatures of the room; the joints are some kelvins warmer, at rest and at work
COLDEST_C, WARMEST_C = 5.0, 45.0  # a joint outside these temperatures does not count in a test
SURROGATE_DRAWS = 200_000  # draws of the surrogate that the full simulator is compared with
MIN_TESTS = 6  # a joint with fewer tests has no slope


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueErrors:
    """Prediction errors of one arm, over the moving samples of its tests inside the learned range."""

    squares_nm2: Array  # (2, J) mean squared error with the joints' temperatures, and without
    friction_error_nm: Array  # (2, tests, J) mean error in the direction of motion, which is that of friction alone; NaN outside
    slope_per_k: Array  # (J,) slope of that error with temperatures, as a fraction of predicted friction, against temperature
    law_residual: Array  # (replays, J) logarithm of identified friction at the reference speed over that of the simulator's law
    grease_c: Array  # (replays, J) temperature of the grease during the replays
    covered: Array  # (J,) share of samples whose 90 % interval contains the true torque
    range_c: tuple[float, float]  # coldest and warmest joint in the tests, of those that count
    assess_s: float  # longest time that the assessment of one replay took

    @property
    def ratio(self) -> float:
        """RMS error with temperatures over the RMS error without."""
        return _ratio(self.squares_nm2[None])


class _Learnt(NamedTuple):
    """What the replays of one arm taught."""

    model: CompensatedModel
    law_residual: Array  # as in `TorqueErrors`
    grease_c: Array
    assess_s: float


class _Test(NamedTuple):
    """One test of one arm, (J,) each unless said otherwise."""

    temperature_c: Array  # mean over the test; NaN where the joint does not count
    squares_nm2: Array  # (2, J) sums over the samples that count, with temperatures and without
    friction_error_nm: Array  # (2, J) mean error in the direction of motion
    friction_nm: Array  # mean magnitude of predicted friction
    covered: Array  # number of samples whose 90 % interval contains the true torque
    samples: Array  # number of samples that count


def study_arm(
    seed: int,
    *,
    excitation: Excitation,
    settings: AssessSettings,
    replays: int,
    tests: int,
    clock: Callable[[], float],
    robot: str = "ur5",
) -> TorqueErrors:
    """The errors of one simulated arm that learns from `replays`, one a day, and is tested in `tests` further motions.

    clock : [s], measures the assessments. Raises BadInput where a replay is rejected, or a joint does not count in any test.
    """
    arm, rng = load_robot(robot), np.random.default_rng(seed)
    law = various(default_law(arm), (), rng)
    noisy, quiet = (Controller(SimulateSettings(robot=robot, seed=seed, current_noise=noise), law=law) for noise in (1.0, 0.0))
    learnt = _learn(noisy, arm, rng, excitation=excitation, settings=settings, replays=replays, clock=clock)
    tested = [_test(quiet, arm, rng, learnt.model, excitation) for _ in range(tests)]
    samples = sum((test.samples for test in tested), np.zeros(arm.joints))
    if not samples.all():
        raise BadInput(
            f"torque study: joint {int(np.argmin(samples)) + 1} was in no test as warm as learnt; expected more replays or tests"
        )
    temperature_c, friction_nm = (np.stack([getattr(test, name) for test in tested]) for name in ("temperature_c", "friction_nm"))
    friction_error_nm = np.stack([test.friction_error_nm for test in tested], axis=1)  # (2, tests, J)
    return TorqueErrors(
        squares_nm2=sum((test.squares_nm2 for test in tested), np.zeros((2, arm.joints))) / samples,
        friction_error_nm=friction_error_nm,
        slope_per_k=_slope(temperature_c, friction_error_nm[0] / friction_nm),
        law_residual=learnt.law_residual,
        grease_c=learnt.grease_c,
        covered=sum((test.covered for test in tested), np.zeros(arm.joints)) / samples,
        range_c=(float(np.nanmin(temperature_c)), float(np.nanmax(temperature_c))),
        assess_s=learnt.assess_s,
    )


def judged(recording: Recording, arm: Robot, last: Assessment | None, settings: AssessSettings) -> Assessment:
    """The verdict that follows the last one. Raises BadInput where the replay is rejected."""
    outcome = assess(
        recording,
        robot=arm,
        mounting=Mounting(),
        belief=last.belief if last else None,
        health=last.health if last else None,
        settings=settings,
        model=last.model if last else None,
    )
    if not isinstance(outcome, Assessment):
        raise BadInput(f"a simulated replay was rejected: {outcome.reason}")
    return outcome


def _learn(
    controller: Controller,
    arm: Robot,
    rng: np.random.Generator,
    *,
    excitation: Excitation,
    settings: AssessSettings,
    replays: int,
    clock: Callable[[], float],
) -> _Learnt:
    """The model after so many replays, one a day, each after a night and a morning at random temperatures."""
    last: Assessment | None = None
    slowest_s = 0.0
    residual, grease = np.empty((replays, arm.joints)), np.empty((replays, arm.joints))
    for day in range(replays):
        _live(controller, rng)
        before = controller.arm.temperatures.grease_c.copy()
        recording = stepped_replay(controller, excitation)
        recording = replace(recording, context=replace(recording.context, recorded_at_unix_s=START_UNIX_S + day * DAY_S))
        began = clock()
        last = judged(recording, arm, last, settings)
        slowest_s = max(slowest_s, clock() - began if day else 0.0)  # the first assessment imports and compiles what all of them use
        grease[day] = 0.5 * (before + controller.arm.temperatures.grease_c)
        by_law = _friction_by_law(controller, recording, grease[day], settings)
        residual[day] = observe(last.identification, settings.drift).log_torque - np.log(by_law)
    if last is None:
        raise BadInput("torque study: no replay; expected one or more")
    return _Learnt(last.model, residual, grease, slowest_s)


def _test(controller: Controller, arm: Robot, rng: np.random.Generator, model: CompensatedModel, excitation: Excitation) -> _Test:
    """One motion without noise at another temperature, against the prediction of the model."""
    _live(controller, rng)
    recording = stepped_replay(controller, excitation)
    T, q, qd, qdd = recording.mean_temperature_c, recording.target_q, recording.target_qd, recording.target_qdd
    if T is None or q is None or qd is None or qdd is None or recording.current is None:
        raise BadInput("torque study: the simulated recording lacks its targets, currents or temperatures")
    inside = model.viscous.inside(T) & (T >= COLDEST_C) & (T <= WARMEST_C)
    moving = (np.abs(qd) > SLIDING_RAD_S) & inside
    n = np.where(inside, moving.sum(axis=0), np.nan)
    with_T, without = (predict_torque(model, arm, q, qd, qdd, t) for t in (T, None))
    truth = recording.current * np.array(arm.drive_gain_nm_per_a)
    errors = np.stack([np.where(moving, predicted.torque - truth, 0.0) for predicted in (with_T, without)])  # (2, N, J)
    return _Test(
        temperature_c=np.where(inside, T, np.nan),
        squares_nm2=np.sum(errors**2, axis=1),
        friction_error_nm=np.sum(errors * np.sign(qd), axis=1) / n,
        friction_nm=np.sum(np.where(moving, np.abs(with_T.friction), 0.0), axis=0) / n,
        covered=np.sum(moving & (np.abs(errors[0]) < NINETY * with_T.std), axis=0),
        samples=moving.sum(axis=0),
    )


def surrogate(arms: Sequence[TorqueErrors], within_std: float) -> dict[str, Any]:
    """Whether the error that identification adds to the friction law has the distribution of the fleet's surrogate, plain JSON.

    within_std : standard deviation of the surrogate. The constant error of an arm (the paper's law is a line through a concave law)
    causes no drift and is subtracted. The rest of each joint, all arms together, is compared with the surrogate by the test of
    Kolmogorov and Smirnov after both are scaled to 1; the scales and the slope against temperature are given beside it.
    """
    residual, grease = np.stack([arm.law_residual for arm in arms]), np.stack([arm.grease_c for arm in arms])  # (A, R, J)
    A, R, J = residual.shape
    away, warmer = residual - residual.mean(axis=1, keepdims=True), grease - grease.mean(axis=1, keepdims=True)
    slopes = np.sum(away * warmer, axis=(0, 1)) / np.sum(warmer**2, axis=(0, 1))  # (J,)
    std = np.sqrt(np.sum(away**2, axis=(0, 1)) / (A * (R - 1)))  # (J,)
    rng = np.random.default_rng(0)
    drawn = rng.uniform(*WITHIN_SHARE, SURROGATE_DRAWS) * rng.normal(size=SURROGATE_DRAWS)
    tests = [scipy.stats.ks_2samp((away[:, :, j] / std[j]).ravel(), drawn / drawn.std()) for j in range(J)]
    return {
        "replays": A * R,
        "std": std.tolist(),
        "surrogate_std": within_std * float(drawn.std()),
        "distance": max(float(test.statistic) for test in tests),
        "p": min(1.0, J * min(float(test.pvalue) for test in tests)),  # of the worst of J joints, by Bonferroni
        "slope_per_k": float(np.max(np.abs(slopes))),
    }


def summary(arms: Sequence[TorqueErrors], *, replays: int, tests: int) -> dict[str, Any]:
    """The errors of all arms together, plain JSON; bounds are one-sided, 95 %."""
    squares = np.stack([arm.squares_nm2 for arm in arms])  # (A, 2, J)
    friction = np.stack([np.nanmean(arm.friction_error_nm**2, axis=1) for arm in arms])  # (A, 2, J)
    slopes, covered = np.abs([arm.slope_per_k for arm in arms]), np.stack([arm.covered for arm in arms])  # (A, J) each
    mean = squares.mean(axis=0)
    return {
        "arms": len(arms),
        "ratio": over_arms(_ratio, squares)._asdict(),
        "ratio_by_joint": np.sqrt(mean[0] / mean[1]).tolist(),
        "ratio_of_worst_arm": max(arm.ratio for arm in arms),
        "ratio_of_friction": over_arms(_ratio, friction)._asdict(),
        "slope_per_k": {**over_arms(np.nanmean, slopes)._asdict(), "nine_of_ten": float(np.nanquantile(slopes, 0.9))},
        "covered_90": over_arms(np.mean, covered)._asdict(),
        "covered_90_by_joint": covered.mean(axis=0).tolist(),
        "range_c": [min(arm.range_c[0] for arm in arms), max(arm.range_c[1] for arm in arms)],
        "assess_s": max(arm.assess_s for arm in arms),
        "replays": replays,
        "tests": tests,
    }


def _ratio(squares_nm2: Array) -> float:
    """RMS with temperatures over RMS without, all arms and joints together, from mean squares (A, 2, J)."""
    with_T, without = squares_nm2.sum(axis=(0, 2))
    return float(np.sqrt(with_T / without))


def _slope(x: Array, y: Array) -> Array:
    """(J,) slope of y against x, (n, J) each, over the values that are finite in both; NaN for fewer than `MIN_TESTS` values."""
    known = np.isfinite(x) & np.isfinite(y)
    n = np.maximum(known.sum(axis=0), 1)
    x, y = np.where(known, x, 0.0), np.where(known, y, 0.0)
    away = np.where(known, x - x.sum(axis=0) / n, 0.0)
    slope: Array = np.sum(away * y, axis=0) / np.maximum(np.sum(away**2, axis=0), 1e-12)
    return np.where(n >= MIN_TESTS, slope, np.nan)


def _friction_by_law(controller: Controller, recording: Recording, grease_c: Array, settings: AssessSettings) -> Array:
    """Friction at the reference speed by the simulator's own law, under the mean load of the replay, (J,) [N·m]."""
    if recording.target_moment is None:
        raise BadInput("torque study: the simulated recording lacks its target moments")
    load = np.mean(np.abs(recording.target_moment), axis=0)
    return controller.arm.friction_torque(np.full(len(load), settings.drift.reference_speed_rad_s), load, grease_c)


def _live(controller: Controller, rng: np.random.Generator) -> None:
    """A night at one room temperature, then up to an hour of work of random intensity."""
    room = rng.uniform(*ROOM_C)
    controller.pass_time(20.0, room, 0.0)
    controller.pass_time(rng.uniform(0.0, 1.0), room, rng.uniform(0.0, 1.0))
