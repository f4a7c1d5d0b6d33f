"""What production has told so far, as sums that can be added, forgotten by day and kept in a file. Never a raw row."""

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.recording import DAY_S, Array, Mask

VERSION = 1
PATHS = 12  # buckets into which the paths of segments fall: what a model errs by is alike on one path, and does not average out there


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sums:
    """Weighted sums over the rows of one day in one range of temperature. X are the columns of fc and fv of all joints, A = 2·J unknowns.

    The rows are weighted by the noise of the replay and the time over which noise is alike, with each segment's load projected out. So
    `gram` is the information on friction itself, and the sums do not change with the model.
    """

    gram: Array  # (A, A) XᵀWX
    torque: Array  # (A,) XᵀWτ
    rigid: Array  # (A, R) XᵀW of the rigid base parameters
    beyond: Array  # (A, J·E) XᵀW of each joint's friction beyond fc and fv
    paths: Array  # (PATHS, A) XᵀW of the residual, by path, with the model of the time
    path_gram: Array  # (PATHS, J, 2, 2) XᵀX of each joint, by path, without the loads projected out
    moving_s: Array  # (J,) seconds that counted
    temperature: Array  # (2, J) Σ w·T, Σ w of the rows with a temperature, w = seconds
    speed: Array  # (J,) Σ |q̇| in seconds
    begin_unix_s: float
    end_unix_s: float

    def __add__(self, other: "Sums") -> "Sums":
        """The sums over the rows of both."""
        arrays = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self) if not f.name.endswith("unix_s")}
        return Sums(begin_unix_s=min(self.begin_unix_s, other.begin_unix_s), end_unix_s=max(self.end_unix_s, other.end_unix_s), **arrays)


def added(several: Sequence[Sums]) -> Sums:
    """The sums over the rows of all, one or more."""
    return reduce(operator.add, several)


