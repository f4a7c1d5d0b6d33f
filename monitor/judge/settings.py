"""The settings of an assessment: those of every room that a recording passes on its way to a verdict."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval

from monitor.errors import BadConfiguration
from monitor.identify.settings import IdentifySettings, QualitySettings
from monitor.judge.bounds import check_bounds
from monitor.judge.friction.settings import DriftSettings
from monitor.judge.temperature.laws import TemperatureSettings
from monitor.recording import Array

if TYPE_CHECKING:
    from monitor.judge.friction.step import FrictionModel


@dataclass(frozen=True, slots=True, kw_only=True)
class PrognosisSettings:
    """The limit, and the evidence that a prediction requires."""

    limit_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.30  # of friction above that at the beginning, as a fraction
    service_days: Annotated[float, Interval(ge=1.0, le=3650.0)] = 90.0  # until the next service
    trend_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95  # probability of a positive rate below which no date is given

    def __post_init__(self) -> None:
        """Raises BadConfiguration where a figure is out of its bounds."""
        check_bounds(self, "prognosis")


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSettings:
    """Which samples of normal work count, and what they must show to ask for a replay."""

    min_speed_rad_s: Annotated[float, Interval(ge=0.01, le=3.0)] = 0.1  # below it pre-sliding hides the direction of friction
    max_acceleration_rad_s2: Annotated[float, Interval(ge=0.1, le=100.0)] = 3.0  # above it the inertia of unknown loads hides friction
    span_s: Annotated[float, Interval(ge=60.0, le=86400.0)] = 3600.0  # of motion of one joint that make one observation
    min_samples: Annotated[int, Interval(ge=10, le=1_000_000)] = 200  # a span with fewer samples makes no observation
    deviation: Annotated[float, Interval(ge=0.01, le=1.0)] = 0.08  # standard deviation of one observation, as a fraction of friction
    baseline_observations: Annotated[int, Interval(ge=1, le=100)] = 3  # observations after a replay that make the baseline
    rise: Annotated[float, Interval(ge=0.01, le=10.0)] = 0.10  # above the baseline that asks for a replay, as a fraction of friction …
    sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.99  # … where friction has risen with this probability …
    min_observations: Annotated[int, Interval(ge=1, le=100)] = 3  # … and so many observations in a row are above that rise


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthSettings:
    """When alerts are raised and cleared. A rise is a fraction of the friction torque at the beginning."""

    advisory_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.02
    wear_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.05
    limit_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.30
    false_alarms_per_year: Annotated[float, Interval(ge=1e-4, le=10.0)] = (
        0.25  # bound on the advisories a year that a sound arm may cause by chance; in fact a third of it
    )
    wear_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95  # required probability of a rise above wear_rise
    limit_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95  # required probability of a rise above limit_rise
    min_replays: Annotated[int, Interval(ge=1, le=100)] = (
        3  # a doubt in data or declarations must appear in so many consecutive replays, and so many judge work on a joint
    )
    min_days: Annotated[int, Interval(ge=1, le=100)] = 2  # these consecutive replays must lie on at least so many UTC days
    clear_fraction: Annotated[float, Interval(gt=0.0, lt=1.0)] = (
        0.6  # of a tier's rise, below which the tier is left; less than 1, so that an alert does not flap
    )
    update_step: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.02  # an active alert is updated when its change has moved by so much
    common_share: Annotated[float, Interval(ge=1e-6, le=1.0)] = (
        2.0 / 3.0
    )  # share of the joints that must change together for a common change
    stale_days: Annotated[float, Interval(ge=0.01, le=3650.0)] = 7.0  # a joint is stale after so long without a replay that updated it
    contradiction_sigma: Annotated[float, Interval(ge=2.0, le=100.0)] = (
        8.0  # standard deviations by which masses must differ from those of earlier replays to contradict them
    )
    contradiction_kg: Annotated[float, Interval(ge=0.01, le=100.0)] = (
        0.2  # smallest difference that is reported as a payload: it raises friction of the shoulder by about advisory_rise
    )
    learning_replays: Annotated[int, Interval(ge=0, le=1000)] = 10  # in so many first ones no change is told, no temperature is OFF_SPEC

    def __post_init__(self) -> None:
        """Raises BadConfiguration where a figure is out of its bounds, or the rises of the tiers are out of order."""
        check_bounds(self, "health")
        if not self.advisory_rise < self.wear_rise < self.limit_rise:
            raise BadConfiguration("health: expected 0 < advisory_rise < wear_rise < limit_rise")

    @property
    def rises(self) -> Array:
        """(3,) rise of each tier."""
        return np.array([self.advisory_rise, self.wear_rise, self.limit_rise])


@dataclass(frozen=True, slots=True, kw_only=True)
class AssessSettings:
    """The settings of every room that a recording passes."""

    method: str = "wls"
    quality: QualitySettings = field(default_factory=QualitySettings)
    identify: IdentifySettings = field(default_factory=IdentifySettings)
    drift: DriftSettings = field(default_factory=DriftSettings)
    temperature: TemperatureSettings = field(default_factory=TemperatureSettings)
    health: HealthSettings = field(default_factory=HealthSettings)
    prognosis: PrognosisSettings = field(default_factory=PrognosisSettings)
    residual: ResidualSettings = field(default_factory=ResidualSettings)

    @property
    def friction(self) -> "FrictionModel":
        """The model of friction with these settings, the fleet's prior among them."""
        from monitor.judge.friction.of_settings import friction_model  # with SciPy: a configuration is read without it

        health = self.health
        return friction_model(
            self.drift,
            self.temperature,
            false_alarms_per_year=health.false_alarms_per_year,
            least=float(np.log1p(health.advisory_rise)),
            cleared=health.clear_fraction,
            most=health.common_share,
            learning_replays=health.learning_replays,
        )
