"""What was learnt of one arm for its torque band: its model, and what earlier replays needed along the trajectory. Values only.

The process that watches a motion only hands it on, so nothing here loads a model.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BandBasis:
    """What was learnt of an arm; nothing by default."""

    model: dict[str, Any] | None = None  # `CompensatedModel.as_document` of this arm with this load
    profile: TorqueProfile | None = None  # of the trajectory that is played, with this model
    payload_kg: float | None = None  # with which the model was learnt; None: not known

    @property
    def description(self) -> str:
        """What the band is made of, for a message."""
        if self.model is None:
            return "the manufacturer's parameters"
        learnt = "" if self.profile is None else f" and the profile of {self.profile.replays} earlier ones"
        return f"the model of {self.model['revision']} replays{learnt}"
