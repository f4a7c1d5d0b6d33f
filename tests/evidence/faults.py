"""What the monitor says of faults beside wear: `python -m tests.evidence.faults`, which prints the table of docs/faults.md.

A simulated UR5 with sound elastic gears, whose kinematic error is a tenth of a bad one, replays its excitation in rooms of six
temperatures; one joint then has each fault, and replays again with the same noise. Both are identified by the monitor. A fleet is judged as
in `rehearse`: each day has the observation of a room, with friction that differs from day to day as that of the fleet does, and from the
fault's day on with what the fault changed in that room.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from monitor.identify.identification import Identification
from monitor.judge.alerts.evidence import noisier, ripple_rise, weigh_evidence
from monitor.judge.assess import identified
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.friction.observation import RIPPLE_FLOOR, Observation, observe
from monitor.judge.settings import AssessSettings
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array
from monitor.simulate.arm.damage import DAMAGES
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

ROOMS_C = (12.0, 16.0, 20.0, 24.0, 28.0, 32.0)
SEVERITIES = (0.3, 1.0)
SOUND_KINEMATIC = 0.1
ARMS, ONSET_DAY, DAYS = 20, 50, 120
BETWEEN_STD, RHO = 0.02, 0.5  # of friction, from day to day
SCATTER = {"current_noise_a": 0.02, "residual_rms_nm": 0.02, "log_torque_slow": 0.003, "log_torque_fast": 0.003}  # of the other series
CONTRAST_STD = 0.02
RIPPLE_STD, RIPPLE_SCATTER = 0.007, 0.1  # of friction: from replay to replay of one simulated arm; of the ripple: of real ones
SEED = 560404
EXCITATION = Path("config/excitation/ur5-ground.json")
LOGARITHMS = ("log_torque", "log_torque_slow", "log_torque_fast")
POSITIVE = ("coulomb_nm", "viscous_nm_s_per_rad", "residual_rms_nm", "current_noise_a")
TOLD = ("rise", "fall", "noise", "ripple")


class Cell(NamedTuple):
    """One fault at one severity."""

    fault: str
    severity: float


class Played(NamedTuple):
    """An arm's replays, one in each room."""

    found: list[Identification]
    seen: list[Observation]

    def ripple_a(self, joint: int) -> tuple[float, float]:
        """Once and twice a turn of the motor, the mean [A]; NaN where no replay shows it."""
        amplitudes = np.stack([each.ripple.amplitude_a[joint, :2] for each in self.found if each.ripple is not None])
        known = np.isfinite(amplitudes)
        once, twice = np.where(known.any(axis=0), np.where(known, amplitudes, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1), np.nan)
        return float(once), float(twice)


def played(cell: Cell | None, joint: int, settings: AssessSettings, rooms_c: Sequence[float] = ROOMS_C) -> Played:
    """A replay in each room, of an arm whose joint has the fault."""
    excitation, found = replace(excitation_from_document(json.loads(EXCITATION.read_text("utf-8"))), repetitions=1), []
    for room, room_c in enumerate(rooms_c):
        controller = Controller(SimulateSettings(seed=SEED + room, ambient_c=room_c))
        for each in range(6):
            controller.arm.damage_joint("kinematic_error", each, SOUND_KINEMATIC)
        if cell is not None:
            controller.arm.damage_joint(cell.fault, joint, cell.severity)
        found.append(identified(stepped_replay(controller, excitation), load_robot("ur5"), Mounting(), None, settings))
    return Played(found, [observe(each, settings.drift) for each in found])


def as_logs(seen: Observation) -> Array:
    """(7, J) everything that a fault may change, as logarithms."""
    return np.stack([*(getattr(seen, name) for name in LOGARITHMS), *(np.log(getattr(seen, name)) for name in POSITIVE)])


