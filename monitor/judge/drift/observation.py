"""What one replay says of every joint's friction, as the filter sees it, and the settings of filter and evidence."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Interval

from monitor.errors import BadConfiguration
from monitor.identify.identification import Identification
from monitor.recording import Array

POSSIBLE_C = (-20.0, 100.0)  # of a joint that works: beyond, its sensor is wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """How friction is expected to move when nothing, or something, is wrong."""

    reference_speed_rad_s: Annotated[float, Interval(ge=0.05, le=3.0)] = 0.4  # F here repeats to 1.3–2.3 % where fv alone scatters 4–10 %
    between_std: Annotated[float, Interval(ge=1e-6, le=0.5)] = 0.02  # fraction, replay to replay, until the history tells better
    between_replays: Annotated[float, Interval(ge=1e-6, le=1e4)] = (
        15.0  # how many replays that belief is worth: real joints scatter by 1.3–2.3 %
    )
    between_floor: Annotated[float, Interval(ge=1e-6, le=0.1)] = (
        0.003  # no history makes us surer than this: temperatures come in 1/16 K and friction is no constant
    )
    alike_replays: Annotated[float, Interval(ge=0.0, le=1e4)] = (
        40.0  # the joints of one arm are alike in noise: each is drawn so strongly to their mean
    )
    caution: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.4  # noise that n replays have told is taken for 1 + caution/√n times as much
    memory_replays: Annotated[float, Interval(ge=2.0, le=1e5)] = 300.0  # the noise of long ago is forgotten
    autocorrelation: Annotated[float, Interval(ge=0.0, le=0.95)] = 0.5  # of the noise of successive replays, at first; then learnt
    autocorrelation_max: Annotated[float, Interval(ge=0.0, le=0.95)] = 0.8
    rate_std_per_day: Annotated[float, Interval(ge=1e-6, le=0.1)] = 1e-5  # of a joint that is well; a pace beyond it is found as a change
    rate_walk_per_sqrt_day: Annotated[float, Interval(ge=0.0, le=0.01)] = (
        1e-6  # a pace once found changes by so much; more is found as another change
    )
    pace_walk_per_sqrt_day: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.001  # fraction of its own by which a pace of wear wanders
    wear_walk_per_sqrt_day: Annotated[float, Interval(ge=0.0, le=0.01)] = 1e-4  # 0.2 % in a year by chance
    gate_sigma: Annotated[float, Interval(ge=2.0, le=20.0)] = 4.0  # one replay further off than this is not learnt from …
    gate_run: Annotated[int, Interval(ge=2, le=20)] = 3  # … so many in a row on one side are a step
    shift_sigma: Annotated[float, Interval(ge=2.0, le=20.0)] = (
        5.07  # likelihood ratio from which a step one replay ago is believed, in σ; n ago, of √(5.07² − 2·ln n) σ
    )
    pace_sigma: Annotated[float, Interval(ge=2.0, le=20.0)] = 4.85  # the same for a pace of wear; from 20 replays on
    onsets_per_year: Annotated[float, Interval(ge=0.0, le=12.0)] = (
        0.3  # of a joint's wear, as the ± of wear supposes before evidence shows any …
    )
    unseen_pace_std_per_day: Annotated[float, Interval(ge=1e-6, le=0.1)] = 8e-4  # … at a pace about as large, 30 % a year
    unseen_step_std: Annotated[float, Interval(ge=1e-4, le=1.0)] = 0.05  # … or at once
    resolution: Annotated[float, Interval(ge=1e-6, le=1.0)] = (
        0.25  # a replay whose own std is a larger fraction of F says nothing of that joint
    )
    grease_lag_min: Annotated[float, Interval(ge=0.0, le=60.0)] = 3.0  # the grease follows the motor's sensor by about so many minutes …
    grease_lag_std_min: Annotated[float, Interval(ge=0.0, le=60.0)] = 1.5  # … give or take, until this arm has told
    uneven_share: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.35  # of what the lag explains stays in doubt: heat is no single lag
    baseline_replays: Annotated[int, Interval(ge=1, le=1000)] = 6  # a change among a joint's first so many is of its baseline, not its wear
    settle_replays: Annotated[int, Interval(ge=0, le=1000)] = 20  # T0 is the mean temperature of the first so many replays
    unknown_temperature_c: Annotated[float, Interval(ge=-20.0, le=80.0)] = 25.0  # stands in where nothing measured it …
    unknown_temperature_std_k: Annotated[float, Interval(ge=1e-6, le=50.0)] = 6.0  # … with this doubt

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the figure that is out of its range."""
        if not 0.2 <= self.reference_speed_rad_s <= 0.6:
            raise BadConfiguration(f"drift.reference_speed_rad_s = {self.reference_speed_rad_s!r}; expected 0.2 to 0.6 rad/s")
        for name in (
            "between_std",
            "between_floor",
            "between_replays",
            "memory_replays",
            "rate_std_per_day",
            "gate_sigma",
            "shift_sigma",
            "resolution",
        ):
            if not getattr(self, name) > 0:
                raise BadConfiguration(f"drift.{name} = {getattr(self, name)!r}; expected a positive number")
        for name in ("rate_walk_per_sqrt_day", "wear_walk_per_sqrt_day"):
            if not getattr(self, name) > 0:
                raise BadConfiguration(f"drift.{name} = {getattr(self, name)!r}; expected a positive number: silence must cost certainty")
        if not 0 <= self.autocorrelation <= self.autocorrelation_max < 1:
            raise BadConfiguration(f"drift.autocorrelation = {self.autocorrelation!r}; expected 0 ≤ it ≤ autocorrelation_max < 1")
        if self.gate_run < 2:
            raise BadConfiguration(f"drift.gate_run = {self.gate_run!r}; expected 2 or more")


