"""One replay as the filter sees it: friction torque at the reference speed, and the joints' temperatures."""

from typing import NamedTuple

import numpy as np

from monitor.identify.identification import Identification
from monitor.judge.drift.settings import DriftSettings
from monitor.recording import Array

POSSIBLE_C = (-20.0, 100.0)  # [°C] of a joint that works; beyond it the sensor is wrong
VISCOUS_SHARE = 0.4  # assumed where a joint is not resolved
VISCOUS_SHARES = (0.05, 0.95)  # the fit's share is clipped to these: every joint has friction of both kinds


class Observation(NamedTuple):
    """One replay of N joints, (N,) each."""

    log_torque: Array  # y = log F, F the friction torque at the reference speed [N·m]; NaN where the joint was not resolved
    variance: Array  # of y, within the replay
    temperature_c: Array  # NaN where unknown
    viscous_share: Array  # of F
    warming_k_per_min: Array  # NaN where unknown
    coulomb_nm: Array  # fc of the fit, at the replay's temperature, for the temperature laws; NaN where unknown
    viscous_nm_s_per_rad: Array  # fv, likewise


def observe(identification: Identification, settings: DriftSettings) -> Observation:
    """The observation of an identified replay. A joint is resolved where it moved fast enough and its friction is certain enough."""
    v = settings.reference_speed_rad_s
    torque, std = identification.friction_at(v)
    resolved = (torque > 0) & (std <= settings.resolution * np.abs(torque)) & (identification.max_speed_rad_s >= v)
    resolved &= np.isfinite(torque) & np.isfinite(std)
    F = np.where(resolved, torque, 1.0)
    unknown = np.full(len(F), np.nan)
    measured = unknown if identification.temperature_c is None else identification.temperature_c
    warming = unknown if identification.warming_k_per_min is None else identification.warming_k_per_min
    # one replay at 1000 °C would bend a joint's temperature law permanently
    possible = (measured >= POSSIBLE_C[0]) & (measured <= POSSIBLE_C[1])
    share = np.where(resolved, identification.viscous_nm_s_per_rad * v / F, VISCOUS_SHARE)
    return Observation(
        log_torque=np.where(resolved, np.log(F), np.nan),
        variance=np.where(resolved, (std / F) ** 2, np.nan),  # Var log F ≈ Var F / F²
        temperature_c=np.where(possible, measured, np.nan),
        viscous_share=np.clip(share, *VISCOUS_SHARES),
        warming_k_per_min=np.where(possible, warming, np.nan),
        coulomb_nm=identification.coulomb_nm,
        viscous_nm_s_per_rad=identification.viscous_nm_s_per_rad,
    )
