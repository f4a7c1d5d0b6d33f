"""The torque model that follows the joints' temperature: rigid parameters of the last replay, friction laws of all of them.

torque = Y·p (rigid and rotor) + [fc(T)·s(q̇) + fv(T)·q̇]·e^w, with wear w as it is believed now. This is what the bus publishes.

What fc and fv leave is that of the last replay, fitted by both laws at its temperature T₁, and scaled as viscous friction is:
[(fc₁' − fc₁)·s + (fv₁' − fv₁)·q̇ + fl·|τ|·s + fp·|q̇|^½·s]·fv(T)/fv(T₁), the law `concave` of `model.friction`.
(One factor for all four terms erred less on simulated replays never fitted than fc(T)/fc(T₁) for the first and third, or none.)
"""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.judge.belief import Belief
from monitor.judge.document import array, entry, plain
from monitor.judge.temperature.laws import Line, Valued, line_from_document
from monitor.judge.torque.prediction_error import believed
from monitor.judge.torque.predictor import TorquePrediction, prepared
from monitor.model.regressor import friction_columns
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array


class ResidualFriction(NamedTuple):
    """What a replay's friction has beyond its fc and fv."""

    terms: Array  # (J, 4) of s, q̇, |τ|·s and |q̇|^½·s; 0 where nothing is known
    temperature_c: Array  # (J,) of that replay; NaN: unknown
    speed_rad_s: Array  # (J,) fastest learnt from: beyond it the correction stays as it is there
    load_nm: Array  # (J,) largest |τ| learnt from, likewise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CompensatedModel:
    """Torque of one arm at any state and joint temperature."""

    robot: str
    mounting: Mounting
    revision: int  # replays learnt from
    at_unix_s: float
    columns: tuple[int, ...]  # (R,) of the regressor, friction left out
    values: Array  # (R,) their base parameters
    coulomb: Line  # [N·m], wear divided out
    viscous: Line  # [N·m·s/rad], wear divided out
    friction_correlation: Array  # (J,) of fc and fv within a replay
    wear: Array  # (J,) log, now
    wear_std: Array  # (J,)
    residual_rms_nm: Array  # (J,) what the model did not explain of the last replay
    residual_friction: ResidualFriction | None = None  # None, as in documents before it: fc and fv say all
    error_rms_nm: Array | None = None  # (J,) of the model, measurement's noise left out; None: residual_rms_nm stands for it
    measured_rms_nm: Array | None = None  # (J,) of single measured samples from the model; likewise

    @property
    def joints(self) -> int:
        """J."""
        return len(self.wear)

    def coulomb_at(self, temperature_c: Array) -> Valued:
        """Coulomb friction fc (…, J) [N·m] at joint temperatures (…, J), present wear included; its std; extrapolated."""
        return self._worn(self.coulomb.at(temperature_c))

    def viscous_at(self, temperature_c: Array) -> Valued:
        """Viscous friction fv (…, J) [N·m·s/rad] at joint temperatures (…, J), present wear included; its std; extrapolated."""
        return self._worn(self.viscous.at(temperature_c))

    def torque(self, robot: Robot, q: Array, qd: Array, qdd: Array, temperature_c: Array | None = None) -> TorquePrediction:
        """Predicted joint torque.

        q, qd, qdd : (N, J) or (J,) [rad, rad/s, rad/s²]; temperature_c : (N, J) or (J,), None for the reference temperature.
        Raises BadInput for another robot, shapes that do not fit, or values that are not finite.
        """
        predictor = prepared(self, robot)
        T = self.viscous.reference_c if temperature_c is None else np.asarray(temperature_c, dtype=float)
        q, qd, qdd = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (q, qd, qdd))
        for name, x in (("q", q), ("qd", qd), ("qdd", qdd), ("temperature_c", np.atleast_2d(T))):
            if x.ndim != 2 or x.shape[1] != self.joints or len(x) not in (len(q), 1 if name == "temperature_c" else len(q)):
                raise BadInput(f"{name} has shape {x.shape}; expected ({len(q)}, {self.joints}) like q, or ({self.joints},)")
            if not np.all(np.isfinite(x)):
                raise BadInput(f"{name} holds values that are not finite")
        return predictor.torque(q, qd, qdd, T)

    def as_document(self) -> dict[str, Any]:
        """Plain JSON; `model_from_document` is its inverse."""
        document: dict[str, Any] = plain(self)
        return {("finer" if key == "residual_friction" else key): value for key, value in document.items()}  # as stored since version 1

    def _worn(self, fresh: Valued) -> Valued:
        worn = np.exp(self.wear)
        return Valued(fresh.value * worn, fresh.std * worn, fresh.extrapolated)


