"""How friction is observed, and how it is expected to vary in a sound joint; every other number is in `FrictionModel`."""

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Interval

from monitor.judge.bounds import NO_KEY, check_bounds
from monitor.judge.friction.prior import FleetPrior, WearPrior


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """How friction varies from replay to replay and with time. F is the friction torque at the reference speed, y = log F."""

    # friction at much lower speeds is stiction, and at much higher ones few trajectories reach it
    reference_speed_rad_s: Annotated[float, Interval(ge=0.2, le=0.6)] = 0.4  # F repeats to 1.3–2.3 % here, where fv alone scatters 4–10 %
    between_std: Annotated[float, Interval(ge=1e-6, le=0.5)] = 0.02  # [log] prior noise between replays
    onsets_per_year: Annotated[float, Interval(ge=0.0, le=100.0)] = (
        10.0  # how often a joint may have changed unnoticed, for what a person reads; alerts do not depend on it
    )
    resolution: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.25  # a larger standard deviation, as a fraction of F, is not resolved
    baseline_replays: Annotated[int, Interval(ge=1, le=1000)] = 6  # of which an alert's attribution takes the mean

    # of a fleet of this model, from the file that the key names; None: that of the robot family
    prior: FleetPrior | None = field(default=None, metadata=NO_KEY)

    @property
    def wear_prior(self) -> WearPrior | None:
        """What the fleet says of joints that wear."""
        return None if self.prior is None else self.prior.wear

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the field that is out of its bounds."""
        check_bounds(self, "drift")
