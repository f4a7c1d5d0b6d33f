"""One replay as the filter sees it: friction torque at the reference speed, and the joints' temperatures."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from monitor.judge.friction.settings import DriftSettings
from monitor.recording import Array

if TYPE_CHECKING:
    from monitor.identify.identification import Identification

POSSIBLE_C = (-20.0, 100.0)  # [°C] of a joint that works; beyond it the sensor is wrong
VISCOUS_SHARE = 0.4  # assumed where a joint is not resolved
VISCOUS_SHARES = (0.05, 0.95)  # the fit's share is clipped to these: every joint has friction of both kinds
SLOW_RAD_S = 0.1  # below it friction is stiction, see `STANDSTILL_SPEED_RAD_S`
FAST_RAD_S = 1.0  # most trajectories reach it with most joints
RIPPLE_FLOOR = 0.03  # of friction: one replay resolves 1 to 3 %, and ripple of real arms repeats to a tenth of itself
NOT_MEASURED: Array = np.empty(0)  # an optional field that nobody measured; so is one of NaN


class Observation(NamedTuple):
    """One replay of N joints, (N,) each. The fields with a default are optional: wear is then looked for in fewer channels."""

    log_torque: Array  # y = log F, F the friction torque at the reference speed [N·m]; NaN where the joint was not resolved
    variance: Array  # of y, within the replay
    temperature_c: Array  # NaN where unknown
    viscous_share: Array  # of F
    warming_k_per_min: Array  # NaN where unknown
    coulomb_nm: Array  # fc of the fit, at the replay's temperature, for the temperature laws; NaN where unknown
    viscous_nm_s_per_rad: Array  # fv, likewise
    residual_rms_nm: Array = NOT_MEASURED  # RMS over moving samples of what the fit does not explain [N·m]; NaN where unknown
    log_torque_slow: Array = NOT_MEASURED  # log of the friction torque at `SLOW_RAD_S` by a law other than the line fc + fv·v …
    log_torque_fast: Array = NOT_MEASURED  # … and at `FAST_RAD_S`; NaN where the joint was not resolved
    current_noise_a: Array = NOT_MEASURED  # standard deviation of one reading of the current [A]; NaN where unknown
    temperature_constant: Array = (
        NOT_MEASURED  # 1 where every reading of the temperature was one and the same number, else 0; NaN where unknown
    )
    ripple: Array = NOT_MEASURED  # (N, 2) log(amplitude of the gear's ripple over F + `RIPPLE_FLOOR`), once and twice a turn of the motor …
    ripple_variance: Array = NOT_MEASURED  # … and its variance within the replay; NaN where the motion or the rate hides it


def observe(identification: "Identification", settings: DriftSettings) -> Observation:
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
    ripple, ripple_variance = _ripple(identification, np.where(resolved, torque, np.nan))
    slow, fast = (_log_torque_beside_line(identification, speed) for speed in (SLOW_RAD_S, FAST_RAD_S))
    return Observation(
        log_torque=np.where(resolved, np.log(F), np.nan),
        variance=np.where(resolved, (std / F) ** 2, np.nan),  # Var log F ≈ Var F / F²
        temperature_c=np.where(possible, measured, np.nan),
        viscous_share=np.clip(share, *VISCOUS_SHARES),
        warming_k_per_min=np.where(possible, warming, np.nan),
        coulomb_nm=identification.coulomb_nm,
        viscous_nm_s_per_rad=identification.viscous_nm_s_per_rad,
        residual_rms_nm=identification.rms_nm,
        log_torque_slow=np.where(resolved, slow, np.nan),
        log_torque_fast=np.where(resolved, fast, np.nan),
        current_noise_a=unknown if identification.current_noise_a is None else identification.current_noise_a,
        temperature_constant=unknown if identification.temperature_constant is None else identification.temperature_constant,
        ripple=ripple,
        ripple_variance=ripple_variance,
    )


def _ripple(identification: "Identification", torque_nm: Array) -> tuple[Array, Array]:
    """(J, 2) the logarithm of the ripple once and twice a turn of the motor, and its variance; NaN where it is not known.

    Large ripple differs from replay to replay by a share of itself, small ripple by what one replay resolves, and is often exactly zero:
    log(share + floor) makes one scatter of both.
    """
    found = identification.ripple
    if found is None or found.gain_nm_per_a is None:
        nothing = np.full((len(torque_nm), 2), np.nan)
        return nothing, nothing
    per_friction = (found.gain_nm_per_a / torque_nm)[:, None]
    share, std = (each[:, :2] * per_friction for each in (found.amplitude_a, found.std_a))
    return np.log(share + RIPPLE_FLOOR), (std / (share + RIPPLE_FLOOR)) ** 2


def _log_torque_beside_line(identification: "Identification", speed_rad_s: float) -> Array:
    """(J,) log of the friction torque at a speed by a law richer than fc + fv·v; NaN where there is none or the joint was slower."""
    if identification.friction is not None:
        torque = identification.friction.at(speed_rad_s)[0]
    elif identification.residual_friction is not None:
        fit = identification.residual_friction
        torque = np.einsum("jk,jk->j", fit.law.columns(np.full(len(fit.load_nm), speed_rad_s), fit.load_nm), fit.friction)
    else:
        torque = np.full(len(identification.coulomb_nm), np.nan)
    known = (torque > 0) & (identification.max_speed_rad_s >= speed_rad_s)
    return np.where(known, np.log(np.where(known, torque, 1.0)), np.nan)
