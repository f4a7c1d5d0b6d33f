"""WorkInformation: what work has told so far, as sums that can be added, forgotten by day and kept in a file. Never a raw row."""

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.recording import DAY_S, Array

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
    """What the work of one arm has told, by day and range of temperature. Information of the same arm can be added in any order."""

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
                raise BadInput(f"information from work: {name} is {getattr(self, name)} and {getattr(other, name)}; expected the same")
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
            raise BadInput(f"information from work: version {document['version']!r}; expected {VERSION}")
        columns = tuple(int(column) for column in document["rigid_columns"])
        beyond = len(document["cells"][0]["beyond"][0]) if document["cells"] else 0
        model = no_sums(joints, len(columns), beyond, 0.0)
        cells = {}
        for entry in document["cells"]:
            arrays: dict[str, Any] = {}
            for f in fields(Sums):
                expected, value = getattr(model, f.name), np.asarray(entry[f.name], dtype=float)
                if value.shape != np.shape(expected) or not np.all(np.isfinite(value)):
                    raise BadInput(f"information from work: {f.name} is {value.shape}; expected {np.shape(expected)} finite numbers")
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
        raise BadInput(f"information from work: {type(wrong).__name__}: {wrong}; expected what `to_document` made") from None


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
