"""Torque of an arm's links and rotors by recursive Newton–Euler, from base parameters.

Rigid torque is linear in the inertial parameters, so pinocchio's recursive Newton–Euler computes it without the regressor. The base
parameters are a regrouped set and describe no physical arm: a link may have a first moment without a mass, while pinocchio stores a
centre of mass. Therefore every link gets a point mass at the origin of its frame, and the torque of the point masses alone is subtracted.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.judge.temperature.curves import LawForm
from monitor.judge.torque.model import CompensatedModel
from monitor.model.friction import CONCAVE, SIGN_SPEED_RAD_S, FrictionLaw
from monitor.model.regressor import ROTOR
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, Robot
from monitor.recording import Array

if TYPE_CHECKING:
    import pinocchio

MIN_MASS_KG = 0.1  # of a link with its point mass: the centre of mass mx/m keeps its digits
POINT_MASSES_KG = (10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 1280.0, 2560.0)  # J ≤ 8 links can exclude eight of these


class RigidTorque:
    """Torque of links and rotors; immutable, shared by threads."""

    def __init__(self, robot: Robot, mounting: Mounting, columns: tuple[int, ...], values: Array) -> None:
        """Parameters `values` (R,) stand in these columns of the regressor; the others are 0."""
        import pinocchio as pin  # its import takes 0.2 s, so only a program that predicts torque pays for it

        J = robot.joints
        self._rnea = pin.rnea
        parameters = np.zeros(PER_JOINT * J)
        parameters[list(columns)] = values
        blocks = parameters.reshape(J, PER_JOINT)
        self.rotor = blocks[:, ROTOR]  # (J,) inertia of the rotors at the joints [kg·m²]
        masses = blocks[:, 0]
        point_mass = next(mass for mass in POINT_MASSES_KG if np.all(np.abs(masses + mass) >= MIN_MASS_KG))
        points = np.zeros((J, INERTIAL))
        points[:, 0] = point_mass
        self._arm, self._points = _pinocchio_arm(robot, mounting, blocks[:, :INERTIAL] + points), _pinocchio_arm(robot, mounting, points)
        self._data = self._arm.createData(), self._points.createData()

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """(N, J) [N·m] at states q, qd, qdd (N, J) [rad, rad/s, rad/s²]."""
        # pinocchio holds the interpreter's lock from the call until its result is copied: threads may share the workspace
        rnea, (arm_data, points_data) = self._rnea, self._data
        torque = np.empty_like(q)
        for n in range(len(q)):
            state = q[n], qd[n], qdd[n]
            torque[n] = rnea(self._arm, arm_data, *state)
            torque[n] -= rnea(self._points, points_data, *state)
        torque += qdd * self.rotor
        return torque


def _pinocchio_arm(robot: Robot, mounting: Mounting, blocks: Array) -> "pinocchio.Model":
    """Pinocchio's model with the inertial parameters `blocks` (J, 10), each about its link's DH origin in the axes of the DH frame."""
    import pinocchio as pin

    model = robot.pinocchio_model(mounting)
    for i, (m, mx, my, mz, xx, xy, xz, yy, yz, zz) in enumerate(blocks.tolist()):
        to_dh = model.frames[model.getFrameId(f"dh_{i + 1}")].placement
        about_dh = pin.Inertia.FromDynamicParameters(np.array([m, mx, my, mz, xx, xy, yy, xz, yz, zz]))  # in pinocchio's order
        model.inertias[i + 1] = to_dh.act(about_dh)
    return model


# --- Prediction of joint torque by a compensated model --------------------------------------------------

MAX_REDUCTION = 0.95  # share of fc and fv that negative residual friction may cancel: friction never drives a joint

scalars = SimpleNamespace(
    exp=math.exp,
    sqrt=math.sqrt,
    tanh=math.tanh,
    sign=lambda x: math.copysign(1.0, x) if x else 0.0,
    where=lambda condition, a, b: a if condition else b,
    maximum=max,  # of its first argument where that is NaN, as numpy's
    minimum=min,
)


class TorquePrediction(NamedTuple):
    """Joint torque and its parts, (N, J) each [N·m]; standard deviations are NaN where a joint's friction was never identified.

    `Predictor.sample` gives lists of J plain numbers.
    """

    torque: Array
    rigid: Array
    friction: Array
    std: Array  # of the torque itself
    extrapolated: np.ndarray  # (N, J) whether the temperature is outside the learned range
    measured_std: Array  # of one measured sample of the torque


class _Figures(NamedTuple):
    """What a prediction needs of the model beside the rigid part: of all joints, (J,) each, or plain numbers of one joint."""

    coulomb: LawForm
    viscous: LawForm
    known: Any  # whether friction was ever identified
    wear_factor: Any
    wear_var: Any
    double_correlation: Any
    error_var: Any
    noise_var: Any
    coldest_c: Any
    warmest_c: Any
    rotor: Any  # [kg·m²]
    residual: tuple[Any, ...]  # coefficients of the residual law's terms per viscous friction [1/(N·m·s/rad)]; empty: no residual friction
    fastest_rad_s: Any  # beyond it residual friction keeps its value at it
    heaviest_nm: Any

    def of_joint(self, j: int) -> "_Figures":
        """The figures of one joint (from 0)."""

        def one(part: Any) -> Any:
            if isinstance(part, LawForm):
                return LawForm(*map(one, part))
            return tuple(map(one, part)) if isinstance(part, tuple) else part[j].item()

        return _Figures(*map(one, self))


class Predictor:
    """Torque of one arm at any state and joint temperature; immutable, shared by threads."""

    def __init__(self, model: CompensatedModel, robot: Robot) -> None:
        """Raises BadInput where the model is another robot's."""
        if robot.name != model.robot:
            raise BadInput(f"the model is of {model.robot}, the robot is {robot.name}")
        self._rigid = RigidTorque(robot, model.mounting, model.columns, model.values)
        error_nm, sample_nm = (model.residual_rms_nm if of is None else of for of in (model.error_rms_nm, model.measured_rms_nm))
        low, high = model.viscous.range_c.T
        self._law = CONCAVE if model.residual_friction is None else model.residual_friction.law
        residual, fastest, heaviest = _residual(model)
        self._all = _Figures(
            coulomb=model.coulomb.form,
            viscous=model.viscous.form,
            known=np.isfinite(model.coulomb.intercept) & np.isfinite(model.viscous.intercept),
            wear_factor=np.exp(model.wear),
            wear_var=model.wear_std**2,
            double_correlation=2.0 * model.friction_correlation,
            error_var=error_nm**2,
            noise_var=np.maximum(sample_nm**2 - error_nm**2, 0.0),  # NaN stays NaN
            coldest_c=low - model.viscous.margin_k,  # NaN where no temperature has been learned: everything is outside
            warmest_c=high + model.viscous.margin_k,
            rotor=self._rigid.rotor,
            residual=residual,
            fastest_rad_s=fastest,
            heaviest_nm=heaviest,
        )
        self._each = [self._all.of_joint(j) for j in range(robot.joints)]

    def torque(self, q: Array, qd: Array, qdd: Array, temperature_c: Array) -> TorquePrediction:
        """The prediction at states q, qd, qdd (N, J) [rad, rad/s, rad/s²] and temperatures (N, J) or (J,) [°C], all of them finite."""
        rigid = self._rigid.torque(q, qd, qdd)
        return TorquePrediction(*_predicted(self._all, self._law, rigid, qd, qdd, np.broadcast_to(temperature_c, q.shape), np))

    def sample(self, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float], temperature_c: Sequence[float]) -> TorquePrediction:
        """`torque` of one sample, J finite plain numbers each; the result holds lists of J."""
        rigid = self._rigid.torque(*(np.array([x], dtype=float) for x in (q, qd, qdd)))[0].tolist()
        states = zip(self._each, rigid, qd, qdd, temperature_c, strict=True)
        joints = [_predicted(figures, self._law, link, v, a, T, scalars) for figures, link, v, a, T in states]
        return TorquePrediction(*map(list, zip(*joints, strict=True)))  # type: ignore[arg-type]  # lists in the place of arrays


