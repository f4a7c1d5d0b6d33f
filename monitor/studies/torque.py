"""How well torque is foreseen at another temperature: the compensated model against the simulator's noise-free torque, full physics.

An arm is replayed at many temperatures; then, at others inside the learnt range, the torque that the same motion takes is foreseen once
with the joints' temperatures and once without, and both are compared with what the simulated drives gave without noise.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.assess import Assessment, AssessSettings, assess
from monitor.errors import BadInput
from monitor.judge.health import Health
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array
from monitor.simulate.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

START_UNIX_S, DAY_S = 1_750_000_000.0, 86_400.0
ROOM_C = (4.0, 34.0)  # with its joints some kelvins above, at rest and at work
MOVING_RAD_S = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Foreseen:
    """Over moving samples of all tests inside the learnt range."""

    corrected_nm: Array  # (J,) RMS error
    uncorrected_nm: Array
    mean_corrected_nm: Array  # (J,) the same of the error's friction part alone: of its mean along the motion
    mean_uncorrected_nm: Array
    covered: float  # share of samples whose 90 % interval held the truth
    range_c: tuple[float, float]  # coldest and warmest joint in the tests
    replays: int
    tests: int
    assess_s: float  # longest that one replay's assessment took
    laws: tuple[str, ...]  # of fv

    def as_document(self) -> dict[str, Any]:
        """Plain JSON."""
        whole = float(np.sqrt(np.sum(self.corrected_nm**2) / np.sum(self.uncorrected_nm**2)))
        friction = float(np.sqrt(np.sum(self.mean_corrected_nm**2) / np.sum(self.mean_uncorrected_nm**2)))
        return {
            "ratio": whole,
            "ratio_by_joint": (self.corrected_nm / self.uncorrected_nm).tolist(),
            "ratio_of_friction": friction,
            "corrected_nm": self.corrected_nm.tolist(),
            "uncorrected_nm": self.uncorrected_nm.tolist(),
            "covered_90": self.covered,
            "range_c": list(self.range_c),
            "replays": self.replays,
            "tests": self.tests,
            "assess_s": self.assess_s,
            "laws": list(self.laws),
        }


def foresee(
    excitation: Excitation, settings: AssessSettings, *, replays: int, tests: int, seed: int, clock: Callable[[], float], robot: str = "ur5"
) -> Foreseen:
    """Learn from `replays`, one a day, and foresee `tests` others; `clock` [s] times the assessments."""
    arm, dice = load_robot(robot), np.random.default_rng(seed)
    loud, quiet = (Controller(SimulateSettings(seed=seed, current_noise=noise)) for noise in (1.0, 0.0))
    last: Assessment | None = None
    health: Health | None = None
    slowest = 0.0
    for day in range(replays):
        _live(loud, dice)
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
    if last is None:
        raise BadInput("torque study: no replay; expected one or more")
    model, gain = last.model, np.array(arm.drive_gain_nm_per_a)
    J = arm.joints
    squares, held, counted = np.zeros((2, J)), 0, np.zeros(J)
    along: list[Array] = []
    temperatures: list[Array] = []
    while len(temperatures) < tests:
        _live(quiet, dice)
        recording = stepped_replay(quiet, excitation)
        T = recording.mean_temperature_c
        q, qd, qdd = recording.target_q, recording.target_qd, recording.target_qdd
        if T is None or q is None or qd is None or qdd is None or recording.current is None:
            raise BadInput("torque study: the simulated recording lacks its targets, currents or temperatures")
        temperatures.append(T)
        inside = model.viscous.inside(T) & (T >= 5.0) & (T <= 45.0)
        moving = (np.abs(qd) > MOVING_RAD_S) & inside
        truth = recording.current * gain
        with_T, without = (model.torque(arm, q, qd, qdd, t) for t in (T, None))
        errors = np.stack([np.where(moving, foreseen.torque - truth, 0.0) for foreseen in (with_T, without)])  # (2, N, J)
        squares += np.sum(errors**2, axis=1)
        along.append(np.sum(errors * np.sign(qd), axis=1) / np.maximum(moving.sum(axis=0), 1))  # (2, J)
        held += int(np.sum(moving & (np.abs(errors[0]) < 1.645 * with_T.std)))
        counted = counted + moving.sum(axis=0)
    rms = np.sqrt(squares / np.maximum(counted, 1))
    friction = np.sqrt(np.mean(np.square(along), axis=0))
    return Foreseen(
        corrected_nm=rms[0],
        uncorrected_nm=rms[1],
        mean_corrected_nm=friction[0],
        mean_uncorrected_nm=friction[1],
        covered=held / float(np.sum(counted)),
        range_c=(float(np.min(temperatures)), float(np.max(temperatures))),
        replays=replays,
        tests=tests,
        assess_s=slowest,
        laws=model.viscous.law,
    )


def _live(controller: Controller, dice: np.random.Generator) -> None:
    """A night at one temperature of the room, then up to an hour of more or less work."""
    room = dice.uniform(*ROOM_C)
    controller.live(20.0, room, 0.0)
    controller.live(dice.uniform(0.0, 1.0), room, dice.uniform(0.0, 1.0))