def judged(sound: Played, broken: Sequence[Played], joint: int, settings: AssessSettings, arms: int = ARMS) -> dict[str, Array]:
    """(cells, arms) days from the onset until each alert, infinite where none came, negative where one came before."""
    rng, cells, J, rooms = np.random.default_rng(SEED), len(broken), 6, len(sound.seen)
    A = cells * arms
    of_cell = np.arange(A) // arms
    base = np.stack([as_logs(each) for each in sound.seen])  # (rooms, 7, J)
    after = np.stack([[as_logs(each) for each in cell.seen] for cell in broken])  # (cells, rooms, 7, J)
    ripples = np.stack([[each.ripple for each in played.seen] for played in (sound, *broken)])  # (1 + cells, rooms, J, 2)
    doubts = np.stack([[each.ripple_variance for each in played.seen] for played in (sound, *broken)])
    wander, state = np.zeros((A, J)), None
    first = {name: np.full(A, np.inf) for name in TOLD}
    for day in range(DAYS):
        room = rng.integers(rooms, size=A)
        wander = RHO * wander + np.sqrt(1.0 - RHO**2) * BETWEEN_STD * rng.normal(size=(A, J))
        logs = base[room].swapaxes(1, 2).copy()  # (A, J, 7)
        ripple, doubt = ripples[0, room].copy(), doubts[0, room].copy()  # (A, J, 2)
        if day >= ONSET_DAY:
            logs[:, joint] += (after - base)[of_cell, room, :, joint]
            ripple[:, joint], doubt[:, joint] = (each[1 + of_cell, room, joint] for each in (ripples, doubts))
        logs[..., :5] += wander[..., None]
        apart = CONTRAST_STD * rng.normal(size=(A, J))
        logs[..., 3], logs[..., 4] = logs[..., 3] + 0.5 * apart, logs[..., 4] - 0.5 * apart
        amplitude = np.exp(ripple) - RIPPLE_FLOOR  # of friction
        amplitude += np.hypot(RIPPLE_STD, RIPPLE_SCATTER * amplitude) * rng.normal(size=amplitude.shape)
        ripple = np.log(np.maximum(amplitude, 0.0) + RIPPLE_FLOOR)
        for place, name in enumerate((*LOGARITHMS, *POSITIVE)):
            logs[..., place] += SCATTER.get(name, 0.0) * rng.normal(size=(A, J))
        of = {name: logs[..., place].ravel() for place, name in enumerate((*LOGARITHMS, *POSITIVE))}
        of |= {name: np.exp(of[name]) for name in POSITIVE}
        temperature = np.stack([each.temperature_c for each in sound.seen])[room].ravel() + rng.normal(0.0, 0.5, A * J)
        share = np.stack([each.viscous_share for each in sound.seen])[room].ravel()
        seen = Observation(
            variance=np.full(A * J, 0.003**2),
            temperature_c=temperature,
            viscous_share=share,
            warming_k_per_min=np.zeros(A * J),
            ripple=ripple.reshape(A * J, 2),
            ripple_variance=doubt.reshape(A * J, 2),
            **of,
        )
        if state is None:
            state = initial_state(seen, J, settings)
        state = step(state, Replay(observation=seen, days=np.full(A, float(day > 0))), settings, in_place=True).state
        _note(first, state, joint, settings, day)
    return {name: each.reshape(cells, arms) - ONSET_DAY for name, each in first.items()}


def _note(first: dict[str, Array], state: DriftState, joint: int, settings: AssessSettings, day: int) -> None:
    """Enter the day of each alert of the joint."""
    evidence = weigh_evidence(state, settings.health)
    found = (evidence.raises >= 0, evidence.falls, noisier(state), ripple_rise(state).found)
    for name, told in zip(TOLD, found, strict=True):
        of_joint = told.reshape(-1, 6)[:, joint]
        first[name] = np.where(of_joint & np.isinf(first[name]), float(day), first[name])


def main() -> None:
    """Print the table, a row for each fault and severity."""
    parser = argparse.ArgumentParser(prog="python -m tests.evidence.faults", description=__doc__)
    parser.add_argument("--joint", type=int, choices=range(1, 7), default=3, help="that has the fault (default 3)")
    joint, settings = parser.parse_args().joint - 1, AssessSettings()
    sound = played(None, joint, settings)
    cells = [Cell(fault, severity) for fault in DAMAGES for severity in SEVERITIES]
    broken = [played(cell, joint, settings) for cell in cells]
    days = judged(sound, broken, joint, settings)
    print(
        "| fault | severity | friction | unexplained | noise of current | ripple once, mA | twice | a rise | a fall | noisier | ripple |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|"
    )
    for i, (cell, after) in enumerate(zip(cells, broken, strict=True)):
        pairs = zip(after.seen, sound.seen, strict=True)
        shift = np.mean([(as_logs(a) - as_logs(b))[:, joint] for a, b in pairs], axis=0)
        change = [f"{100 * np.expm1(shift[place]):+z.1f} %".replace("-", "−") for place in (0, 5, 6)]
        ripple = [_grown(*each) for each in zip(sound.ripple_a(joint), after.ripple_a(joint), strict=True)]
        told = [_told(days[name][i]) for name in TOLD]
        print(f"| {' | '.join([f'`{cell.fault}`', f'{cell.severity:g}', *change, *ripple, *told])} |")


def _grown(before_a: float, after_a: float) -> str:
    """An amplitude before and after [mA]."""
    was, now = ("?" if np.isnan(each) else f"{1e3 * each:.0f}" for each in (before_a, after_a))
    return f"{was} → {now}"


def _told(days: Array) -> str:
    """After how many days, the median of the arms that were told, and of how many."""
    true = days[np.isfinite(days) & (days >= 0.0)]
    early = f", {np.count_nonzero(days < 0.0)} before" if (days < 0.0).any() else ""
    return (f"{np.median(true):.0f} d, {len(true)} of {len(days)}" if len(true) else "–") + early


if __name__ == "__main__":
    main()
