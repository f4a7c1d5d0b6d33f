"""Settings of the alerts, and which combinations of them are valid."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval

from monitor.errors import BadConfiguration
from monitor.judge.bounds import check_bounds
from monitor.recording import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthSettings:
    """When alerts are raised and cleared. A rise is a fraction of the friction torque at the beginning."""

    advisory_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.01
    wear_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.05
    limit_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.30
    false_alarms_per_year: Annotated[float, Interval(ge=1e-4, le=10.0)] = (
        0.05  # advisories a year that a healthy arm may cause by chance; it determines the evidence that an advisory requires
    )
    wear_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95  # required probability of a rise above wear_rise
    limit_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95  # required probability of a rise above limit_rise
    min_replays: Annotated[int, Interval(ge=1, le=100)] = 3  # a condition must appear in so many consecutive replays
    min_days: Annotated[int, Interval(ge=1, le=100)] = 2  # these consecutive replays must lie on at least so many UTC days
    clear_fraction: Annotated[float, Interval(gt=0.0, lt=1.0)] = (
        0.6  # of a tier's rise, below which the tier is left; less than 1, so that an alert does not flap
    )
    update_step: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.02  # an active alert is updated when its change has moved by so much
    common_share: Annotated[float, Interval(ge=1e-6, le=1.0)] = (
        2.0 / 3.0
    )  # share of the joints that must change together for a common change
    common_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.9  # required probability that such a joint has changed
    stale_days: Annotated[float, Interval(ge=0.01, le=3650.0)] = 7.0  # a joint is stale after so long without a replay that updated it
    contradiction_sigma: Annotated[float, Interval(ge=2.0, le=100.0)] = (
        8.0  # standard deviations by which masses must differ from those of earlier replays to contradict them
    )
    contradiction_kg: Annotated[float, Interval(ge=0.01, le=100.0)] = (
        0.2  # smallest difference that is reported as a payload: it raises friction of the shoulder by about advisory_rise
    )
    learning_replays: Annotated[int, Interval(ge=0, le=1000)] = 10  # before so many replays a new temperature is not OFF_SPEC

    def __post_init__(self) -> None:
        """Raises BadConfiguration where a figure is out of its bounds, or the rises of the tiers are out of order."""
        check_bounds(self, "health")
        if not self.advisory_rise < self.wear_rise < self.limit_rise:
            raise BadConfiguration("health: expected 0 < advisory_rise < wear_rise < limit_rise")

    @property
    def rises(self) -> Array:
        """(3,) rise of each tier."""
        return np.array([self.advisory_rise, self.wear_rise, self.limit_rise])
