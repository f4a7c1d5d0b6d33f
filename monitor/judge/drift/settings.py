"""Settings of the drift filter: how friction is expected to vary in a healthy joint, and when a change is detected."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Interval

from monitor.errors import BadConfiguration
from monitor.judge.bounds import check_bounds
from monitor.judge.drift.prior import FleetPrior

_LEARNT = "the monitor learns it from the arm; the value stands in until it has"
_WITHOUT_EFFECT = "it has no effect any more: how alike the joints are is learnt from them"
_OF_SENSORS = "the resolution of the arm's sensors decides it"
_THRESHOLD = "[health] false_alarms_per_year says how rare false alerts must be"


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """How friction varies from replay to replay and with time. F is the friction torque at the reference speed, y = log F."""

    # friction at much lower speeds is stiction, and at much higher ones few trajectories reach it
    reference_speed_rad_s: Annotated[float, Interval(ge=0.2, le=0.6)] = 0.4  # F repeats to 1.3–2.3 % here, where fv alone scatters 4–10 %
    between_std: Annotated[float, Interval(ge=1e-6, le=0.5)] = 0.02  # [log] prior noise between replays
    between_replays: Annotated[float, Interval(ge=1e-6, le=1e4)] = 5.0  # [replays] weight of that prior
    between_floor: Annotated[float, Interval(ge=1e-6, le=0.1)] = (
        0.003  # [log] least noise that is assumed: temperatures have a resolution of 1/16 K, and friction is not constant
    )
    alike_replays: Annotated[float, Interval(ge=0.0, le=1e4)] = (
        40.0  # [replays] weight of the arm's mean noise in each joint's: the joints of an arm have similar noise
    )
    caution: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.4  # noise estimated from n replays is multiplied by 1 + caution/√n
    memory_replays: Annotated[float, Interval(ge=2.0, le=1e5)] = 300.0  # [replays] over which the noise is averaged
    autocorrelation: Annotated[float, Interval(ge=0.0, le=0.95)] = 0.5  # prior correlation of the noise of successive replays
    autocorrelation_max: Annotated[float, Interval(ge=0.0, le=0.95)] = 0.95  # largest that is assumed, so that the filter still learns
    rate_std_per_day: Annotated[float, Interval(ge=1e-6, le=0.1)] = 1e-5  # prior wear rate of a healthy joint; larger ones are detected
    rate_walk_per_sqrt_day: Annotated[float, Interval(gt=0.0, le=0.01)] = 1e-6  # random walk of the wear rate
    pace_walk_per_sqrt_day: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.001  # the same as a fraction of the wear rate
    wear_walk_per_sqrt_day: Annotated[float, Interval(gt=0.0, le=0.01)] = 1e-4  # [log] random walk of wear: 0.2 % in a year
    gate_sigma: Annotated[float, Interval(ge=2.0, le=20.0)] = 4.0  # a replay further from its prediction is an outlier …
    gate_run: Annotated[int, Interval(ge=2, le=20)] = 3  # … and so many in a row on one side are a step
    shift_sigma: Annotated[float, Interval(ge=2.0, le=20.0)] = (
        5.15  # threshold of a step one replay ago; n replays ago it is √(shift_sigma² − 2·ln n), and less from 20 on, see `thresholds`
    )
    pace_sigma: Annotated[float, Interval(ge=2.0, le=20.0)] = 4.95  # the same for a new wear rate, from 20 replays on
    onsets_per_year: Annotated[float, Interval(ge=0.0, le=12.0)] = 0.3  # prior rate at which joints begin to wear, for undetected changes
    unseen_pace_std_per_day: Annotated[float, Interval(ge=1e-6, le=0.1)] = 8e-4  # prior of their wear rate, 30 % a year …
    unseen_step_std: Annotated[float, Interval(ge=1e-4, le=1.0)] = 0.05  # … and of their step [log]
    resolution: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.25  # a larger standard deviation, as a fraction of F, is not resolved
    grease_lag_min: Annotated[float, Interval(ge=0.0, le=60.0)] = 5.0  # [min] prior lag of the grease behind the motor's sensor …
    grease_lag_std_min: Annotated[float, Interval(ge=0.0, le=60.0)] = 12.0  # … and its standard deviation: up to half an hour
    uneven_share: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.35  # share of the lag's effect that stays uncertain: heat has several lags
    baseline_replays: Annotated[int, Interval(ge=1, le=1000)] = 6  # a change among a joint's first replays belongs to its baseline
    settle_replays: Annotated[int, Interval(ge=0, le=1000)] = 20  # T0 is the mean temperature of so many first replays
    unknown_temperature_c: Annotated[float, Interval(ge=-20.0, le=80.0)] = 25.0  # stands in for an unknown temperature …
    unknown_temperature_std_k: Annotated[float, Interval(ge=1e-6, le=50.0)] = 6.0  # … with this standard deviation

    prior: FleetPrior | None = None  # of a fleet of this model, from the file that the key names; None: that of the robot family

    # keys that older files may have: they are read, with a notice that says why they are not documented any more
    retired: ClassVar[Mapping[str, str]] = {
        "between_floor": _OF_SENSORS,
        "between_replays": _LEARNT,
        "alike_replays": _WITHOUT_EFFECT,
        "caution": _LEARNT,
        "memory_replays": _LEARNT,
        "autocorrelation_max": _LEARNT,
        "rate_std_per_day": _LEARNT,
        "rate_walk_per_sqrt_day": _LEARNT,
        "wear_walk_per_sqrt_day": _LEARNT,
        "unseen_pace_std_per_day": _LEARNT,
        "unseen_step_std": _LEARNT,
        "grease_lag_std_min": _LEARNT,
        "uneven_share": _LEARNT,
        "gate_sigma": _THRESHOLD,
        "gate_run": _THRESHOLD,
        "shift_sigma": _THRESHOLD,
        "pace_sigma": _THRESHOLD,
    }

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the field that is out of its bounds, or an autocorrelation above its maximum."""
        check_bounds(self, "drift")
        if not self.autocorrelation <= self.autocorrelation_max:
            raise BadConfiguration(f"drift.autocorrelation = {self.autocorrelation!r}; expected 0 ≤ it ≤ autocorrelation_max < 1")