def _predicted(
    of: _Figures, law: FrictionLaw, rigid: Any, qd: Any, qdd: Any, temperature_c: Any, ops: ModuleType | SimpleNamespace
) -> tuple[Any, ...]:
    """The fields of a TorquePrediction, of arrays or of plain numbers."""
    fc, fc_var = of.coulomb.at(temperature_c, ops)
    fv, fv_var = of.viscous.at(temperature_c, ops)
    direction = ops.tanh(qd / SIGN_SPEED_RAD_S)
    worn_s, worn_v = of.wear_factor * direction, of.wear_factor * qd
    friction = ops.where(of.known, fc * worn_s + fv * worn_v, 0.0)
    if of.residual:
        speed, load = ops.minimum(abs(qd), of.fastest_rad_s), ops.minimum(abs(rigid - qdd * of.rotor), of.heaviest_nm)
        opposing = law.opposing_torque(of.residual, abs(direction), speed, load) * fv * of.wear_factor
        friction = friction + ops.sign(qd) * ops.where(of.known, ops.maximum(opposing, -MAX_REDUCTION * abs(friction)), 0.0)
    of_fc, of_fv = fc_var * worn_s * worn_s, fv_var * worn_v * worn_v
    var = of_fc + of_fv + of.double_correlation * ops.sqrt(of_fc * of_fv) + friction * friction * of.wear_var + of.error_var
    var = ops.where(of.known, var, math.nan)
    inside = (of.coldest_c <= temperature_c) & (temperature_c <= of.warmest_c) & of.known
    return rigid + friction, rigid, friction, ops.sqrt(var), inside ^ True, ops.sqrt(var + of.noise_var)


