"""Which rows of work count, how long they count, and how well friction must be known."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval

from monitor.identify.identification import BETWEEN_RUNS


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductionSettings:
    """How work becomes an estimate of friction."""

    # fraction of friction: one standard deviation at which a joint counts as known
    deviation: Annotated[float, Interval(ge=0.005, le=0.5)] = 0.05
    period_days: Annotated[float, Interval(ge=0.04, le=90.0)] = 7.0  # older information is left out of an estimate
    temperature_bin_k: Annotated[float, Interval(ge=1.0, le=50.0)] = 5.0  # sums are kept apart by the arm's mean temperature …
    temperature_range_k: Annotated[float, Interval(ge=1.0, le=50.0)] = 10.0  # … and one estimate takes bins that are together so wide
    min_speed_rad_s: Annotated[float, Interval(ge=0.02, le=1.0)] = 0.05  # a slower joint's rows do not count: pre-sliding
    max_acceleration_rad_s2: Annotated[float, Interval(ge=0.5, le=100.0)] = 6.0  # nor those of a faster start or stop
    reference_speed_rad_s: Annotated[float, Interval(ge=0.05, le=3.0)] = 0.4  # v* of F(v*)
    load_std_kg: Annotated[float, Interval(ge=0.0, le=5.0)] = 0.1  # by which a declared payload is wrong, one σ
    # fraction of friction by which it differs from run to run of real arms, one σ: it counts as far as the arm's own days do not tell
    between_runs: Annotated[float, Interval(ge=0.0, le=0.2)] = BETWEEN_RUNS
    undeclared_kg: Annotated[float, Interval(ge=0.05, le=50.0)] = (
        0.4  # … that is left out, of a load that nobody declared; on small arms less
    )
    contact_n: Annotated[float, Interval(ge=1.0, le=1000.0)] = 25.0  # of TCP force beyond what is usual in the window: contact