def no_sums(joints: int, rigid: int, beyond: int, at_unix_s: float) -> Sums:
    """Sums over no rows."""
    A = 2 * joints
    return Sums(
        gram=np.zeros((A, A)),
        torque=np.zeros(A),
        rigid=np.zeros((A, rigid)),
        beyond=np.zeros((A, beyond)),
        paths=np.zeros((PATHS, A)),
        path_gram=np.zeros((PATHS, joints, 2, 2)),
        moving_s=np.zeros(joints),
        temperature=np.zeros((2, joints)),
        speed=np.zeros(joints),
        begin_unix_s=at_unix_s,
        end_unix_s=at_unix_s,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionInformation:
    """What the production of one arm has told, by day and range of temperature. Information of the same arm can be added in any order."""

    robot: str
    rigid_columns: tuple[int, ...]  # (R,) columns of the regressor
    law: str  # of the friction
    payload_kg: float  # that counts as part of the arm: that of the replay
    temperature_bin_k: float
    cells: Mapping[tuple[int, int], Sums] = field(default_factory=dict)  # (UTC day, temperature bin; NO_BIN where unknown) → sums
    left_out_s: Mapping[int, Mapping[str, float]] = field(default_factory=dict)  # UTC day → cause → seconds
    seen_s: Mapping[int, float] = field(default_factory=dict)  # UTC day → seconds listened to

    def __add__(self, other: "ProductionInformation") -> "ProductionInformation":
        """What both have told. Raises BadInput where they are of different arms or were summed differently."""
        for name in ("robot", "rigid_columns", "law", "payload_kg", "temperature_bin_k"):
            if getattr(self, name) != getattr(other, name):
                raise BadInput(
                    f"information from production: {name} is {getattr(self, name)} and {getattr(other, name)}; expected the same"
                )
        cells = dict(self.cells)
        for key, sums in other.cells.items():
            cells[key] = cells[key] + sums if key in cells else sums
        left = {day: dict(causes) for day, causes in self.left_out_s.items()}
        for day, causes in other.left_out_s.items():
            for cause, seconds in causes.items():
                left.setdefault(day, {})[cause] = left.get(day, {}).get(cause, 0.0) + seconds
        seen = dict(self.seen_s)
        for day, seconds in other.seen_s.items():
            seen[day] = seen.get(day, 0.0) + seconds
        return replace(self, cells=cells, left_out_s=left, seen_s=seen)

    def since(self, at_unix_s: float) -> "ProductionInformation":
        """What was told since this time: days that ended before it are forgotten, whole days at a time."""
        return self.of_days(int(at_unix_s // DAY_S))

    def of_days(self, first: int, last: float = math.inf) -> "ProductionInformation":
        """What was told on the UTC days from the first to the last, both included."""
        return replace(
            self,
            cells={key: sums for key, sums in self.cells.items() if first <= key[0] <= last},
            left_out_s={day: causes for day, causes in self.left_out_s.items() if first <= day <= last},
            seen_s={day: seconds for day, seconds in self.seen_s.items() if first <= day <= last},
        )

    def left_out(self) -> dict[str, float]:
        """Seconds that did not count, by cause, of all days."""
        left: dict[str, float] = {}
        for causes in self.left_out_s.values():
            for cause, seconds in causes.items():
                left[cause] = left.get(cause, 0.0) + seconds
        return left

    def to_document(self) -> dict[str, Any]:
        """A JSON object; `information_from_document` is the inverse."""
        return {
            "version": VERSION,
            "robot": self.robot,
            "rigid_columns": list(self.rigid_columns),
            "law": self.law,
            "payload_kg": self.payload_kg,
            "temperature_bin_k": self.temperature_bin_k,
            "cells": [
                {"day": day, "bin": bin_, **{f.name: _plain(getattr(sums, f.name)) for f in fields(sums)}}
                for (day, bin_), sums in sorted(self.cells.items())
            ],
            "left_out_s": [{"day": day, **causes} for day, causes in sorted(self.left_out_s.items())],
            "seen_s": [{"day": day, "seconds": seconds} for day, seconds in sorted(self.seen_s.items())],
        }


NO_BIN = -1_000_000  # where the temperature is not known


def information_from_document(document: Any, joints: int) -> ProductionInformation:
    """The information in a JSON object of `to_document`. Raises BadInput saying what is missing or wrong."""
    try:
        if document["version"] != VERSION:
            raise BadInput(f"information from production: version {document['version']!r}; expected {VERSION}")
        columns = tuple(int(column) for column in document["rigid_columns"])
        beyond = len(document["cells"][0]["beyond"][0]) if document["cells"] else 0
        model = no_sums(joints, len(columns), beyond, 0.0)
        cells = {}
        for entry in document["cells"]:
            arrays: dict[str, Any] = {}
            for f in fields(Sums):
                expected, value = getattr(model, f.name), np.asarray(entry[f.name], dtype=float)
                if value.shape != np.shape(expected) or not np.all(np.isfinite(value)):
                    raise BadInput(f"information from production: {f.name} is {value.shape}; expected {np.shape(expected)} finite numbers")
                arrays[f.name] = value if value.ndim else float(value)
            cells[(int(entry["day"]), int(entry["bin"]))] = Sums(**arrays)
        return ProductionInformation(
            robot=str(document["robot"]),
            rigid_columns=columns,
            law=str(document["law"]),
            payload_kg=float(document["payload_kg"]),
            temperature_bin_k=float(document["temperature_bin_k"]),
            cells=cells,
            left_out_s={int(entry["day"]): {str(k): float(v) for k, v in entry.items() if k != "day"} for entry in document["left_out_s"]},
            seen_s={int(entry["day"]): float(entry["seconds"]) for entry in document["seen_s"]},
        )
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as wrong:
        if isinstance(wrong, BadInput):
            raise
        raise BadInput(f"information from production: {type(wrong).__name__}: {wrong}; expected what `to_document` made") from None


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


# --- By how much friction from production differs, as the arm itself shows: from path to path, and from day to day ---

USUAL_SCALE, SCALE_WEIGHT = 1.0, 1.0  # of the variance that the rows promise, and its weight in joints
MOST_SCALE = 4.0  # one joint says no more of the others: a few paths may agree or differ by chance
OWN_WEIGHT = 1.0  # of a joint's own paths beside what all joints show: what is carried, and where, is felt by some joints alone
DAYS_WEIGHT = 2.0  # of the usual scatter between days, in degrees of freedom of all joints together …
JOINTS_WEIGHT = 4.0  # … and of what all joints show in that of one: weights and speeds differ, grease and room are common
# change of log F(v*) with temperature: from −0.2 to −1 % a kelvin on arms with strain wave gears
FALL_PER_K, FALL_STD_PER_K = -0.006, 0.004


class Days(NamedTuple):
    """Friction by the production of each day, (D, J)."""

    friction_nm: Array  # NaN where that day does not tell
    temperature_c: Array  # NaN where unknown


def between_paths(sums: Sums) -> tuple[Array, Mask]:
    """The scatter of XᵀWe between paths (A, A), and the joints (J,) that have enough paths for one."""
    J = sums.path_gram.shape[1]
    score = sums.paths.reshape(len(sums.paths), J, 2).copy()  # (PATHS, J, 2)
    total = np.sum(sums.path_gram, axis=0)  # (J, 2, 2)
    ridge = 1e-9 * np.trace(total, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-12 * np.eye(2)
    change = np.linalg.solve(total + ridge, np.sum(score, axis=0)[:, :, None])[:, :, 0]  # (J, 2)
    left = score - np.einsum("kjab,jb->kja", sums.path_gram, change)
    used = np.trace(sums.path_gram, axis1=2, axis2=3) > 0.02 * np.trace(total, axis1=1, axis2=2) / len(score)  # (PATHS, J)
    count = np.sum(used, axis=0)  # (J,)
    inflated = left * np.sqrt(count / np.maximum(count - 2.0, 0.5))[None, :, None]
    flat = inflated.reshape(len(score), 2 * J)
    return flat.T @ flat, count > 2


def noise_scale(promised_var: Array, paths_var: Array, enough: Mask) -> Array:
    """(J,) by which the variance that the rows promise (J,) is multiplied, as paths differ (J,) in the joints that have `enough` (J,)."""
    known = enough & (promised_var > 0.0) & np.isfinite(paths_var)
    ratio = np.where(known, paths_var / np.where(known, promised_var, 1.0), 0.0)
    together = (SCALE_WEIGHT * USUAL_SCALE + np.sum(np.minimum(ratio, MOST_SCALE))) / (SCALE_WEIGHT + np.sum(known))
    scale: Array = np.where(known, (together + OWN_WEIGHT * ratio) / (1.0 + OWN_WEIGHT), together)
    return scale


def between_days(days: Days, usual: float) -> Array:
    """(J,) one standard deviation of friction from day to day, as a fraction of it, with temperature taken out.

    usual : the same of real arms, which counts where there is one day alone.
    """
    told = np.isfinite(days.friction_nm) & (days.friction_nm > 0.0)
    count = np.sum(told, axis=0)  # (J,)
    y = _centred(np.log(np.where(told, days.friction_nm, 1.0)), told)
    warmer = _centred(np.nan_to_num(days.temperature_c), told & np.isfinite(days.temperature_c))
    least = max(usual, 1e-4)
    slope = (FALL_PER_K / FALL_STD_PER_K**2 + np.sum(warmer * y) / least**2) / (FALL_STD_PER_K**-2 + np.sum(warmer**2) / least**2)
    squares = np.sum((y - slope * warmer) ** 2, axis=0)  # (J,)
    free = np.maximum(count - 1.0, 0.0)
    together = (DAYS_WEIGHT * usual**2 + np.sum(squares)) / (DAYS_WEIGHT + np.sum(free))
    scatter: Array = np.sqrt((JOINTS_WEIGHT * together + squares) / (JOINTS_WEIGHT + free))
    return scatter


def _centred(values: Array, known: Mask) -> Array:
    """(D, J) the values less their mean over the days that are known; 0 on the others."""
    count = np.maximum(np.sum(known, axis=0), 1)
    mean = np.sum(np.where(known, values, 0.0), axis=0) / count
    centred: Array = np.where(known, values - mean, 0.0)
    return centred
