"""Settings of the drift filter: how friction is expected to vary in a healthy joint, and when a change is detected."""

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Interval

from monitor.judge.bounds import NO_KEY, check_bounds
from monitor.judge.drift.prior import FleetPrior


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """How friction varies from replay to replay and with time. F is the friction torque at the reference speed, y = log F."""

    # friction at much lower speeds is stiction, and at much higher ones few trajectories reach it
    reference_speed_rad_s: Annotated[float, Interval(ge=0.2, le=0.6)] = 0.4  # F repeats to 1.3–2.3 % here, where fv alone scatters 4–10 %
    between_std: Annotated[float, Interval(ge=1e-6, le=0.5)] = 0.02  # [log] prior noise between replays
    autocorrelation: Annotated[float, Interval(ge=0.0, le=0.95)] = 0.5  # prior correlation of the noise of successive replays
    pace_walk_per_sqrt_day: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.001  # random walk of the wear rate, as a fraction of it
    onsets_per_year: Annotated[float, Interval(ge=0.0, le=12.0)] = 0.3  # prior rate at which joints begin to wear, for undetected changes
    resolution: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.25  # a larger standard deviation, as a fraction of F, is not resolved
    grease_lag_min: Annotated[float, Interval(ge=0.0, le=60.0)] = 5.0  # [min] prior lag of the grease behind the motor's sensor
    baseline_replays: Annotated[int, Interval(ge=1, le=1000)] = 6  # a change among a joint's first replays belongs to its baseline
    settle_replays: Annotated[int, Interval(ge=0, le=1000)] = 20  # T0 is the mean temperature of so many first replays
    unknown_temperature_c: Annotated[float, Interval(ge=-20.0, le=80.0)] = 25.0  # stands in for an unknown temperature …
    unknown_temperature_std_k: Annotated[float, Interval(ge=1e-6, le=50.0)] = 6.0  # … with this standard deviation

    # of a fleet of this model, from the file that the key names; None: that of the robot family
    prior: FleetPrior | None = field(default=None, metadata=NO_KEY)

    # what the arm teaches, what its sensors' resolution decides, and thresholds; only tests and studies change them
    between_replays: float = field(default=5.0, metadata=NO_KEY)  # [replays] weight of the prior noise between replays
    # [log] least noise that is assumed: temperatures have a resolution of 1/16 K, and friction is not constant
    between_floor: float = field(default=0.003, metadata=NO_KEY)
    caution: float = field(default=0.4, metadata=NO_KEY)  # noise estimated from n replays is multiplied by 1 + caution/√n
    memory_replays: float = field(default=300.0, metadata=NO_KEY)  # [replays] over which the noise is averaged
    autocorrelation_max: float = field(default=0.95, metadata=NO_KEY)  # largest that is assumed, so that the filter still learns
    rate_std_per_day: float = field(default=1e-5, metadata=NO_KEY)  # prior wear rate of a healthy joint; larger ones are detected
    rate_walk_per_sqrt_day: float = field(default=1e-6, metadata=NO_KEY)  # random walk of the wear rate
    wear_walk_per_sqrt_day: float = field(default=1e-4, metadata=NO_KEY)  # [log] random walk of wear: 0.2 % in a year
    gate_sigma: float = field(default=4.0, metadata=NO_KEY)  # a replay further from its prediction is an outlier …
    gate_run: int = field(default=3, metadata=NO_KEY)  # … and so many in a row on one side are a step
    # threshold of a step one replay ago; n replays ago it is √(shift_sigma² − 2·ln n), and less from 20 on, see `thresholds`
    shift_sigma: float = field(default=5.15, metadata=NO_KEY)
    pace_sigma: float = field(default=4.95, metadata=NO_KEY)  # the same for a new wear rate, from 20 replays on
    unseen_pace_std_per_day: float = field(default=8e-4, metadata=NO_KEY)  # prior of an undetected wear rate, 30 % a year …
    unseen_step_std: float = field(default=0.05, metadata=NO_KEY)  # … and of an undetected step [log]
    grease_lag_std_min: float = field(default=12.0, metadata=NO_KEY)  # [min] standard deviation of grease_lag_min: up to half an hour
    uneven_share: float = field(default=0.35, metadata=NO_KEY)  # share of the lag's effect that stays uncertain: heat has several lags

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the field that is out of its bounds."""
        check_bounds(self, "drift")
