"""Finite Fourier series as an excitation trajectory, Raviola et al. (2021), eq. (5)–(7); Swevers et al. (1997).

qⱼ(t) = q0ⱼ + Σₖ aₖⱼ/(kω)·sin(kωt) − bₖⱼ/(kω)·cos(kωt), ω = 2π/T.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.model.robot import Mounting
from monitor.recording import Array

LONGEST_S = 3600.0
MOST_REPETITIONS = 1000


class State(NamedTuple):
    """Position, velocity and acceleration at N times, each (N, J) [rad, rad/s, rad/s²]."""

    q: Array
    qd: Array
    qdd: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Excitation:
    """One periodic trajectory for one robot on one mounting."""

    robot: str
    mounting: Mounting
    period_s: float
    repetitions: int
    offset_rad: Array  # (J,) q0
    a_rad_s: Array  # (H, J)
    b_rad_s: Array  # (H, J)
    source: str = ""  # how it was designed
    time_scale: float = 1.0  # 0 … 1: the same path at this fraction of the speed, for a first pass under supervision
    cell: Mapping[str, Any] | None = None  # the cell of its proof, with its digest; `design.cell` reads it
    proof: Mapping[str, Any] | None = None  # clearances, margins to limits, and how they were computed
    objectives: Mapping[str, Any] | None = None  # figures of how informative it is

    def __post_init__(self) -> None:
        """Raises BadInput where a field is not finite, a shape does not fit, or a period or count is not positive."""
        if not 0.0 < self.period_s <= LONGEST_S:
            raise BadInput(f"excitation: period_s = {self.period_s!r}; expected a positive number of seconds, at most {LONGEST_S:g}")
        if not 1 <= self.repetitions <= MOST_REPETITIONS:
            raise BadInput(f"excitation: repetitions = {self.repetitions!r}; expected 1 to {MOST_REPETITIONS}")
        if not 0.0 < self.time_scale <= 1.0:
            raise BadInput(f"excitation: time_scale = {self.time_scale!r}; expected more than 0, at most 1")
        joints = len(self.offset_rad)
        for name, value in (("offset_rad", self.offset_rad[None]), ("a_rad_s", self.a_rad_s), ("b_rad_s", self.b_rad_s)):
            if value.ndim != 2 or value.shape[1] != joints or not np.all(np.isfinite(value)):
                raise BadInput(f"excitation: {name} has shape {value.shape} or is not finite; expected (harmonics, {joints})")
        if self.a_rad_s.shape != self.b_rad_s.shape:
            raise BadInput(f"excitation: a_rad_s is {self.a_rad_s.shape} but b_rad_s is {self.b_rad_s.shape}")

    @property
    def harmonics(self) -> int:
        """H."""
        return len(self.a_rad_s)

    @property
    def pass_s(self) -> float:
        """Duration of one repetition as it is played [s]: the period over the time scale."""
        return self.period_s / self.time_scale

    @property
    def duration_s(self) -> float:
        """Duration of all repetitions as they are played [s]."""
        return self.pass_s * self.repetitions

    @property
    def digest(self) -> str:
        """Identifies the motion: equal digests, equal motion. Repetitions, cell, proof and objectives are not part of it."""
        return self._digest(slowed=True)

    @property
    def path_digest(self) -> str:
        """Identifies the path through joint space at any time scale; a proof of clearance belongs to the path."""
        return self._digest(slowed=False)

    def _digest(self, *, slowed: bool) -> str:
        document = self.as_document()
        curve = {key: document[key] for key in ("robot", "mounting_deg", "period_s", "offset_rad", "a_rad_s", "b_rad_s")}
        if slowed and self.time_scale != 1.0:  # digests of older documents have no time scale
            curve["time_scale"] = self.time_scale
        return hashlib.sha256(json.dumps(curve, sort_keys=True).encode()).hexdigest()[:16]

    def at(self, t_s: Array) -> State:
        """The state at times t (N,) [s]. A time scale below 1 makes the motion slower on the same path."""
        k = np.arange(1, self.harmonics + 1)
        w = 2.0 * np.pi / self.period_s * k  # (H,)
        pace = self.time_scale
        phase = np.multiply.outer(t_s * pace, w)  # (N, H)
        sin, cos = np.sin(phase), np.cos(phase)
        q = self.offset_rad + sin @ (self.a_rad_s / w[:, None]) - cos @ (self.b_rad_s / w[:, None])
        qd = cos @ self.a_rad_s + sin @ self.b_rad_s
        qdd = cos @ (self.b_rad_s * w[:, None]) - sin @ (self.a_rad_s * w[:, None])
        return State(q, pace * qd, pace**2 * qdd)

    def sampled(self, rate_hz: float) -> tuple[Array, State]:
        """Times and states of the whole run at a rate, both ends included."""
        t_s = np.arange(round(self.duration_s * rate_hz) + 1) / rate_hz
        return t_s, self.at(t_s)

    def as_document(self) -> dict[str, Any]:
        """The trajectory as a JSON object; `excitation_from_document` is its inverse."""
        document: dict[str, Any] = {
            "kind": "joint-monitor.excitation.v1",
            "robot": self.robot,
            "mounting_deg": [round(math.degrees(angle), 9) for angle in self.mounting.angles_rad],
            "period_s": self.period_s,
            "repetitions": self.repetitions,
            "time_scale": self.time_scale,
            "offset_rad": self.offset_rad.tolist(),
            "a_rad_s": self.a_rad_s.tolist(),
            "b_rad_s": self.b_rad_s.tolist(),
            "source": self.source,
        }
        optional = {"cell": self.cell, "proof": self.proof, "objectives": self.objectives}
        return document | {key: dict(value) for key, value in optional.items() if value is not None}


def excitation_from_document(document: Any) -> Excitation:
    """The trajectory in a JSON object with the keys of `config/excitation/*.json`.

    Raises BadInput naming the key that is missing or wrong.
    """
    if not isinstance(document, dict) or document.get("kind") != "joint-monitor.excitation.v1":
        raise BadInput("excitation: expected an object whose kind is 'joint-monitor.excitation.v1'")
    try:
        degrees = document["mounting_deg"]
        return Excitation(
            robot=str(document["robot"]),
            mounting=Mounting.parse(",".join(str(float(angle)) for angle in degrees)),
            period_s=float(document["period_s"]),
            repetitions=int(document["repetitions"]),
            offset_rad=np.array(document["offset_rad"], dtype=float),
            a_rad_s=np.array(document["a_rad_s"], dtype=float),
            b_rad_s=np.array(document["b_rad_s"], dtype=float),
            source=str(document.get("source", "")),
            time_scale=float(document.get("time_scale", 1.0)),
            **{key: _table(document, key) for key in ("cell", "proof", "objectives")},
        )
    except KeyError as missing:
        raise BadInput(f"excitation: the key {missing} is missing") from None
    except (TypeError, ValueError, OverflowError) as wrong:
        raise BadInput(f"excitation: {wrong}") from None


def _table(document: dict[str, Any], key: str) -> dict[str, Any] | None:
    """The object under an optional key; None where it is missing. Raises BadInput where it is no object."""
    value = document.get(key)
    if value is not None and not isinstance(value, dict):
        raise BadInput(f"excitation: {key} is {type(value).__name__}; expected an object")
    return value
