"""Faults of files, made of one sound recording: what is read is right, or refused, or the cause is the first or second that is said.

A fault is a function from the sound table to a faulty one. The friction found in the sound table is what that of the faulty one is compared
with.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from once import once

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.columns import named_columns
from monitor.store.formats.recordings import read_recording

ROOT = Path(__file__).parents[2]
UR5 = load_robot("ur5")
SPEED_RAD_S = 0.4
RIGHT = 0.02  # of F(0.4 rad/s): what the same motion scatters by
RATE_HZ = 125.0


class Sound(NamedTuple):
    """The sound recording."""

    table: pd.DataFrame  # 20 s of a simulated UR5 in the names of RTDE, rounded as loggers do
    friction_nm: Array  # (J,) F(0.4 rad/s)


def friction_nm(found: Identification) -> Array:
    """(J,) F(0.4 rad/s) [N·m]."""
    return found.coulomb_nm + SPEED_RAD_S * found.viscous_nm_s_per_rad


def identified(path: Path, columns: str | None = None, **how) -> Identification:
    return identify([read_recording(path, columns, **how)], UR5, Mounting())


def made(folder: Path) -> Sound:
    excitation = excitation_from_document(json.loads((ROOT / "config/excitation/ur5-ground.json").read_text("utf-8")))
    played = stepped_replay(Controller(SimulateSettings(robot="ur5", seed=7)), replace(excitation, repetitions=2))
    columns = named_columns(played)
    wanted = ["timestamp", *(f"{name}_{j}" for name in ("actual_q", "actual_qd", "actual_current") for j in range(6))]
    table = pd.DataFrame({name: columns[name] for name in wanted}).round(6)
    table.to_csv(folder / "sound.csv", index=False)
    return Sound(table, friction_nm(identified(folder / "sound.csv")))


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Sound:
    return once(tmp_path_factory, "sound-file", made)


def off(found: Identification, sound: Sound) -> float:
    """By how much the friction of the worst joint is off."""
    return float(np.max(np.abs(friction_nm(found) / sound.friction_nm - 1.0)))


def said(found: Identification) -> list[str]:
    return [warning.code for warning in found.warnings]


# --- Clocks ------------------------------------------------------------------------------------------------------


def without_speeds(table: pd.DataFrame) -> pd.DataFrame:
    return table[[name for name in table if "_qd_" not in name]]


def in_bursts(table: pd.DataFrame, sizes: Callable[[], int], apart_s: float, late_s: float = 0.0, lost: float = 0.0) -> pd.DataFrame:
    """Times of a host that receives `sizes()` rows at once, each `apart_s` after the one before, up to `late_s` late; some are lost."""
    rng = np.random.default_rng(1)
    table = table[rng.random(len(table)) >= lost].copy()
    t_s = table["timestamp"].to_numpy().copy()
    first = 0
    while first < len(t_s):
        last = min(first + int(sizes()), len(t_s))
        t_s[first:last] = t_s[last - 1] + apart_s * np.arange(last - first) + late_s * rng.random()
        first = last
    return table.assign(timestamp=np.round(np.maximum.accumulate(t_s), 7))


def several(most: int) -> Callable[[], int]:
    rng = np.random.default_rng(2)
    return lambda: int(rng.integers(1, most + 1))


BURSTS: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "2, 0.1 ms apart": lambda table: in_bursts(table, lambda: 2, 1e-4),
    "2, 3 ms apart": lambda table: in_bursts(table, lambda: 2, 3e-3),
    "3, 1 µs apart": lambda table: in_bursts(table, lambda: 3, 1e-6),
    "3, 20 µs apart": lambda table: in_bursts(table, lambda: 3, 2e-5),
    "3, some rows lost": lambda table: in_bursts(table, lambda: 3, 1e-4, lost=0.02),
    "5, without speeds": lambda table: without_speeds(in_bursts(table, lambda: 5, 1e-4)),
    "1 to 6, late": lambda table: in_bursts(table, several(6), 1e-4, late_s=4e-3),
    "7 at one time": lambda table: in_bursts(table, lambda: 7, 0.0),
    "50": lambda table: in_bursts(table, lambda: 50, 1e-4),
}


@pytest.mark.slow
@pytest.mark.parametrize("burst", BURSTS)
def test_times_of_arrival_in_bursts_become_an_even_clock(tmp_path, sound, burst):
    """A host writes when rows arrived; the controller measured them evenly."""
    BURSTS[burst](sound.table).to_csv(tmp_path / "bursts.csv", index=False)
    found = identified(tmp_path / "bursts.csv")
    assert off(found, sound) < RIGHT
    assert said(found)[0] in ({"clock_restored"} if "one time" in burst else {"clock_of_arrivals"})


def test_rows_that_were_measured_unevenly_keep_their_times(tmp_path, sound):
    """A logger that reads whenever it is awake: the positions are those of its times, and an even clock would be wrong."""
    rng = np.random.default_rng(3)
    kept = np.sort(np.concatenate([np.arange(0, len(sound.table), 4), np.arange(1, len(sound.table), 4)]))
    uneven = sound.table.iloc[kept[rng.random(len(kept)) < 0.98]]
    uneven.to_csv(tmp_path / "uneven.csv", index=False)
    found = identified(tmp_path / "uneven.csv")
    assert off(found, sound) < RIGHT
    assert "clock_of_arrivals" not in said(found)


def test_nothing_is_made_of_a_file_that_is_larger_than_itself(tmp_path, sound):
    """Most rows measured 20 µs after another: refused before it is resampled to 50 kHz."""
    rng, whole = np.random.default_rng(4), sound.table
    step = np.where(rng.random(len(whole)) < 0.6, 2e-5, rng.exponential(0.02, len(whole)))
    t_s = whole["timestamp"][0] + np.cumsum(step)
    uneven = pd.DataFrame({name: np.interp(t_s, whole["timestamp"], column) for name, column in whole.items()})
    uneven.assign(timestamp=t_s).pipe(without_speeds).to_csv(tmp_path / "uneven.csv", index=False)
    with pytest.raises(BadInput, match="times are uneven: most rows are 2e-05 s apart"):
        identified(tmp_path / "uneven.csv")
