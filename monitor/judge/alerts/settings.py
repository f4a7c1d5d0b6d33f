"""Settings of the alerts: when to speak."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval

from monitor.errors import BadConfiguration
from monitor.recording import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthSettings:
    """When to speak. Rises are fractions of the friction torque at the beginning."""

    advisory_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.01
    wear_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.05
    limit_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.30
    false_alarms_per_year: Annotated[float, Interval(ge=1e-4, le=10.0)] = (
        0.05  # advisories of a healthy arm: how much evidence they ask for
    )
    wear_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95
    limit_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95
    min_replays: Annotated[int, Interval(ge=1, le=100)] = 3
    min_days: Annotated[int, Interval(ge=1, le=100)] = 2
    clear_fraction: Annotated[float, Interval(gt=0.0, lt=1.0)] = (
        0.6  # of a tier's rise: lower than the raising level, so that an alert does not flap
    )
    update_step: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.02  # an active alert is told again when its change has moved by so much
    common_share: Annotated[float, Interval(ge=1e-6, le=1.0)] = 2.0 / 3.0  # of the joints rising together …
    common_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.9  # … each with this probability, are no wear
    stale_days: Annotated[float, Interval(ge=0.01, le=3650.0)] = 7.0  # without a replay that taught something for so long, a joint is STALE
    contradiction_sigma: Annotated[float, Interval(ge=2.0, le=100.0)] = (
        8.0  # masses that differ by so much from those before contradict them …
    )
    contradiction_kg: Annotated[float, Interval(ge=0.01, le=100.0)] = 0.5  # … a payload by at least so much
    learning_replays: Annotated[int, Interval(ge=0, le=1000)] = 10  # until then a new temperature is learning, not OFF_SPEC

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the figure that is out of order."""
        if not 0 < self.advisory_rise < self.wear_rise < self.limit_rise:
            raise BadConfiguration("health: expected 0 < advisory_rise < wear_rise < limit_rise")
        for name in ("wear_sure", "limit_sure", "common_sure"):
            if not 0.5 <= getattr(self, name) < 1:
                raise BadConfiguration(f"health.{name} = {getattr(self, name)!r}; expected a probability from 0.5 to below 1")
        if not 0 < self.clear_fraction < 1:
            raise BadConfiguration(f"health.clear_fraction = {self.clear_fraction!r}; expected a fraction between 0 and 1")
        if self.min_replays < 1 or self.min_days < 1:
            raise BadConfiguration("health.min_replays and min_days: expected 1 or more")

    @property
    def rises(self) -> Array:
        """(3,) of the tiers."""
        return np.array([self.advisory_rise, self.wear_rise, self.limit_rise])
