"""The settings of identification: how recordings and rows of production become motions, and motions parameters."""

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Interval

from monitor.model.friction import STANDSTILL_SPEED_RAD_S

PLACE_RAD = 0.1  # width of a place along a joint: wear of a tooth or a ball is as narrow, and a replay passes it in many samples


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSettings:
    """How a recording becomes a motion."""

    # [Hz] above the excitation's harmonics, below the ripple of the drives and the encoder's noise after differentiation
    cutoff_hz: Annotated[float, Interval(ge=0.5, le=50.0)] = 8.0
    filter_order: Annotated[int, Interval(ge=1, le=6)] = 2  # once forward, once backward: 4 in effect
    trim_s: Annotated[float, Interval(ge=0.0, le=5.0)] = 0.2  # [s] cut at each end, where the filter extrapolates the signal
    # [s] of motion at the beginning that are left out: after rest, friction is 3–5 % higher, and falls with a time constant of 10–20 s
    run_in_s: Annotated[float, Interval(ge=0.0, le=600.0)] = 0.0
    gap_s: Annotated[float, Interval(ge=1e-6, le=5.0)] = 0.25  # [s] the motion within a longer hole is unknown, so no spline bridges it
    min_rate_hz: Annotated[float, Interval(ge=5.0, le=500.0)] = 10.0  # [Hz] at a lower rate, q̈ from differences has no meaning
    min_duration_s: Annotated[float, Interval(ge=2.0, le=600.0)] = 5.0  # [s] half a period of the paper's excitation
    min_speed_rad_s: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.05  # [rad/s] a joint that is never faster does not move
    min_moving_share: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.5  # fraction of the joints that must move
    despike: bool = False  # replace single readings of current and torque that are spikes
    # fraction of the rows: where more rows are torn, the other rows are not reliable either
    max_rejected_share: Annotated[float, Interval(ge=0.0, le=0.9)] = 0.2


BETWEEN_RUNS = 0.015  # of friction: temperature, rest and grease differ from run to run; friction of real arms repeats to 1.3–2.3 %


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifySettings:
    """How a motion becomes parameters."""

    signals: SignalSettings = field(default_factory=SignalSettings)
    # [rad/s] a joint's slower samples are not fitted by WLS, nor counted in the RMS
    moving_rad_s: Annotated[float, Interval(ge=1e-6, le=0.5)] = STANDSTILL_SPEED_RAD_S
    # [s] length of the jackknife's blocks: longer than the correlation of residuals (0.4–0.55 s), and short, so that there are many
    block_s: Annotated[float, Interval(ge=0.1, le=10.0)] = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class QualitySettings:
    """How much a replay may have been disturbed and still be used."""

    max_missed_share: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.02  # fraction of the ticks; alone on two cores none are missed
    # fraction of the cycles whose target came late by half a tick; 3 % have no effect, with 30 % fc was 20 % off
    max_late_share: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.1
    max_slipped_s: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.1  # [s] delay behind the trajectory; with more it is another trajectory
    min_speed_scaling: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.999  # the speed slider; with less it is another trajectory


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
