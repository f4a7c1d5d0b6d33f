"""Work of a simulated cell as `listen` judges it, beside the friction that the simulator's arm has in truth."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from monitor.model.fourier import excitation_from_document
from monitor.model.robot import load_robot
from monitor.recording import Array
from monitor.simulate.arm.friction import FrictionLaw, default_law
from monitor.simulate.cells.catalogue import cell
from monitor.simulate.cells.cell import Cell
from monitor.simulate.cells.things import Mass
from monitor.simulate.controller.controller import Controller
from monitor.simulate.production import ProductionSettings, arm_in_cell, record
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import write_recording, write_table
from monitor.store.from_files.production_files import ListenRequest, listen_to_files

EXCITATION = Path(__file__).parents[2] / "config" / "excitation" / "ur5-ground.json"
REFERENCE_RAD_S = 0.4


@dataclass(frozen=True, kw_only=True)
class Listened:
    """What work told, and the truth."""

    document: dict[str, Any]  # of `listen --json`
    friction_nm: Array  # (J,), NaN where nothing is told
    deviation_nm: Array  # (J,)
    known: Array  # (J,) whether work told enough of the joint
    true_nm: Array  # (J,) of the arm's law, at the temperature of its grease in this work and the loads of the replay

    @property
    def z(self) -> Array:
        """(J,) error in deviations."""
        return (self.friction_nm - self.true_nm) / self.deviation_nm

    @property
    def shift(self) -> Array:
        """(J,) error as a share of friction."""
        return self.friction_nm / self.true_nm - 1.0


@lru_cache(maxsize=64)
def law(seed: int) -> FrictionLaw:
    """The friction of an arm of this seed: each parameter of each joint is 0.8 to 1.25 times the usual one."""
    usual, dice = default_law(load_robot("ur5")), np.random.default_rng([seed, 77])
    names = ("coulomb_nm", "concave_nm", "linear_nm_s_per_rad")
    return replace(usual, **{name: getattr(usual, name) * dice.uniform(0.8, 1.25, 6) for name in names})


@lru_cache(maxsize=64)
def replay(folder: Path, tool: Mass, seed: int) -> tuple[Path, Array]:
    """A replay of the arm with a tool: its recording, and the mean load of each joint (J,) [N·m]."""
    settings = SimulateSettings(robot="ur5", seed=seed + 1000, payload_kg=tool.kg, payload_com_m=tool.com_m, personality="recorded")
    controller = Controller(settings, law=law(seed))
    recording = stepped_replay(controller, replace(excitation_from_document(json.loads(EXCITATION.read_text("utf-8"))), repetitions=1))
    path = folder / f"replay-{tool.kg:g}-{seed}.parquet"
    write_recording(path, recording)
    _, load = controller.arm.rigid_torque(recording.q, recording.qd, np.gradient(recording.qd, 0.008, axis=0))
    return path, np.abs(load).mean(axis=0)


def listened(
    folder: Path, production: ProductionSettings, wear: Sequence[float] | None = None, disturb: Callable[[Cell], Cell] | None = None
) -> Listened:
    """Replay, work, and what `listen` makes of both. `wear` and what `disturb` makes of the cell came after the replay."""
    before = cell(production.cell, load_robot(production.robot), production.seed)
    controller, around = arm_in_cell(production, law(production.seed), wear, disturb(before) if disturb else before)
    rigid, load = replay(folder, before.tool, production.seed)
    grease: list[Array] = []
    recording = record(production, (controller, around), progress=lambda _: grease.append(controller.arm.temperatures.grease_c.copy()))
    path = folder / f"work-{production.cell}-{production.seed}-{100 * production.speed:.0f}.parquet"
    write_table(path, recording.columns, recording.context)
    request = ListenRequest(files=[path], rigid=rigid, history=None, robot=None, mounting=None)
    document = listen_to_files(request, load_robot)
    worn = controller.arm.wear
    true = law(production.seed).torque(np.full(6, REFERENCE_RAD_S), load, np.mean(grease, axis=0), worn.coulomb, worn.viscous)
    told = {
        key: np.array([np.nan if joint[key] is None else joint[key] for joint in document["joints"]], dtype=float)
        for key in ("friction_nm", "deviation_nm", "known")
    }
    return Listened(document=document, true_nm=true, **(told | {"known": told["known"] == 1.0}))
