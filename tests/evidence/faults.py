"""What the monitor says of faults beside wear: `python -m tests.evidence.faults`, which prints the table of docs/faults.md.

A simulated UR5 with sound elastic gears, whose kinematic error is a tenth of a bad one, replays its excitation in rooms of three
temperatures; joint 3 then has each fault, and replays again with the same noise. Both are identified by the monitor. A fleet is judged as
in `rehearse`: each day has the observation of a room, with friction that differs from day to day as that of the fleet does, and from the
fault's day on with what the fault changed in that room.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from monitor.identify.identification import Identification
from monitor.judge.alerts.evidence import noisier, weigh_evidence
from monitor.judge.assess import identified
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.friction.observation import Observation, observe
from monitor.judge.settings import AssessSettings
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array
from monitor.simulate.arm.damage import DAMAGES
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

ROOMS_C = (17.0, 22.0, 27.0)
SEVERITIES = (0.3, 1.0)
JOINT = 2  # from 0
SOUND_KINEMATIC = 0.1
ARMS, ONSET_DAY, DAYS = 4, 50, 120
BETWEEN_STD, RHO = 0.02, 0.5  # of friction, from day to day
SCATTER = {"current_noise_a": 0.02, "residual_rms_nm": 0.02, "log_torque_slow": 0.003, "log_torque_fast": 0.003}  # of the other series
CONTRAST_STD = 0.02
SEED = 560404
EXCITATION = Path("config/excitation/ur5-ground.json")
LOGARITHMS = ("log_torque", "log_torque_slow", "log_torque_fast")
POSITIVE = ("coulomb_nm", "viscous_nm_s_per_rad", "residual_rms_nm", "current_noise_a")


class Cell(NamedTuple):
    """One fault at one severity."""

    fault: str
    severity: float


def played(cell: Cell | None, settings: AssessSettings) -> list[Identification]:
    """An identified replay in each room."""
    excitation = replace(excitation_from_document(json.loads(EXCITATION.read_text("utf-8"))), repetitions=1)
    found = []
    for room_c in ROOMS_C:
        controller = Controller(SimulateSettings(seed=SEED, ambient_c=room_c))
        for joint in range(6):
            controller.arm.damage_joint("kinematic_error", joint, SOUND_KINEMATIC)
        if cell is not None:
            controller.arm.damage_joint(cell.fault, JOINT, cell.severity)
        found.append(identified(stepped_replay(controller, excitation), load_robot("ur5"), Mounting(), None, settings))
    return found


def as_logs(seen: Observation) -> Array:
    """(7, J) everything that a fault may change, as logarithms."""
    return np.stack([*(getattr(seen, name) for name in LOGARITHMS), *(np.log(getattr(seen, name)) for name in POSITIVE)])


def judged(sound: list[Observation], shifts: Array, settings: AssessSettings) -> dict[str, Array]:
    """(cells, ARMS) days from the onset until each alert, infinite where none came, and whether one came before. shifts : (cells, 3, 7)."""
    rng, cells, J = np.random.default_rng(SEED), len(shifts), 6
    A = cells * ARMS
    base = np.stack([as_logs(each) for each in sound])  # (rooms, 7, J)
    wander, state = np.zeros((A, J)), None
    first = {name: np.full(A, np.inf) for name in ("rise", "fall", "noise")}
    for day in range(DAYS):
        room = rng.integers(len(sound), size=A)
        wander = RHO * wander + np.sqrt(1.0 - RHO**2) * BETWEEN_STD * rng.normal(size=(A, J))
        logs = base[room].swapaxes(1, 2).copy()  # (A, J, 7)
        if day >= ONSET_DAY:
            logs[:, JOINT] += shifts[np.arange(A) // ARMS, room]
        logs[..., :5] += wander[..., None]
        apart = CONTRAST_STD * rng.normal(size=(A, J))
        logs[..., 3], logs[..., 4] = logs[..., 3] + 0.5 * apart, logs[..., 4] - 0.5 * apart
        for place, name in enumerate((*LOGARITHMS, *POSITIVE)):
            logs[..., place] += SCATTER.get(name, 0.0) * rng.normal(size=(A, J))
        of = {name: logs[..., place].ravel() for place, name in enumerate((*LOGARITHMS, *POSITIVE))}
        of |= {name: np.exp(of[name]) for name in POSITIVE}
        temperature = np.stack([each.temperature_c for each in sound])[room].ravel() + rng.normal(0.0, 0.5, A * J)
        share = np.stack([each.viscous_share for each in sound])[room].ravel()
        seen = Observation(
            variance=np.full(A * J, 0.003**2), temperature_c=temperature, viscous_share=share, warming_k_per_min=np.zeros(A * J), **of
        )
        if state is None:
            state = initial_state(seen, J, settings)
        state = step(state, Replay(observation=seen, days=np.full(A, float(day > 0))), settings, in_place=True).state
        _note(first, state, settings, day)
    return {name: each.reshape(cells, ARMS) - ONSET_DAY for name, each in first.items()}


def _note(first: dict[str, Array], state: DriftState, settings: AssessSettings, day: int) -> None:
    """Enter the day of each alert of the joint."""
    evidence = weigh_evidence(state, settings.health)
    for name, told in (("rise", evidence.raises >= 0), ("fall", evidence.falls), ("noise", noisier(state))):
        of_joint = told.reshape(-1, 6)[:, JOINT]
        first[name] = np.where(of_joint & np.isinf(first[name]), float(day), first[name])


def main() -> None:
    """Print the table, a row for each fault and severity."""
    settings = AssessSettings()
    sound = played(None, settings)
    cells = [Cell(fault, severity) for fault in DAMAGES for severity in SEVERITIES]
    before = [observe(each, settings.drift) for each in sound]
    shifts, ripples = [], []
    for cell in cells:
        found = played(cell, settings)
        after = [observe(each, settings.drift) for each in found]
        shifts.append([(as_logs(a) - as_logs(b))[:, JOINT] for a, b in zip(after, before, strict=True)])
        ripples.append(np.mean([each.ripple.amplitude_a[JOINT, 0] for each in found if each.ripple is not None]))
    was = np.mean([each.ripple.amplitude_a[JOINT, 0] for each in sound if each.ripple is not None])
    days = judged(before, np.array(shifts), settings)
    print(
        "| fault | severity | friction | residual | noise | ripple, mA | a rise | a fall | noisier |\n|---|---|---|---|---|---|---|---|---|"
    )
    for i, (cell, shift) in enumerate(zip(cells, np.array(shifts).mean(axis=1), strict=True)):
        change = [f"{100 * np.expm1(shift[place]):+.1f} %" for place in (0, 5, 6)]
        told = [_told(days[name][i]) for name in ("rise", "fall", "noise")]
        print(f"| {' | '.join([cell.fault, f'{cell.severity:g}', *change, f'{1e3 * was:.0f} → {1e3 * ripples[i]:.0f}', *told])} |")


def _told(days: Array) -> str:
    """After how many days, the median of the arms that were told, and of how many."""
    true = days[np.isfinite(days) & (days >= 0.0)]
    early = f", {np.count_nonzero(days < 0.0)} before" if (days < 0.0).any() else ""
    return (f"{np.median(true):.0f} d, {len(true)} of {len(days)}" if len(true) else "–") + early


if __name__ == "__main__":
    main()
