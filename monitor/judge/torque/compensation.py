"""Identification and belief after one replay → the temperature-compensated torque model."""

import numpy as np

from monitor.identify.identification import Identification
from monitor.judge.belief import Belief
from monitor.judge.prediction_error import rms
from monitor.judge.temperature.laws import Line
from monitor.judge.torque.compensated_model import CompensatedModel, ResidualFriction
from monitor.model.regressor import friction_columns
from monitor.recording import Array


def build_model(identification: Identification, belief: Belief, *, coulomb: Line, viscous: Line) -> CompensatedModel:
    """The model after a replay: the rigid part comes from the identification, the friction from the belief.

    coulomb, viscous : fc(T) and fv(T) of the belief, from `Belief.lines`.
    """
    rigid = ~np.isin(identification.columns, np.concatenate(friction_columns(belief.joints)))  # (B,)
    residual = identification.residual_friction
    residual_rms_nm = identification.rms_nm if residual is None else residual.rms_nm
    error_nm, measured_nm = (None, None) if belief.prediction_error is None else rms(belief.prediction_error, residual_rms_nm)
    return CompensatedModel(
        robot=identification.robot,
        mounting=identification.mounting,
        revision=belief.replays,
        at_unix_s=belief.at_unix_s,
        columns=tuple(int(column) for column in np.array(identification.columns)[rigid]),
        values=(identification.values if residual is None else residual.rigid)[rigid],
        coulomb=coulomb,
        viscous=viscous,
        friction_correlation=_friction_correlation(identification),
        wear=belief.filter_state.change,  # the laws are those of the beginning
        wear_std=belief.wear_std,
        residual_rms_nm=residual_rms_nm,
        residual_friction=_residual_friction(identification),
        error_rms_nm=error_nm,
        measured_rms_nm=measured_nm,
    )


def _friction_correlation(identification: Identification) -> Array:
    """(J,) correlation of fc and fv within the replay; 0 where unknown."""
    variances = identification.friction_cov[:, [0, 1], [0, 1]]  # (J, 2)
    scale = np.sqrt(variances.prod(axis=1))
    correlation = np.divide(identification.friction_cov[:, 0, 1], scale, out=np.zeros_like(scale), where=scale > 0)
    clipped: Array = np.clip(np.nan_to_num(correlation), -1.0, 1.0)
    return clipped


def _residual_friction(identification: Identification) -> ResidualFriction | None:
    """The replay's friction beyond fc and fv; None where it was not fitted."""
    residual = identification.residual_friction
    if residual is None:
        return None
    fc_fv = np.stack([identification.coulomb_nm, identification.viscous_nm_s_per_rad], axis=1)  # (J, 2)
    beyond = residual.friction - np.pad(fc_fv, ((0, 0), (0, len(residual.law.extra_terms))))  # (J, K)
    temperature_c = identification.temperature_c
    return ResidualFriction(
        law=residual.law,
        terms=np.nan_to_num(np.where(np.isfinite(fc_fv[:, :1]), beyond, 0.0)),
        temperature_c=np.full(len(fc_fv), np.nan) if temperature_c is None else temperature_c,
        speed_rad_s=identification.max_speed_rad_s,
        load_nm=residual.load_nm,
    )