def compensated(identification: Identification, belief: Belief, *, coulomb: Line, viscous: Line) -> CompensatedModel:
    """The model after a replay: its rigid part from the identification, its friction from the belief and its `lines`."""
    rigid = ~np.isin(identification.columns, np.concatenate(friction_columns(belief.joints)))  # (B,)
    variances = identification.friction_cov[:, [0, 1], [0, 1]]  # (J, 2)
    scale = np.sqrt(variances.prod(axis=1))
    correlation = np.divide(identification.friction_cov[:, 0, 1], scale, out=np.zeros_like(scale), where=scale > 0)
    residual_friction, J = identification.residual_friction, belief.joints
    left_nm = identification.rms_nm if residual_friction is None else residual_friction.rms_nm
    error_nm, measured_nm = (None, None) if belief.doubt is None else believed(belief.doubt, left_nm)
    beyond = None
    if residual_friction is not None:
        line = np.stack([identification.coulomb_nm, identification.viscous_nm_s_per_rad], axis=1)  # (J, 2)
        known = identification.temperature_c
        beyond = ResidualFriction(
            terms=np.nan_to_num(np.where(np.isfinite(line[:, :1]), residual_friction.friction - np.pad(line, ((0, 0), (0, 2))), 0.0)),
            temperature_c=np.full(J, np.nan) if known is None else known,
            speed_rad_s=identification.max_speed_rad_s,
            load_nm=residual_friction.load_nm,
        )
    return CompensatedModel(
        robot=identification.robot,
        mounting=identification.mounting,
        revision=belief.replays,
        at_unix_s=belief.at_unix_s,
        columns=tuple(int(column) for column in np.array(identification.columns)[rigid]),
        values=(identification.values if residual_friction is None else residual_friction.rigid)[rigid],
        coulomb=coulomb,
        viscous=viscous,
        friction_correlation=np.clip(np.nan_to_num(correlation), -1.0, 1.0),
        wear=belief.wear,
        wear_std=belief.wear_std,
        residual_rms_nm=left_nm,
        residual_friction=beyond,
        error_rms_nm=error_nm,
        measured_rms_nm=measured_nm,
    )


def model_from_document(document: Any) -> CompensatedModel:
    """A CompensatedModel from its document. Raises BadInput naming what is missing or wrong."""
    where = "model"
    J = len(array(document, "wear", (-1,), where=where))
    arrays: dict[str, Any] = {
        f.name: array(document, f.name, (-1,) if f.name == "values" else (J,), where=where)
        for f in fields(CompensatedModel)
        if f.type == Array
    }
    beyond = document.get("finer")
    if beyond is not None:
        shapes = {name: (J, 4) if name == "terms" else (J,) for name in ResidualFriction._fields}
        beyond = ResidualFriction(**{name: array(beyond, name, shape, where="model: finer") for name, shape in shapes.items()})
    told = {
        name: array(document, name, (J,), where=where) for name in ("error_rms_nm", "measured_rms_nm") if document.get(name) is not None
    }
    columns = array(document, "columns", arrays["values"].shape, where=where)
    try:
        return CompensatedModel(
            robot=str(entry(document, "robot", where=where)),
            mounting=Mounting(**entry(document, "mounting", where=where)),
            revision=int(entry(document, "revision", where=where)),
            at_unix_s=float(entry(document, "at_unix_s", where=where)),
            columns=tuple(int(column) for column in columns),
            coulomb=line_from_document(entry(document, "coulomb", where=where), J, where="model: coulomb"),
            viscous=line_from_document(entry(document, "viscous", where=where), J, where="model: viscous"),
            residual_friction=beyond,
            **arrays,
            **told,
        )
    except (TypeError, ValueError) as wrong:
        raise BadInput(f"model: {wrong}") from None