def _residual(model: CompensatedModel) -> tuple[tuple[Array, ...], Array, Array]:
    """Coefficients of the residual law's terms over viscous friction at their temperature, K of (J,), and the limits of speed and load."""
    residual = model.residual_friction
    if residual is None:
        return (), np.zeros(model.joints), np.zeros(model.joints)
    at_c = np.where(np.isfinite(residual.temperature_c), residual.temperature_c, model.viscous.reference_c)
    viscous = np.nan_to_num(model.viscous_at(at_c).value)
    per_viscous = np.divide(1.0, viscous, out=np.zeros_like(viscous), where=viscous > 0)  # (J,) 1/fv(T₁)
    return tuple(residual.terms.T * per_viscous), residual.speed_rad_s, residual.load_nm


@lru_cache(maxsize=8)
def predictor_for(model: CompensatedModel, robot: Robot) -> Predictor:
    """The predictor of a model. Models and robots are immutable, so the cache knows them by identity. Raises BadInput as `Predictor`."""
    return Predictor(model, robot)


def predict_torque(
    model: CompensatedModel, robot: Robot, q: Array, qd: Array, qdd: Array, temperature_c: Array | None = None
) -> TorquePrediction:
    """Predicted joint torque at given states and joint temperatures.

    q, qd, qdd : (N, J) or (J,) [rad, rad/s, rad/s²]; temperature_c : (N, J) or (J,) [°C], None for the reference temperature.
    Raises BadInput for another robot, shapes that do not fit, or values that are not finite.
    """
    predictor = predictor_for(model, robot)
    T = model.viscous.reference_c if temperature_c is None else np.asarray(temperature_c, dtype=float)
    q, qd, qdd = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (q, qd, qdd))
    for name, x in (("q", q), ("qd", qd), ("qdd", qdd), ("temperature_c", np.atleast_2d(T))):
        if x.ndim != 2 or x.shape[1] != model.joints or len(x) not in (len(q), 1 if name == "temperature_c" else len(q)):
            raise BadInput(f"{name} has shape {x.shape}; expected ({len(q)}, {model.joints}) like q, or ({model.joints},)")
        if not np.all(np.isfinite(x)):
            raise BadInput(f"{name} holds values that are not finite")
    return predictor.torque(q, qd, qdd, T)
