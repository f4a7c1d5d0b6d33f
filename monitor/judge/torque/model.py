"""The temperature-compensated torque model as a value: rigid parameters of the last replay, friction laws learned from all replays.

torque = Y·p (rigid and rotor) + [fc(T)·s(q̇) + fv(T)·q̇]·e^w, with w the present estimate of wear. The bus publishes this model.

The friction beyond fc and fv is that of the last replay. It was fitted together with both laws at the replay's temperature T₁, and it is
scaled with temperature like viscous friction:
[(fc₁' − fc₁)·s + (fv₁' − fv₁)·q̇ + fl·|τ|·s + fp·|q̇|^½·s]·fv(T)/fv(T₁), the law `concave` of `model.friction`.
(On simulated replays that were not fitted, one factor for all four terms had a smaller error than no factor, and a smaller error than
the factor fc(T)/fc(T₁) for the first and third term.)
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from monitor.judge.document import plain, typed
from monitor.judge.prediction_error import rms
from monitor.judge.temperature.laws import LawValue, Line
from monitor.model.friction import FrictionLaw, friction_law
from monitor.model.regressor import friction_columns
from monitor.model.robot import Mounting
from monitor.recording import Array

if TYPE_CHECKING:
    from monitor.identify.identification import Identification
    from monitor.judge.belief import Belief
    from monitor.judge.friction.step import FrictionModel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResidualFriction:
    """Friction of one replay beyond its Coulomb and viscous friction fc and fv."""

    law_name: str  # of the terms
    terms: Annotated[Array, "J K"]  # coefficients of the law's terms; 0 where unknown
    temperature_c: Annotated[Array, "J"]  # joint temperature of that replay [°C]; NaN where unknown
    speed_rad_s: Annotated[Array, "J"]  # largest speed in the fit; beyond it the terms keep their value at it
    load_nm: Annotated[Array, "J"]  # largest |τ| in the fit; beyond it the terms keep their value at it

    def __post_init__(self) -> None:
        """Raises BadInput for a law that is not known, or that has another number of terms."""
        if self.terms.shape[1] != len(self.law.terms):
            raise ValueError(f"terms has {self.terms.shape[1]} columns; the law {self.law_name} has {len(self.law.terms)} terms")

    @property
    def law(self) -> FrictionLaw:
        """The law of the terms."""
        return friction_law(self.law_name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CompensatedModel:
    """Parameters of the torque of one arm at any state and joint temperature. `predictor` computes torque from them."""

    robot: str
    mounting: Mounting
    revision: int  # number of replays learned from
    at_unix_s: float  # time of the last of them
    columns: tuple[int, ...]  # (R,) regressor columns of `values`; friction columns are left out
    values: Annotated[Array, "R"]  # rigid and rotor base parameters
    coulomb: Line  # fc(T) [N·m], without wear
    viscous: Line  # fv(T) [N·m·s/rad], without wear
    friction_correlation: Annotated[Array, "J"]  # correlation of fc and fv within a replay, −1…1
    wear: Annotated[Array, "J"]  # present wear w, logarithm of a factor on friction
    wear_std: Annotated[Array, "J"]  # standard deviation of w
    residual_rms_nm: Annotated[Array, "J"]  # RMS residual of the fit to the last replay [N·m]
    residual_friction: ResidualFriction | None = None  # None: friction is fc and fv alone
    error_rms_nm: Annotated[Array, "J"] | None = None  # RMS error of the model without measurement noise [N·m]; None: use residual_rms_nm
    measured_rms_nm: Annotated[Array, "J"] | None = None  # RMS of single measured samples about the model [N·m]; None: use residual_rms_nm

    @property
    def joints(self) -> int:
        """J, the number of joints."""
        return len(self.wear)

    def coulomb_at(self, temperature_c: Array) -> LawValue:
        """Coulomb friction fc with present wear, its standard deviation, and whether it is extrapolated.

        temperature_c : (…, J) joint temperatures [°C]; the result has the same shape [N·m].
        """
        return self._worn(self.coulomb.at(temperature_c))

    def viscous_at(self, temperature_c: Array) -> LawValue:
        """Viscous friction fv with present wear, its standard deviation, and whether it is extrapolated.

        temperature_c : (…, J) joint temperatures [°C]; the result has the same shape [N·m·s/rad].
        """
        return self._worn(self.viscous.at(temperature_c))

    def as_document(self) -> dict[str, Any]:
        """The model as a JSON object; `model_from_document` is the inverse."""
        document: dict[str, Any] = plain(self)
        return document

    def _worn(self, fresh: LawValue) -> LawValue:
        factor = np.exp(self.wear)
        return LawValue(fresh.value * factor, fresh.std * factor, fresh.extrapolated)


def model_from_document(document: Any) -> CompensatedModel:
    """A CompensatedModel from its JSON object. Raises BadInput naming what is missing or wrong."""
    return typed(CompensatedModel, document, where="model")


# --- Identification and belief after one replay → the temperature-compensated torque model --------------


def build_model(
    identification: "Identification", belief: "Belief", model: "FrictionModel", *, coulomb: Line, viscous: Line
) -> CompensatedModel:
    """The model after a replay: the rigid part comes from the identification, the friction from the belief.

    model : of friction, for the doubt of changes that were not found. coulomb, viscous : fc(T) and fv(T) of `Belief.lines`.
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
        wear=belief.change,  # the laws are those of the beginning
        wear_std=belief.change_with_unfound(model)[1],
        residual_rms_nm=residual_rms_nm,
        residual_friction=_residual_friction(identification),
        error_rms_nm=error_nm,
        measured_rms_nm=measured_nm,
    )


def _friction_correlation(identification: "Identification") -> Array:
    """(J,) correlation of fc and fv within the replay; 0 where unknown."""
    variances = identification.friction_cov[:, [0, 1], [0, 1]]  # (J, 2)
    scale = np.sqrt(variances.prod(axis=1))
    correlation = np.divide(identification.friction_cov[:, 0, 1], scale, out=np.zeros_like(scale), where=scale > 0)
    clipped: Array = np.clip(np.nan_to_num(correlation), -1.0, 1.0)
    return clipped


def _residual_friction(identification: "Identification") -> ResidualFriction | None:
    """The replay's friction beyond fc and fv; None where it was not fitted."""
    residual = identification.residual_friction
    if residual is None:
        return None
    fc_fv = np.stack([identification.coulomb_nm, identification.viscous_nm_s_per_rad], axis=1)  # (J, 2)
    beyond = residual.friction - np.pad(fc_fv, ((0, 0), (0, len(residual.law.extra_terms))))  # (J, K)
    temperature_c = identification.temperature_c
    return ResidualFriction(
        law_name=residual.law.name,
        terms=np.nan_to_num(np.where(np.isfinite(fc_fv[:, :1]), beyond, 0.0)),
        temperature_c=np.full(len(fc_fv), np.nan) if temperature_c is None else temperature_c,
        speed_rad_s=identification.max_speed_rad_s,
        load_nm=residual.load_nm,
    )
