"""What was learnt of one arm for its torque band: its model, and what earlier replays needed along the trajectory. Values only."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.judge.torque.model import CompensatedModel, model_from_document
from monitor.recording import Array

STEP_S = 0.04  # between two points of a profile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueProfile:
    """By phase, the time since the beginning of a repetition: what was needed, and what surprised the filter."""

    replays: int
    pass_s: float  # duration of one repetition
    mean_nm: Array  # (B, J) every STEP_S
    spread_nm: Array  # (B, J) what the band must allow there beyond the filter's uncertainty, the noise and static friction

    def at(self, phase_s: float) -> tuple[Array, Array]:
        """Mean and spread at a phase, (J,) each [N·m]; phases beyond a repetition are those of the next."""
        place = (phase_s % self.pass_s) / STEP_S - 0.5  # a step's mean belongs to its middle
        i = int(np.floor(place))
        share = place - i
        i, following = i % len(self.mean_nm), (i + 1) % len(self.mean_nm)
        mean: Array = (1.0 - share) * self.mean_nm[i] + share * self.mean_nm[following]
        return mean, self.spread_nm[i]

    def as_document(self) -> dict[str, Any]:
        """As JSON can carry it; `profile_from_document` is the inverse."""
        return {
            "replays": self.replays,
            "pass_s": self.pass_s,
            "mean_nm": np.round(self.mean_nm, 2).tolist(),
            "spread_nm": np.round(self.spread_nm, 2).tolist(),
        }


def profile_from_document(document: dict[str, Any]) -> TorqueProfile:
    """The profile from such a document."""
    return TorqueProfile(
        replays=int(document["replays"]),
        pass_s=float(document["pass_s"]),
        mean_nm=np.array(document["mean_nm"], dtype=float),
        spread_nm=np.array(document["spread_nm"], dtype=float),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BandBasis:
    """What was learnt of an arm; nothing by default."""

    model: CompensatedModel | None = None  # of this arm with this load
    profile: TorqueProfile | None = None  # of the trajectory that is played, with this model
    payload_kg: float | None = None  # with which the model was learnt; None: not known

    @property
    def description(self) -> str:
        """What the band is made of, for a message."""
        if self.model is None:
            return "the manufacturer's parameters"
        learnt = "" if self.profile is None else f" and the profile of {self.profile.replays} earlier ones"
        return f"the model of {self.model.revision} replays{learnt}"

    def as_document(self) -> dict[str, Any]:
        """As JSON can carry it; `basis_from_document` is the inverse."""
        return {
            "model": None if self.model is None else self.model.as_document(),
            "payload_kg": self.payload_kg,
            "profile": None if self.profile is None else self.profile.as_document(),
        }


def basis_from_document(document: dict[str, Any]) -> BandBasis:
    """The basis from such a document. Raises BadInput where its model is none."""
    return BandBasis(
        model=None if document["model"] is None else model_from_document(document["model"]),
        payload_kg=document["payload_kg"],
        profile=None if document["profile"] is None else profile_from_document(document["profile"]),
    )