class Observation(NamedTuple):
    """One replay as the filter sees it, (J,) each; NaN in `log_torque` where a joint was not resolved."""

    log_torque: Array
    variance: Array  # of log_torque, within the replay
    temperature_c: Array  # NaN where unknown
    viscous_share: Array  # of the torque at the reference speed
    warming_k_per_min: Array  # NaN where unknown
    coulomb_nm: Array  # fc of the fit, at the replay's temperature; NaN where unknown: the temperature laws learn from it
    viscous_nm_s_per_rad: Array  # fv, likewise


def observe(identification: Identification, settings: DriftSettings) -> Observation:
    """The logarithm of friction torque at the reference speed, of every joint that moved and is resolved."""
    v = settings.reference_speed_rad_s
    torque, std = identification.friction_at(v)
    resolved = (torque > 0) & (std <= settings.resolution * np.abs(torque)) & (identification.max_speed_rad_s >= v)
    resolved &= np.isfinite(torque) & np.isfinite(std)
    F = np.where(resolved, torque, 1.0)
    unknown = np.full(len(F), np.nan)
    told = unknown if identification.temperature_c is None else identification.temperature_c
    # one replay at 1000 °C would bend a joint's temperature law for good
    believable = (told >= POSSIBLE_C[0]) & (told <= POSSIBLE_C[1])
    return Observation(
        log_torque=np.where(resolved, np.log(F), np.nan),
        variance=np.where(resolved, (std / F) ** 2, np.nan),  # Var log F ≈ Var F / F²
        temperature_c=np.where(believable, told, np.nan),
        warming_k_per_min=unknown
        if identification.warming_k_per_min is None
        else np.where(believable, identification.warming_k_per_min, np.nan),
        viscous_share=np.clip(np.where(resolved, identification.viscous_nm_s_per_rad * v / F, 0.4), 0.05, 0.95),
        coulomb_nm=identification.coulomb_nm,
        viscous_nm_s_per_rad=identification.viscous_nm_s_per_rad,
    )
