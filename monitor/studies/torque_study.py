"""How well torque is foreseen at another temperature: the compensated model against the simulator's noise-free torque, full physics.

An arm is replayed at many temperatures; then, at others inside the learnt range, the torque that the same motion takes is foreseen once
with the joints' temperatures and once without, and both are compared with what the simulated drives gave without noise. The same replays
show whether the fleet's surrogate stands for full physics.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import ks_2samp

from monitor.assess import AssessSettings, assess
from monitor.errors import BadInput
from monitor.judge.alerts.health import Health
from monitor.judge.assessment import Assessment
from monitor.judge.drift.observation import observe
from monitor.judge.torque.predictor import predict_torque
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array, Recording
from monitor.simulate.arm.friction import default_law
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.studies.figures import MOVING_RAD_S, NINETY, over_arms
from monitor.studies.rehearsal.fleet import WITHIN_SHARE, various

START_UNIX_S, DAY_S = 1_750_000_000.0, 86_400.0
ROOM_C = (4.0, 34.0)  # with its joints some kelvins above, at rest and at work
COLDEST_C, WARMEST_C = 5.0, 45.0
SURROGATES = 200_000  # of the surrogate's own, against which full physics is held
FEWEST_TESTS = 6  # of which a slope is told


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Foreseen:
    """Of one arm: over moving samples of its tests inside the learnt range."""

    squares_nm2: Array  # (2, J) mean squared error with the joints' temperatures, and without
    along_nm: Array  # (2, tests, J) the error's mean along the motion: of friction alone; NaN where a joint was outside
    slope_per_k: Array  # (J,) of that with temperatures, over the friction foreseen, against temperature
    left: Array  # (replays, J) log of friction at the reference speed, identified, less that of the law at the grease's temperature
    grease_c: Array  # (replays, J) during them
    covered: Array  # (J,) share of samples whose 90 % interval held the truth
    range_c: tuple[float, float]  # coldest and warmest joint in the tests, of those counted
    assess_s: float  # longest that one replay's assessment took

    @property
    def ratio(self) -> float:
        """Error with temperatures over that without."""
        return _ratio(self.squares_nm2[None])


def foresee(
    seed: int,
    *,
    excitation: Excitation,
    settings: AssessSettings,
    replays: int,
    tests: int,
    clock: Callable[[], float],
    robot: str = "ur5",
) -> Foreseen:
    """Learn from `replays`, one a day, and foresee `tests` others; `clock` [s] times the assessments."""
    arm, dice = load_robot(robot), np.random.default_rng(seed)
    law = various(default_law(arm), (), dice)
    loud, quiet = (Controller(SimulateSettings(robot=robot, seed=seed, current_noise=noise), law=law) for noise in (1.0, 0.0))
    last: Assessment | None = None
    health: Health | None = None
    slowest = 0.0
    left, grease = np.empty((replays, arm.joints)), np.empty((replays, arm.joints))
    for day in range(replays):
        _live(loud, dice)
        before = loud.arm.temperatures.grease_c.copy()
        recording = stepped_replay(loud, excitation)
        recording = replace(recording, context=replace(recording.context, recorded_at_unix_s=START_UNIX_S + day * DAY_S))
        began = clock()
        told = assess(
            recording,
            robot=arm,
            mounting=Mounting(),
            belief=last.belief if last else None,
            health=health,
            settings=settings,
            model=last.model if last else None,
        )
        slowest = max(slowest, clock() - began if day else 0.0)  # the first one loads and compiles what all use
        if not isinstance(told, Assessment):
            raise BadInput(f"torque study: replay {day} was rejected: {told.reason}")
        last, health = told, told.health
        grease[day] = 0.5 * (before + loud.arm.temperatures.grease_c)
        left[day] = observe(told.identification, settings.drift).log_torque - np.log(_by_law(loud, recording, grease[day], settings))
    if last is None:
        raise BadInput("torque study: no replay; expected one or more")
    model, gain, J = last.model, np.array(arm.drive_gain_nm_per_a), arm.joints
    squares, held, counted = np.zeros((2, J)), np.zeros(J), np.zeros(J)
    along, sizes, temperatures = np.full((2, tests, J), np.nan), np.full((tests, J), np.nan), np.full((tests, J), np.nan)
    for test in range(tests):
        _live(quiet, dice)
        recording = stepped_replay(quiet, excitation)
        T = recording.mean_temperature_c
        q, qd, qdd = recording.target_q, recording.target_qd, recording.target_qdd
        if T is None or q is None or qd is None or qdd is None or recording.current is None:
            raise BadInput("torque study: the simulated recording lacks its targets, currents or temperatures")
        inside = model.viscous.inside(T) & (T >= COLDEST_C) & (T <= WARMEST_C)
        temperatures[test] = np.where(inside, T, np.nan)
        moving = (np.abs(qd) > MOVING_RAD_S) & inside
        n = np.where(inside, moving.sum(axis=0), np.nan)
        with_T, without = (predict_torque(model, arm, q, qd, qdd, t) for t in (T, None))
        truth = recording.current * gain
        errors = np.stack([np.where(moving, foreseen.torque - truth, 0.0) for foreseen in (with_T, without)])  # (2, N, J)
        squares += np.sum(errors**2, axis=1)
        along[:, test] = np.sum(errors * np.sign(qd), axis=1) / n
        sizes[test] = np.sum(np.where(moving, np.abs(with_T.friction), 0.0), axis=0) / n
        held += np.sum(moving & (np.abs(errors[0]) < NINETY * with_T.std), axis=0)
        counted += moving.sum(axis=0)
    if not counted.all():
        raise BadInput(
            f"torque study: joint {int(np.argmin(counted)) + 1} was in no test as warm as learnt; expected more replays or tests"
        )
    return Foreseen(
        squares_nm2=squares / counted,
        along_nm=along,
        slope_per_k=_slope(temperatures, along[0] / sizes),
        left=left,
        grease_c=grease,
        covered=held / counted,
        range_c=(float(np.nanmin(temperatures)), float(np.nanmax(temperatures))),
        assess_s=slowest,
    )


def surrogate(arms: Sequence[Foreseen], within_std: float) -> dict[str, Any]:
    """Whether what `identify` adds to the law has the distribution that the fleet's surrogate gives it: each joint's, arms together.

    An arm's constant (a line through a concave law), which no drift can come from, is taken off; what is left is held against the
    surrogate's by Kolmogorov and Smirnov after each is scaled to 1, the scales and the course with temperature are told beside.
    """
    left, grease = np.stack([arm.left for arm in arms]), np.stack([arm.grease_c for arm in arms])  # (A, R, J)
    A, R, J = left.shape
    away, warmer = left - left.mean(axis=1, keepdims=True), grease - grease.mean(axis=1, keepdims=True)
    slopes = np.sum(away * warmer, axis=(0, 1)) / np.sum(warmer**2, axis=(0, 1))  # (J,)
    std = np.sqrt(np.sum(away**2, axis=(0, 1)) / (A * (R - 1)))  # (J,)
    dice = np.random.default_rng(0)
    drawn = dice.uniform(*WITHIN_SHARE, SURROGATES) * dice.normal(size=SURROGATES)
    tests = [ks_2samp((away[:, :, j] / std[j]).ravel(), drawn / drawn.std()) for j in range(J)]
    return {
        "replays": A * R,
        "std": std.tolist(),
        "surrogate_std": within_std * float(drawn.std()),
        "distance": max(float(test.statistic) for test in tests),
        "p": min(1.0, J * min(float(test.pvalue) for test in tests)),  # of the worst of J joints, by Bonferroni
        "slope_per_k": float(np.max(np.abs(slopes))),
    }


def summary(arms: Sequence[Foreseen], *, replays: int, tests: int) -> dict[str, Any]:
    """All arms together, plain JSON; bounds are one-sided, 95 %."""
    squares = np.stack([arm.squares_nm2 for arm in arms])  # (A, 2, J)
    along = np.stack([np.nanmean(arm.along_nm**2, axis=1) for arm in arms])  # (A, 2, J)
    slopes, covered = np.abs([arm.slope_per_k for arm in arms]), np.stack([arm.covered for arm in arms])  # (A, J) each
    mean = squares.mean(axis=0)
    return {
        "arms": len(arms),
        "ratio": over_arms(_ratio, squares)._asdict(),
        "ratio_by_joint": np.sqrt(mean[0] / mean[1]).tolist(),
        "ratio_of_worst_arm": max(arm.ratio for arm in arms),
        "ratio_of_friction": over_arms(_ratio, along)._asdict(),
        "slope_per_k": {**over_arms(np.nanmean, slopes)._asdict(), "nine_of_ten": float(np.nanquantile(slopes, 0.9))},
        "covered_90": over_arms(np.mean, covered)._asdict(),
        "covered_90_by_joint": covered.mean(axis=0).tolist(),
        "range_c": [min(arm.range_c[0] for arm in arms), max(arm.range_c[1] for arm in arms)],
        "assess_s": max(arm.assess_s for arm in arms),
        "replays": replays,
        "tests": tests,
    }


def _ratio(squares_nm2: Array) -> float:
    """(A, 2, J) mean squares with temperatures and without → root of the first over that of the second, all arms and joints together."""
    with_T, without = squares_nm2.sum(axis=(0, 2))
    return float(np.sqrt(with_T / without))


def _slope(x: Array, y: Array) -> Array:
    """(J,) slope of y against x, (n, J) each, where both are finite; NaN where fewer than `FEWEST_TESTS` are."""
    known = np.isfinite(x) & np.isfinite(y)
    n = np.maximum(known.sum(axis=0), 1)
    x, y = np.where(known, x, 0.0), np.where(known, y, 0.0)
    away = np.where(known, x - x.sum(axis=0) / n, 0.0)
    slope: Array = np.sum(away * y, axis=0) / np.maximum(np.sum(away**2, axis=0), 1e-12)
    return np.where(n >= FEWEST_TESTS, slope, np.nan)


def _by_law(controller: Controller, recording: Recording, grease_c: Array, settings: AssessSettings) -> Array:
    """(J,) friction at the reference speed by the simulator's own law, under the replay's mean load [N·m]."""
    if recording.target_moment is None:
        raise BadInput("torque study: the simulated recording lacks its target moments")
    load = np.mean(np.abs(recording.target_moment), axis=0)
    return controller.arm.friction_torque(np.full(len(load), settings.drift.reference_speed_rad_s), load, grease_c)


def _live(controller: Controller, dice: np.random.Generator) -> None:
    """A night at one temperature of the room, then up to an hour of more or less work."""
    room = dice.uniform(*ROOM_C)
    controller.pass_time(20.0, room, 0.0)
    controller.pass_time(dice.uniform(0.0, 1.0), room, dice.uniform(0.0, 1.0))
